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
        do="bring both into one vertical system and unit",
    )


def judge_quality(summary: Mapping[str, Any], params: QualityParams) -> None:
    """`QualityError` naming the first figure of ``quality.json`` that misses its threshold, or that has no value."""
    for one in thresholds(summary, params):
        if not one["met"]:
            raise QualityError(
                f"{one['what']} misses its threshold" if one["value"] is not None else f"nothing tells {one['what']}",
                where=f"quality.{one['setting']}",
                expected=f"at {'least' if one['least'] else 'most'} {one['bound']:g}",
                got="no value" if one["value"] is None else f"{one['value']:.4g}",
                do="look at quality.html, which tells where and why; or ask for less",
            )


def thresholds(summary: Mapping[str, Any], params: QualityParams) -> list[dict[str, Any]]:
    """What is asked of the figures of ``quality.json``: ``setting``, ``what`` it is of, ``value`` (None: nothing tells
    it), ``bound``, whether that is the ``least``, and whether it is ``met``."""
    density, strips, covered = summary["density"], summary["strips"], _of(summary["coverage"], "share")
    largest = max((v["area"] for v in summary["voids"]["largest"]), default=0.0)
    pair = farthest_pair(strips)
    farthest = None if pair is None else pair["offset"]["distance"]
    rmse = _of(_of(summary["check_points"], "all"), "rmse")
    asked = (
        ("min_density", "echoes per m²", density["echoes"]),
        ("min_pulse_density", "pulses per m²", density["pulses"]),
        ("min_coverage", "the share of the area that is covered", covered),
        ("max_void", "the largest void [m²]", largest),
        ("max_dz", "the root mean square difference of strips [m]", strips["rms"]),
        ("max_offset", "the largest offset of strips in plan [m]", farthest),
        ("max_noise", "the share of noise", summary["noise_share"]),
        ("max_rmse_z", "the root mean square difference from check points [m]", rmse),
    )
    return [
        {
            "setting": setting,
            "what": what,
            "value": value,
            "bound": bound,
            "least": least,
            "met": value is not None and (value >= bound if least else value <= bound),
        }
        for setting, what, value in asked
        if (bound := getattr(params, setting)) is not None
        for least in (setting.startswith("min_"),)
    ]


def _of(facts: Mapping[str, Any] | None, name: str) -> Any:
    return None if facts is None else facts[name]
