"""Parameters of contour lines."""

from __future__ import annotations

import math
from typing import Self

from pydantic import Field, model_validator

from fwclass.params import Params

STEP = 1e-4
"""Heights are whole numbers of this [m]: a tenth of what echoes are stored to."""


class ContourParams(Params):
    """Parameters of contour lines.

    Attributes
    ----------
    enabled : whether they are made.
    interval : between two lines [m], a whole number of tenths of a millimetre.
    index : every `index`-th line, counted from height 0, is an index contour.
    smooth : standard deviation of the weights by which the terrain is smoothed before [m]; 0 leaves it as it is.
    most : share of `interval`; the smoothed terrain is nowhere further from the terrain.
    shortest : shorter lines are left out [m].
    """

    enabled: bool
    interval: float = Field(ge=0.05, le=1000)
    index: int = Field(ge=1, le=1000)
    smooth: float = Field(ge=0, le=50)
    most: float = Field(ge=0, le=1)
    shortest: float = Field(ge=0, le=1_000_000)

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if not math.isclose(self.interval / STEP, round(self.interval / STEP), abs_tol=1e-6):
            raise ValueError("interval must be a whole number of tenths of a millimetre")
        return self

    @property
    def steps(self) -> int:
        """`interval` in units of `STEP`."""
        return round(self.interval / STEP)
