"""Assessment of the classes against a reference, and the distribution of the features within the classes."""

from __future__ import annotations

from typing import Any

from fwclass.assess.params import AssessParams
from fwclass.errors import QualityError


def judge(result: dict[str, Any], params: AssessParams) -> None:
    """`QualityError` naming the first figure of `figures` that misses its threshold, or that has no value."""
    for key, least in (("overall_accuracy", params.min_overall_accuracy), ("kappa", params.min_kappa)):
        value = result[key]
        if least is not None and (value is None or value < least):
            raise QualityError(
                f"{key.replace('_', ' ')} misses its threshold",
                where=f"assess.min_{key}",
                expected=f"at least {least}",
                got="no echo with a reference" if value is None else f"{value:.4f}",
                do="look at the confusion matrix: more or better training areas, or a lower threshold",
            )


CONFUSION_VERSION, ASSESS_VERSION = 8, 10
"""Raised when the same classes and labels of a tile would give other counts, and the same counts other figures."""
