"""Which ground filter decides, and the parameters of all of them."""

from __future__ import annotations

import math
from typing import Literal, Self

from pydantic import Field, model_validator

from fwclass.ground.methods import Method
from fwclass.ground.methods.params import (
    MAX_HALO,
    ConsensusParams,
    CsfParams,
    CsfSmrfParams,
    FilterParams,
    IptdParams,
    MovingSurfaceParams,
    NoiseParams,
    PmfParams,
    PtdParams,
    SlopeParams,
    SmrfParams,
)
from fwclass.params import Params

MOST_CELLS = 16_384
"""Along the edge of a raster that a part holds: 1 GiB of float32."""


class GroundParams(Params):
    """Which filter decides what is ground, and the parameters of all of them.

    Attributes
    ----------
    method : the filter; in a survey `auto`, which takes filter and parameters for every square of the fixed grid from
        its echoes (`ground_auto`), and what is set here where these are too few.
    max_building_size : edge of the largest building [m]; filters take their largest window or cell from it.
    last_returns : only last (and single) echoes of a pulse can be ground, and only they are looked at.
    block : edge of the blocks of the fixed global grid that filters work on [m].
    block_halo : what is read around a block, at least [m]; a filter that reaches further reads more.
    """

    method: Method | Literal["auto"]
    max_building_size: float = Field(gt=0, le=1_000_000)
    last_returns: bool
    block: float = Field(ge=1, le=100_000)
    block_halo: float = Field(ge=0)
    noise: NoiseParams
    slope: SlopeParams
    pmf: PmfParams
    smrf: SmrfParams
    moving_surface: MovingSurfaceParams
    ptd: PtdParams
    iptd: IptdParams
    csf: CsfParams
    csf_smrf: CsfSmrfParams
    consensus: ConsensusParams

    @model_validator(mode="after")
    def _reaches_no_further(self) -> Self:
        if self.halo > MAX_HALO:
            raise ValueError(
                f"the filter would read {self.halo:,.0f} m around a block, more than {MAX_HALO:,.0f} m: "
                "choose a smaller max_building_size, window, radius or cell of the filter"
            )
        cell = min((self.of(m).finest for m in self.filters), default=math.inf)
        if self.block + 2.0 * self.halo > MOST_CELLS * cell:
            raise ValueError(
                f"a block of {self.block:g} m and {self.halo:g} m around it would be more than {MOST_CELLS:,} cells of "
                f"{cell:g} m wide: choose a smaller block or larger cells of the filter"
            )
        return self

    def of(self, method: str) -> FilterParams:
        """The sized parameters of one filter; lengths [m] that follow from the largest building are set."""
        own: FilterParams = getattr(self, section_of(method))
        return own.sized(self.max_building_size)

    @property
    def filters(self) -> tuple[Method, ...]:
        """The single filters that take part; none of `auto`, which are chosen from echoes."""
        if self.method == "auto":
            return ()
        return self.consensus.methods if self.method == "consensus" else (self.method,)

    @property
    def halo(self) -> float:
        """What is read around a block [m]; of `auto` the least."""
        return max([self.block_halo, *(self.noise.reach + self.of(m).reach for m in self.filters)])


def section_of(method: str) -> str:
    """The section of `GroundParams` that holds a filter's parameters."""
    return method.replace("-", "_").replace("+", "_")
