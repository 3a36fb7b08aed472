"""Parameters of the assessment."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from fwclass.stage import Params


class AssessParams(Params):
    """What is reported, and what accuracy is asked for; numbers and sources stand in `conf/base.yaml`.

    `block`: edge of the squares of the global grid [m] that intervals are drawn from.
    """

    block: float = Field(ge=0.1, le=100_000)
    quantiles: tuple[Annotated[float, Field(ge=0, le=1)], ...] = Field(min_length=1, max_length=100)
    min_overall_accuracy: float | None = Field(ge=0, le=1)
    min_kappa: float | None = Field(ge=-1, le=1)
