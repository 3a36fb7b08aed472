"""What every kind of source file is to the rest of the house."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal


@dataclass(frozen=True)
class WaveStore:
    """Where the packets are.

    Attributes
    ----------
    kind : ``internal``, ``external`` or ``none``.
    path : the file that holds them, None if none does.
    base : byte of that file from which packet offsets count (the record's header).
    available : bytes from `base` that can be read.
    why_not : empty, or why there are none.
    """

    kind: Literal["internal", "external", "none"]
    path: Path | None = None
    base: int = 0
    available: int = 0
    why_not: str = ""


@dataclass(frozen=True, kw_only=True)
class Source(ABC):
    """A source file that was opened and found readable, whatever its format.

    Attributes
    ----------
    path, size : the file, and its bytes.
    version : of its format.
    compressed : its points are.
    n_points : points; 0 in formats that hold pulses only.
    n_records : what spans count: points, or pulses where there are no points.
    point_format : of LAS, 0 to 10; -1 in formats that hold pulses only.
    bounds : the header's (xmin, ymin, zmin, xmax, ymax, zmax) [m].
    scales, offsets : of the stored coordinates [m].
    crs : a `pyproj.CRS` or None.
    waves : where the samples are.
    standard_gps_time : times count from the GPS epoch (less 10^9 s), not from the start of a week.
    faults : what is wrong with the file, as sentences for the user.
    target : the projected system that its places and beams are brought into as they are read; None: as they are.
    mirrored : the horizontal parts of its beams are to be turned round.
    ranged : distances from the sensor that it gives are to be taken.
    """

    path: Path
    size: int
    version: tuple[int, int]
    compressed: bool
    n_points: int
    n_records: int
    point_format: int
    bounds: tuple[float, float, float, float, float, float]
    scales: tuple[float, float, float]
    offsets: tuple[float, float, float]
    crs: Any
    waves: WaveStore
    standard_gps_time: bool
    faults: tuple[str, ...]
    mirrored: bool = False
    ranged: bool = True
    target: str | None = None

    @property
    @abstractmethod
    def has_waves(self) -> bool:
        """The file declares waveforms, whether or not they can be read."""

    @property
    @abstractmethod
    def sample_dtype(self) -> str:
        """One dtype for all samples of the file: the widest that its descriptors ask for."""
