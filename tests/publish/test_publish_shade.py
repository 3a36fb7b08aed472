"""Light at the borders of a terrain."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from tolerances import FLOAT32_UNIT

from fwclass.publish.params import PublishParams
from fwclass.publish.shade import _light, flat_light, hillshade, slope, slope_along


def test_the_border_of_a_slope_is_lit_as_the_slope(params: PublishParams) -> None:
    """A hole, a coast and the raster's edge change nothing of a plane's light, which is one value everywhere."""
    plane = np.add.outer(0.3 * np.arange(20), -0.2 * np.arange(30)).astype(np.float32)
    whole = hillshade(plane, 1.0, params)
    holed = plane.copy()
    holed[5:9, 5:9], holed[:, 25:] = np.nan, np.nan
    light = hillshade(holed, 1.0, params)
    known = np.isfinite(holed)
    assert light[known] == pytest.approx(whole[known], abs=FLOAT32_UNIT)
    assert light[~known] == pytest.approx(flat_light(params))
    assert abs(whole[3, 3] - flat_light(params)) > 0.05


@pytest.mark.parametrize(("east", "north"), [(0.0, 0.0), (1.0, 0.0), (0.3, -0.4), (-9.0, 2.0)])
def test_the_slope_of_a_plane_is_its_angle(east: float, north: float) -> None:
    cell = 0.5
    plane = 800 + cell * np.add.outer(north * np.arange(9), east * np.arange(12))
    angle = np.degrees(np.arctan(np.hypot(east, north)))
    np.testing.assert_allclose(slope(plane.astype(np.float32), cell), np.full((7, 10), angle), atol=0.01)


def test_slope_is_horns_of_nine_heights_or_none() -> None:
    z = np.random.default_rng(2).normal(100, 3, (8, 9)).astype(np.float32)
    z[3, 4] = np.nan
    out = slope(z, 2.0)
    for row in range(1, 7):
        for col in range(1, 8):
            (g, h, i), (d, e, f), (a, b, c) = z[row - 1 : row + 2, col - 1 : col + 2].astype(float).tolist()
            east, north = ((c + 2 * f + i) - (a + 2 * d + g)) / 16, ((a + 2 * b + c) - (g + 2 * h + i)) / 16
            wanted = np.degrees(np.arctan(np.hypot(east, north))) if np.isfinite(e) else np.nan
            assert out[row - 1, col - 1] == pytest.approx(wanted, rel=1e-6, nan_ok=True)


def test_a_cell_alone_is_level() -> None:
    heights = np.full((5, 6), np.nan)
    heights[2, 3] = 7.0
    assert (slope_along(heights, 0) == 0).all()
    assert (slope_along(heights[:1], 0) == 0).all()
    assert slope_along(np.arange(6.0).reshape(1, 6), 1)[0, 0] == 1.0


def test_a_step_is_halved_on_both_sides() -> None:
    np.testing.assert_array_equal(slope_along(np.array([[0.0, 0.0, 1.0, 1.0]]), 1), [[0.0, 0.5, 0.5, 0.0]])


@pytest.mark.parametrize("shape", [(700, 1100), (3, 400_000), (400_000, 2), (0, 5), (5, 0)])
def test_light_strip_by_strip_is_that_of_the_whole(shape: tuple[int, int], params: PublishParams) -> None:
    r = np.random.default_rng(1)
    dtm = r.normal(0, 1, shape).astype(np.float32)
    dtm[r.random(shape) < 0.2] = np.nan
    assert np.array_equal(hillshade(dtm, 0.5, params), _light(dtm, 0.5, params))


def test_lighting_takes_memory_for_its_rasters_alone(params: PublishParams) -> None:
    """A survey of two places far apart has a map of millions of empty cells."""
    dtm = np.zeros((2000, 2000), np.float32)
    tracemalloc.start()
    hillshade(dtm, 1.0, params)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 3 * dtm.nbytes
