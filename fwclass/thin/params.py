"""Parameters of the thinning."""

from __future__ import annotations

from pydantic import Field

from fwclass.params import Params


class ThinParams(Params):
    """Numbers and sources stand in `conf/base.yaml`.

    Attributes
    ----------
    seed : of the first echo that a cell keeps.
    rate : share of the echoes that features are computed for and the classifier is asked about; 1 is all.
    cell : edge of the cells of the global grid in which every n-th echo is kept, n = 1 / `rate` [m].
    reach : no echo is further than this from a kept one; as many more are kept as that takes [m].
    """

    seed: int = Field(ge=0, lt=2**63)
    rate: float = Field(gt=0, le=1)
    cell: float = Field(ge=0.01, le=100_000)
    reach: float = Field(gt=0, le=10_000)
