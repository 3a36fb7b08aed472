"""A threshold that is missed, or of which nothing is known, is told by its name."""

from __future__ import annotations

from typing import Any

import pytest

from fwclass.errors import QualityError
from fwclass.quality.judge import judge_quality
from fwclass.quality.params import QualityParams
from fwclass.quality.strips import strip_remarks

VOIDS = {"largest": [{"area": 40.0}, {"area": 20.0}]}
MADE: dict[str, Any] = {
    "voids": VOIDS,
    "density": {"echoes": 5.0, "pulses": 4.0},
    "strips": {"rms": 0.06, "between": [{"offset": {"distance": 0.2}}, {"offset": None}]},
    "noise_share": 0.001,
    "check_points": {"all": {"rmse": 0.08}},
    "coverage": {"share": 0.97},
}


@pytest.mark.parametrize(
    ("name", "met", "missed"),
    [
        ("min_density", 5.0, 5.1),
        ("min_pulse_density", 4.0, 4.1),
        ("max_dz", 0.06, 0.05),
        ("max_offset", 0.2, 0.19),
        ("max_void", 40.0, 39.0),
        ("max_noise", 0.001, 0.0),
        ("max_rmse_z", 0.08, 0.079),
        ("min_coverage", 0.97, 0.98),
    ],
)
def test_each_threshold_judges_its_own_figure(base: dict[str, Any], name: str, met: float, missed: float) -> None:
    judge_quality(MADE, QualityParams(**base["quality"]))
    judge_quality(MADE, QualityParams(**{**base["quality"], name: met}))
    with pytest.raises(QualityError, match=f"quality.{name}"):
        judge_quality(MADE, QualityParams(**{**base["quality"], name: missed}))


def test_what_nobody_knows_meets_no_threshold(base: dict[str, Any]) -> None:
    unknown = {
        "voids": VOIDS,
        "density": {"echoes": None, "pulses": None},
        "strips": {"rms": None, "between": []},
        "noise_share": None,
        "check_points": None,
        "coverage": None,
    }
    with pytest.raises(QualityError, match="nothing tells the root mean square difference"):
        judge_quality(unknown, QualityParams(**{**base["quality"], "max_dz": 0.1}))
    with pytest.raises(QualityError, match="nothing tells the root mean square difference from check points"):
        judge_quality({**unknown, "check_points": {"all": None}}, QualityParams(**{**base["quality"], "max_rmse_z": 1}))


@pytest.mark.parametrize(("apart", "pairs", "told"), [(74, 8, True), (30, 0, True), (5, 0, False), (40, 60, False)])
def test_strips_that_lie_metres_apart_are_told(apart: int, pairs: int, told: bool) -> None:
    """Beams of a wrong sign put strips so far apart that hardly a pair counted, and nothing was said."""
    strip = {"times": [0.0, 1.0], "pairs": pairs, "group": 0}
    facts = {"strips": [strip, strip], "pairs": pairs, "apart": apart, "by": "files", "between": []}
    said = [r for r in strip_remarks(facts) if "further apart than one surface can" in r]
    assert bool(said) == told and (not told or f"{apart} of {apart + pairs}" in said[0])
