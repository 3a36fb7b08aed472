"""How a scanner is mounted: its beams' directions on the vehicle."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tolerances import FLOAT64_UNIT

from fwclass import conf
from fwclass.street.frames import Geometry, Scan


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("turns", [(12.0, 0.0, 0.0), (0.0, 10.0, 0.0), (0.0, 0.0, -20.0), (-7.0, 5.0, 8.0)])
def test_turns_are_right_handed_about_x_y_and_z_on_both_sides(side: str, turns: tuple[float, float, float]) -> None:
    """Roll turned a scanner on the right the other way: 0.6 m at 6 m for one of 3 degrees."""
    names = dict(zip(("roll", "pitch", "yaw"), turns, strict=True))
    mounting = conf.section("street").mounting.model_copy(update={"side": side, **names})
    angle = np.linspace(-0.8, 3.9, 95)
    flat = np.stack([0 * angle, (1 if side == "left" else -1) * np.cos(angle), np.sin(angle)], axis=1)
    expected = Rotation.from_euler("xyz", turns, degrees=True).apply(flat)
    scan = Scan(95, -0.8, 4.7 / 94, 0.05, 30.0)
    np.testing.assert_allclose(Geometry.of(scan, mounting).direction, expected, atol=FLOAT64_UNIT)
