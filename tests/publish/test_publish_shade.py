"""Light at the borders of a terrain."""

from __future__ import annotations

import numpy as np
import pytest
from tolerances import FLOAT32_UNIT

from fwclass.publish.params import PublishParams
from fwclass.publish.shade import flat_light, hillshade, slope_along


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


def test_a_cell_alone_is_level() -> None:
    heights = np.full((5, 6), np.nan)
    heights[2, 3] = 7.0
    assert (slope_along(heights, 0) == 0).all()
    assert (slope_along(heights[:1], 0) == 0).all()
    assert slope_along(np.arange(6.0).reshape(1, 6), 1)[0, 0] == 1.0


def test_a_step_is_halved_on_both_sides() -> None:
    np.testing.assert_array_equal(slope_along(np.array([[0.0, 0.0, 1.0, 1.0]]), 1), [[0.0, 0.5, 0.5, 0.0]])
