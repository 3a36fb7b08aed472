"""Assessment of the classes against a reference, and the distribution of the features within the classes."""

from __future__ import annotations

from typing import Any

from fwclass.assess.blocks import BlockCounts
from fwclass.assess.confusion import confusion, describe, figures, unclassified
from fwclass.assess.distribution import QUANTILES, distribution, packed, quantiles, summary, unpacked
from fwclass.assess.intervals import caution, difference, intervals
from fwclass.assess.params import AssessParams
from fwclass.errors import QualityError
from fwclass.stage import Stage

__all__ = [
    "ASSESS",
    "DISTRIBUTION",
    "QUANTILES",
    "AssessParams",
    "BlockCounts",
    "caution",
    "confusion",
    "describe",
    "difference",
    "distribution",
    "figures",
    "intervals",
    "judge",
    "packed",
    "quantiles",
    "summary",
    "unclassified",
    "unpacked",
]


def judge(made: dict[str, Any], params: AssessParams) -> None:
    """`QualityError` naming the first figure of `figures` that misses its threshold, or that has no value."""
    for key, least in (("overall_accuracy", params.min_overall_accuracy), ("kappa", params.min_kappa)):
        value = made[key]
        if least is not None and (value is None or value < least):
            raise QualityError(
                f"{key.replace('_', ' ')} misses its threshold",
                where=f"assess.min_{key}",
                expected=f"at least {least}",
                got="no echo with a reference" if value is None else f"{value:.4f}",
                do="look at the confusion matrix: more or better training areas, or a lower threshold",
            )


ASSESS = Stage(
    name="assess",
    version=1,
    kind="tile",
    function=confusion,
    params=AssessParams,
    reads=("reference", "classification"),
)
DISTRIBUTION = Stage(
    name="distribution", version=1, kind="tile", function=distribution, params=AssessParams, reads=("reference",)
)
