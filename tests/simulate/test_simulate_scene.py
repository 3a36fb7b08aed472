"""The scene: the search finds what brute force finds, and the distributions look like Fan 2013's Table 1."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from defaults import BASE
from scipy.spatial import cKDTree
from tolerances import FLOAT64_UNIT

from fwclass.simulate.city import build_scene
from fwclass.simulate.flight import fire, plan_strips
from fwclass.simulate.params import SimulateParams
from fwclass.simulate.stage import simulate_strip
from fwclass.simulate.trace import FOOTPRINT, MAX_CANDIDATES, _through, gather, to_ground


def settings(**changes: Any) -> SimulateParams:
    base = BASE["simulate"]
    return SimulateParams(**{**base, "size": 110.0, "strips": 3, "seed": 4, **changes})


@pytest.mark.statistics
def test_search_finds_every_thing_in_the_beam() -> None:
    params = settings()
    scene = build_scene(params)
    out = np.zeros(MAX_CANDIDATES, np.int64)
    met = 0
    for plan in plan_strips(params):
        pulses = fire(params, plan, 0, plan.pulses)
        for p in range(0, plan.pulses, 41):
            o, d = pulses.origin[p], pulses.direction[p]
            t = to_ground(scene.height, scene.margin, scene.step, *o, *d, 300.0, 25)
            n = gather(scene.size, scene.cell, scene.start, scene.item, scene.ceiling, scene.box, *o, *d, t, out)
            assert n < MAX_CANDIDATES
            exact = []
            for b in range(len(scene.box)):
                t0, t1 = _through(scene.box, b, FOOTPRINT, *o, *d, t + 2.0)
                if t0 <= t1:
                    exact.append(b)
            x, y = o[0] + t * d[0], o[1] + t * d[1]
            if 2.0 < x < params.size - 2.0 and 2.0 < y < params.size - 2.0:
                assert sorted(out[:n].tolist()) == exact
                met += len(exact)
    assert met > 200


def test_things_of_every_kind_stand_in_the_demo() -> None:
    scene = build_scene(settings(size=300.0, strips=4))
    assert {5, 6, 64} <= set(np.unique(scene.solid_class).tolist())
    assert set(np.unique(scene.crown[:, 0]).astype(int)) == {0, 1, 2}
    assert np.any((scene.solid_open > 0) & (scene.solid_open < 1))
    assert (scene.herbs > 0).mean() > 0.02
    tops = scene.crown[:, 4] - scene.crown[:, 3]
    assert tops.max() < 28 and tops.min() < 1.0
    # normals of the solids are unit vectors
    np.testing.assert_allclose(np.linalg.norm(scene.planes[:, :3], axis=1), 1.0, atol=FLOAT64_UNIT)


@pytest.mark.slow
def test_distributions_look_like_the_papers_table(tmp_path: Path) -> None:
    """Fan 2013, Table 1: zc, inclination, echo ratio, amplitude and echoes of ground, building and trees."""
    params = settings(size=300.0, strips=4)
    for plan in plan_strips(params):
        simulate_strip(params, plan, tmp_path)
    parts = [laspy.read(path) for path in sorted((tmp_path / "reference").glob("*.las"))]
    xyz = np.concatenate([np.column_stack([p.x, p.y, p.z]) for p in parts])
    code = np.concatenate([np.asarray(p.classification) for p in parts])
    amplitude = np.concatenate([np.asarray(p.amplitude) for p in parts])
    width = np.concatenate([np.asarray(p.width) for p in parts])
    echoes = np.concatenate([np.asarray(p.number_of_returns) for p in parts])
    ground, building, vegetation, tree = code == 2, code == 6, np.isin(code, (3, 4, 5)), code == 5

    shares = [float(np.mean(m)) for m in (ground, building, vegetation, code == 64)]
    for share, (low, high) in zip(shares, ((0.40, 0.60), (0.12, 0.27), (0.22, 0.38), (0.015, 0.05)), strict=True):
        assert low < share < high
    assert 1.2 < (echoes == 1).size / np.sum(1.0 / echoes) < 1.4  # echoes per pulse
    assert 3.5 < len(xyz) / params.size**2 < 4.5

    cell = np.floor(xyz[:, 0] / 12.0) * 1e6 + np.floor(xyz[:, 1] / 10.0)
    names, inverse = np.unique(cell, return_inverse=True)
    lowest = np.full(len(names), np.inf)
    np.minimum.at(lowest, inverse, xyz[:, 2])
    zc = xyz[:, 2] - lowest[inverse]
    assert np.median(zc[ground]) < 0.6
    assert 3.0 < np.median(zc[building]) < 10.0
    low, high = np.percentile(zc[vegetation], [5, 95])
    assert 0.2 < low < 1.5 and 8.0 < high < 20.0

    some = np.random.default_rng(0).permutation(len(xyz))[:20000]
    sphere = cKDTree(xyz).query_ball_point(xyz[some], 1.0, return_length=True)
    cylinder = cKDTree(xyz[:, :2]).query_ball_point(xyz[some, :2], 1.0, return_length=True)
    ratio = sphere / cylinder
    assert np.median(ratio[ground[some]]) > 0.95
    assert np.median(ratio[building[some]]) > 0.85
    assert np.percentile(ratio[tree[some]], 75) < 0.6

    assert np.median(amplitude[tree]) < 0.5 * np.median(amplitude[ground])
    assert np.percentile(amplitude[vegetation], 95) > np.percentile(amplitude[ground], 15)  # they overlap
    assert np.median(width[tree]) > np.percentile(width[ground], 75)
    assert np.mean(echoes[ground] == 1) > 0.8 and np.mean(echoes[building] == 1) > 0.85
    assert np.mean(echoes[tree] > 1) > 0.6
