"""Whether a survey is as good as was asked for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fwclass.errors import QualityError, refuse_unsound
from fwclass.quality.check_points import of_another_datum
from fwclass.quality.params import QualityParams
from fwclass.quality.strips import farthest_pair


def judge_check_points(facts: Mapping[str, Any] | None, accepted: bool, where: object) -> None:
    """`QualityError` where check points have heights of another system (`of_another_datum`); nothing where the user
    accepts it."""
    refuse_unsound(
        of_another_datum(facts),
        accepted,
        "the check points' heights are not the survey's",
        where,
        expected="differences of decimetres at most in the mean",
        do="bring both into one vertical system and unit; --accept-implausible (plausibility.accept=true) takes them "
        "as they are",
    )


def judge_quality(summary: Mapping[str, Any], params: QualityParams) -> None:
    """`QualityError` naming the first figure of ``quality.json`` that misses its threshold, or that has no value."""
    density, strips, covered = summary["density"], summary["strips"], _of(summary["coverage"], "share")
    least = (
        ("min_density", "echoes per m²", density["echoes"], params.min_density),
        ("min_pulse_density", "pulses per m²", density["pulses"], params.min_pulse_density),
        ("min_coverage", "the share of the area that is covered", covered, params.min_coverage),
    )
    largest = max((v["area"] for v in summary["voids"]["largest"]), default=0.0)
    pair = farthest_pair(strips)
    farthest = None if pair is None else pair["offset"]["distance"]
    rmse = _of(_of(summary["check_points"], "all"), "rmse")
    most = (
        ("max_void", "the largest void [m²]", largest, params.max_void),
        ("max_dz", "the root mean square difference of strips [m]", strips["rms"], params.max_dz),
        ("max_offset", "the largest offset of strips in plan [m]", farthest, params.max_offset),
        ("max_noise", "the share of noise", summary["noise_share"], params.max_noise),
        ("max_rmse_z", "the root mean square difference from check points [m]", rmse, params.max_rmse_z),
    )
    for sign, words, bounds in ((1, "at least", least), (-1, "at most", most)):
        for setting, what, value, bound in bounds:
            if bound is not None and (value is None or sign * value < sign * bound):
                raise QualityError(
                    f"{what} misses its threshold" if value is not None else f"nothing tells {what}",
                    where=f"quality.{setting}",
                    expected=f"{words} {bound:g}",
                    got="no value" if value is None else f"{value:.4g}",
                    do="look at quality.html, which tells where and why; or ask for less",
                )


def _of(facts: Mapping[str, Any] | None, name: str) -> Any:
    return None if facts is None else facts[name]
