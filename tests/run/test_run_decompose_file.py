"""`fwclass decompose` with a trajectory, a coordinate system of the user's, and what it tells."""

from __future__ import annotations

import laspy
import numpy as np
import pytest
from lasmaker import METRES_PER_NS, digitise, gaussian, survey, write_las

from fwclass.errors import ConfigError, InputError
from fwclass.single_file.decompose import decompose_file

HEIGHT = 800.0


def flight(path, source, east=0.0, swap=False):
    """A trajectory straight above the points of `source`, `HEIGHT` m over their mean, moved by `east` [m]."""
    las = laspy.read(source)
    t = np.linspace(las.gps_time.min() - 1.0, las.gps_time.max() + 1.0, 50)
    x, y = np.full(50, np.mean(las.x) + east), np.full(50, np.mean(las.y))
    x, y = (y, x) if swap else (x, y)
    rows = np.column_stack([t, x, y, np.full(50, np.mean(las.z) + HEIGHT)])
    path.write_text("gps_time,x,y,z\n" + "\n".join(",".join(f"{v:.4f}" for v in row) for row in rows))
    return path


def test_ranges_from_a_trajectory(tmp_path):
    truth = survey(tmp_path / "a.las", pulses=60)
    told, _ = decompose_file(truth.path, tmp_path / "b.laz", (), False, flight(tmp_path / "t.csv", truth.path))
    assert "0 echoes without a range" in told and "beams point at it to" in told
    made = laspy.read(tmp_path / "b.laz")
    assert (np.abs(made["range"] - HEIGHT) < 100.0).all()
    assert "Reflectance" not in made.point_format.extra_dimension_names, "no constant, no reflectance"
    assert (made["radiometry flags"] & 32 > 0).all()
    known = ("radiometry.calibration=1e-15",)
    decompose_file(truth.path, tmp_path / "c.laz", known, False, flight(tmp_path / "t.csv", truth.path))
    assert (laspy.read(tmp_path / "c.laz")["Reflectance"] > -300.0).any()


@pytest.mark.parametrize("wrong", [{"east": 2000.0}, {"swap": True}])
def test_a_trajectory_of_another_place_is_refused(tmp_path, wrong):
    truth = survey(tmp_path / "a.las", pulses=60)
    path = flight(tmp_path / "t.csv", truth.path, **wrong)
    with pytest.raises(InputError, match="does not belong to the survey"):
        decompose_file(truth.path, tmp_path / "b.laz", (), False, path)
    assert not (tmp_path / "b.laz").exists()


def test_the_user_s_coordinate_system_wins(tmp_path):
    truth = survey(tmp_path / "a.las", pulses=20)
    decompose_file(truth.path, tmp_path / "b.laz", (), False, crs="EPSG:25832")
    with laspy.open(tmp_path / "b.laz") as file:
        assert file.header.parse_crs().to_epsg() == 25832
    with pytest.raises(ConfigError, match="not a coordinate system"):
        decompose_file(truth.path, tmp_path / "c.laz", (), False, crs="Mercator's")


def test_a_setting_without_effect_is_refused(tmp_path):
    truth = survey(tmp_path / "a.las", pulses=5)
    with pytest.raises(ConfigError, match="no effect"):
        decompose_file(truth.path, tmp_path / "b.laz", ("tile.size=50",), False)


def test_returns_that_no_echo_explains_are_told(tmp_path):
    """A vendor's second return where the waveform shows nothing, 10 ns after the first."""
    rng = np.random.default_rng(5)
    n = 40
    rows = [gaussian(60, [(100.0, 20.0, 3.5)]) + rng.normal(0.0, 1.0, 60) for _ in range(n)]
    pulse = np.repeat(np.arange(n), 2)
    late = np.tile([0.0, 10.0], n)
    path = write_las(
        tmp_path / "a.las",
        np.column_stack([pulse, pulse * 0.0, 100.0 - late * METRES_PER_NS]),
        waveforms=[digitise(y) for y in rows],
        pulse=pulse,
        return_number=late / 10.0 + 1,
        number_of_returns=2,
        location=20.0 + late,
        gps_time=pulse * 1e-5,
    )
    told, _ = decompose_file(path, tmp_path / "b.laz", (), False)
    assert f"{n} returns have no echo within 5 ns" in told
    wide, _ = decompose_file(path, tmp_path / "c.laz", ("decompose.vendor_tolerance=12",), False)
    assert "no echo within" not in wide


@pytest.mark.parametrize("point_format", [9, 10])
def test_channels_of_a_scanner_that_fire_at_one_time_are_pulses_of_their_own(tmp_path, point_format):
    """Two pulses of two channels have one GPS time: nothing is told apart by it."""
    made = []
    for name, together in (("apart", 1), ("same", 2)):
        pulse = survey(tmp_path / "a.las", pulses=60).pulse
        words = {"gps_time": 1000.0 + 1e-5 * (pulse // together), "channel": pulse % 2, "point_format": point_format}
        truth = survey(tmp_path / f"{name}.las", pulses=60, **words)
        decompose_file(truth.path, tmp_path / f"{name}.laz", (), False)
        made.append(laspy.read(tmp_path / f"{name}.laz"))
    apart, same = made
    assert set(laspy.read(tmp_path / "same.las").scanner_channel) == {0, 1}
    for name in ("x", "y", "z", "intensity", "return_number", "number_of_returns", "pulse"):
        np.testing.assert_array_equal(apart[name], same[name])
