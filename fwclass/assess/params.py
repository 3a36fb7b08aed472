"""Parameters of the assessment."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from fwclass.params import Params


class AssessParams(Params):
    """What is reported, and what accuracy is asked for; numbers and sources stand in `conf/base.yaml`.

    `block`: edge of the squares of the global grid [m] that intervals are drawn from. A remark stands beside the
    accuracy where a share of at least `pure` of the tested echoes lies in squares of one class, where a share of less
    than `tested` of all echoes is tested, and where more than `unscored` of them have a reference that no class counts.
    """

    block: float = Field(ge=0.1, le=100_000)
    quantiles: tuple[Annotated[float, Field(ge=0, le=1)], ...] = Field(min_length=1, max_length=100)
    pure: float = Field(ge=0, le=1)
    tested: float = Field(ge=0, le=1)
    unscored: float = Field(ge=0, le=1)
    min_overall_accuracy: float | None = Field(ge=0, le=1)
    min_kappa: float | None = Field(ge=-1, le=1)
