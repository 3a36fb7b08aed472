"""The smoothest tenth of level places is as rough as ranges are noisy, whatever stands beside."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fwclass.errors import QualityError
from fwclass.grid import Box, Window
from fwclass.quality.params import PlaneParams
from fwclass.quality.planes import planes_of
from fwclass.quality.roughness import (
    EDGES,
    LEAST,
    ROUGHEST,
    count_roughness,
    judge_roughness,
    roughness_facts,
    roughness_remarks,
)


@pytest.mark.parametrize("noise", [0.01, 0.03, 0.06, 0.3])
def test_it_is_the_noise(base: dict[str, Any], noise: float) -> None:
    r = np.random.default_rng(0)
    x, y = r.uniform(0, 160, (2, 60_000))
    z = 0.05 * x + r.normal(0, noise, len(x))
    z += np.where((x > 40) & (r.random(len(x)) < 0.4), r.uniform(1, 15, len(x)), 0.0)  # a wood on three quarters
    params = PlaneParams(**{**base["quality"]["planes"], "max_residual": ROUGHEST})
    window = Window.covering(Box(0.0, 0.0, 160.0, 160.0), params.cell)
    planes = planes_of(x, y, z, np.zeros(len(x), np.int64), window, params)
    facts = roughness_facts(count_roughness(planes.residual))
    assert facts["places"] > 200
    assert facts["smoothest"] == pytest.approx(noise, rel=0.25)
    assert bool(roughness_remarks(facts)) == (noise > 0.05)
    judge_roughness(facts, 0.12, noise == 0.3, "m")
    if noise == 0.3:
        with pytest.raises(QualityError, match="too noisy for a model"):
            judge_roughness(facts, 0.12, False, "m")
    with pytest.raises(QualityError, match=r"0\.\d+ m in the smoothest tenth of \d+ places"):  # below what is told, too
        judge_roughness(facts, 0.5 * noise, False, "m")
    judge_roughness(facts, 2.0 * noise, False, "m")
    smooth = planes.smooth(0.06)
    assert len(smooth.residual) == (planes.residual <= 60).sum() == len(smooth.a) and smooth.edge == planes.edge


def test_classes_add_up_and_few_tell_nothing() -> None:
    counts = count_roughness(np.array([0.0, 1.0, 1.2, 9_999.0, 20_000.0]))
    assert counts.sum() == 5 and counts[0] == 2 and counts[-1] == 1 and len(counts) == len(EDGES)
    assert roughness_facts(counts) == {"places": 5, "smoothest": None, "median": None}
    many = roughness_facts(counts * LEAST)
    assert many["smoothest"] == pytest.approx(0.001, rel=0.13)
    assert roughness_facts(np.zeros(len(EDGES), np.int64))["places"] == 0
