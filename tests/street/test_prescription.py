"""Segments from answers whose crowns are known."""

import math

import numpy as np
import pytest
from streetmaker import config

from fwclass.street.answers import Answer
from fwclass.street.prescription import segments
from fwclass.street.prescription_map import write_map


def answers(speed=1.0, frames=80):
    """A crown from x = 0.5 to 1.25 m, 4 to 5 m to the right, 1 to 3 m above the scanner."""
    y, z = np.meshgrid(np.arange(-4.95, -4.0, 0.1), np.arange(1.05, 3.0, 0.1))
    y, z = y.ravel().astype(np.float32), z.ravel().astype(np.float32)
    for k in range(frames):
        place = speed * 0.025 * k
        crown = 5 if 0.5 <= place < 1.25 else 2
        codes = np.full(len(y), crown, np.uint8)
        yield Answer(k, 0.025 * k, place, codes, np.full(len(y), 90, np.uint8), y, z)


def test_a_crown_becomes_segments():
    params = config().street
    made = list(segments(answers(), params, 5))
    assert [(s.begin, s.end, s.side) for s in made] == [
        (0.5, 0.75, "right"),
        (0.75, 1.0, "right"),
        (1.0, 1.25, "right"),
    ]
    for s in made:
        assert (s.low, s.high, s.near, s.far) == pytest.approx((2.85, 4.75, 4.05, 4.95), abs=0.01)
        assert s.returns == 10 * 200
        assert s.volume == pytest.approx(0.25 * 1.0 * 2.0, rel=0.25)  # whole voxels
        assert s.speed == pytest.approx(1.0, rel=1e-6)
        assert s.seconds == pytest.approx(1.5 - 0.25 - 0.3)


def test_a_nozzle_too_near_has_no_time_left():
    params = config("street.prescription.nozzle=0.2").street
    assert all(s.seconds < 0 for s in segments(answers(), params, 5))


def test_a_vehicle_that_stands_has_no_speed():
    made = list(
        segments(
            (
                Answer(k, 0.025 * k, 0.6, a.classification, a.confidence, a.y, a.z)
                for k, a in enumerate(list(answers())[25:45])
            ),
            config().street,
            5,
        )
    )
    assert len(made) == 1
    assert made[0].speed == 0 or math.isnan(made[0].speed)
    assert math.isnan(made[0].seconds)


def test_the_map_is_read_by_geopandas(tmp_path):
    geopandas = pytest.importorskip("geopandas")
    made = list(segments(answers(), config().street, 5))
    write_map(tmp_path / "p.parquet", made)
    frame = geopandas.read_parquet(tmp_path / "p.parquet")
    assert frame.crs is None
    assert list(frame.total_bounds) == pytest.approx([0.5, -4.95, 1.25, -4.05], abs=0.01)
    assert frame.geometry.is_valid.all()
    write_map(tmp_path / "none.parquet", [])
    assert len(geopandas.read_parquet(tmp_path / "none.parquet")) == 0
