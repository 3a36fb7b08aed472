"""Parameters of voxels and of vertical profiles."""

from __future__ import annotations

import math
from typing import Self

from pydantic import Field, model_validator

from fwclass.params import Params

MOST_BINS = 100_000
"""Heights of a profile."""

MOST_NUMBERS = 64_000_000
"""Of the profiles of a block, 1.7 GB while they are made."""


class VoxelParams(Params):
    """Parameters of the voxels; the numbers are in `conf/base.yaml`.

    Attributes
    ----------
    write : voxels are delivered.
    size : edge of a voxel [m].
    above : beams are followed from so far above their first echo on [m].
    halo : echoes so far around a block are read, for the beams that cross it [m].
    most : voxels of a block at most.
    """

    write: bool
    size: float = Field(ge=0.05, le=100.0)
    above: float = Field(ge=0.0, le=1000.0)
    halo: float = Field(ge=0.0, le=1000.0)
    most: int = Field(ge=1, le=2_000_000_000)


class ProfileParams(Params):
    """Parameters of the vertical profiles; the numbers are in `conf/base.yaml`.

    Attributes
    ----------
    write : profiles are delivered.
    cell : edge of the cells whose waveforms are taken together [m].
    bin : heights that count as one [m].
    lowest, highest : of the profile, above ground [m].
    ground : what lies so near to the terrain counts as ground [m].
    ratio : reflectance of plants over that of the ground.
    least : pulses of a cell below which it has no figures.
    """

    write: bool
    cell: float = Field(ge=0.1, le=10_000.0)
    bin: float = Field(gt=0.0, le=100.0)
    lowest: float = Field(ge=-1000.0, le=0.0)
    highest: float = Field(gt=0.0, le=10_000.0)
    ground: float = Field(gt=0.0, le=100.0)
    ratio: float = Field(gt=0.0, le=100.0)
    least: int = Field(ge=1, le=1_000_000_000)

    @model_validator(mode="after")
    def _whole(self) -> Self:
        for name in ("lowest", "highest"):
            bins = getattr(self, name) / self.bin
            if not math.isclose(bins, round(bins), abs_tol=1e-9):
                raise ValueError(f"{name} must be a whole number of bins of {self.bin} m")
        if self.bins > MOST_BINS:
            raise ValueError(f"a profile has at most {MOST_BINS:,} bins")
        return self

    @property
    def bins(self) -> int:
        """Number of bins in height."""
        return round((self.highest - self.lowest) / self.bin)
