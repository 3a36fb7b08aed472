"""Files in degrees, or geocentric, brought into a projected system: places of echoes against a truth that pyproj made
point by point."""

from __future__ import annotations

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
from commandline import fwclass
from lasmaker import METRES_PER_NS, digitise, gaussian, write_las
from plsmaker import Descriptor as PulseDescriptor
from plsmaker import Pulse, Sampling, write_pls
from pyproj import CRS, Transformer

from fwclass.read.info import info

UTM = "EPSG:32633"


def truth(n=300, seed=1, height=600.0):
    """Ground places on a slope and the sensor's, in UTM 33."""
    rng = np.random.default_rng(seed)
    x = 640_000.0 + np.arange(n) * 0.7
    ground = np.stack([x, 5_400_000.0 + rng.uniform(-150.0, 150.0, n), np.zeros(n)], axis=1)
    ground[:, 2] = 240.0 + 0.02 * (ground[:, 0] - x[0])
    sensor = np.stack([x, np.full(n, 5_400_000.0), np.full(n, 240.0 + height)], axis=1)
    return ground, sensor


def converted(places, system):
    way = Transformer.from_crs(CRS(32633).to_3d(), CRS.from_user_input(system), always_xy=True)
    return np.stack(way.transform(*places.T), axis=1)


def in_degrees(path, ground, sensor):
    """A LAS file in degrees: steps of the beam are degrees, and metres in z, a nanosecond."""
    n = len(ground)
    up = (sensor - ground) / np.linalg.norm(sensor - ground, axis=1, keepdims=True)
    here, there = converted(ground, 4979), converted(ground + 10.0 * up, 4979)
    step = (there - here) / (10.0 / METRES_PER_NS)
    rng = np.random.default_rng(2)
    at = rng.uniform(24.0, 26.0, n)
    waves = [digitise(gaussian(60, [(120.0, t, 3.5)], 10.0) + rng.normal(0, 1.0, 60)) for t in at]
    return write_las(
        path,
        here,
        waveforms=waves,
        pulse=np.arange(n),
        location=at,
        step=step,
        scale=1e-8,
        gps_time=1e-4 * np.arange(n),
        keys={1024: 2, 2048: 4326},
    )


FEET = 1200.0 / 3937.0


def in_feet(path, ground, sensor, heights=6360, plane=32666, longer=1.0):
    """A LAS file in US survey feet of a `plane` (UTM zone 16), or with heights in metres; its beam vectors are so
    many times `longer`."""
    n, unit = len(ground), np.array([FEET, FEET, FEET if heights == 6360 else 1.0])
    up = (sensor - ground) / np.linalg.norm(sensor - ground, axis=1, keepdims=True)
    rng = np.random.default_rng(2)
    at = rng.uniform(24.0, 26.0, n)
    return write_las(
        path,
        ground / unit,
        waveforms=[digitise(gaussian(60, [(120.0, t, 3.5)], 10.0) + rng.normal(0, 1.0, 60)) for t in at],
        pulse=np.arange(n),
        location=at,
        step=longer * METRES_PER_NS * up / unit,
        gps_time=1e-4 * np.arange(n),
        keys={3072: plane, 4096: heights},
    )


def geocentric(path, ground, sensor):
    """A Pulse file that counts from the middle of the earth."""
    here, there = converted(sensor, 4978), converted(ground, 4978)
    rng = np.random.default_rng(3)
    pulses = []
    for k, (a, b) in enumerate(zip(np.round(here, 3), there, strict=True)):
        time = np.linalg.norm(b - a) / METRES_PER_NS
        begin = np.floor(time - 20.0)
        y = gaussian(60, [(150.0, time - begin, 3.5)], 10.0) + rng.normal(0, 1.0, 60)
        pulses.append(Pulse(a, b - a, [[(begin, digitise(y))]], time=1000.0 + 1e-4 * k))
    return write_pls(path, pulses, {1: PulseDescriptor([Sampling()])}, keys={1024: 3, 2048: 4978})


@pytest.mark.parametrize(("write", "name"), [(in_degrees, "a.las"), (geocentric, "a.pls")])
def test_echoes_lie_where_the_truth_is_in_the_system_that_is_named(tmp_path, write, name):
    ground, sensor = truth()
    path = write(tmp_path / name, ground, sensor)
    refused = fwclass("decompose", path, tmp_path / "o.laz")
    assert refused.returncode == 1 and "fwclass decompose --crs" in refused.stderr
    ended = fwclass("decompose", path, tmp_path / "o.laz", "--crs", UTM)
    assert ended.returncode == 0, ended.stderr
    las = laspy.read(tmp_path / "o.laz")
    assert las.header.parse_crs().to_epsg() == 32633
    places = np.stack([las.x, las.y, las.z], axis=1)
    assert 300 <= len(places) <= 303
    off = np.array([np.linalg.norm(places - there, axis=1).min() for there in ground])
    assert np.median(off) < 0.01 and np.quantile(off, 0.99) < 0.02


@pytest.mark.parametrize("heights", [6360, 5703])
def test_waveforms_in_feet_are_metres_where_the_truth_is(tmp_path, heights):
    ground, sensor = (place - np.array([0.0, 1e6, 0.0]) for place in truth())  # in the United States
    path = in_feet(tmp_path / "a.las", ground, sensor, heights)
    ended = fwclass("decompose", path, tmp_path / "o.laz", "--set", "read.project_to=EPSG:32616+5703")
    assert ended.returncode == 0, ended.stderr
    las = laspy.read(tmp_path / "o.laz")
    off = np.array([np.linalg.norm(las.xyz - there, axis=1).min() for there in ground])
    assert np.median(off) < 0.01 and np.quantile(off, 0.99) < 0.02
    assert [p.to_epsg() for p in las.header.parse_crs().sub_crs_list] == [32616, 5703]


@pytest.mark.parametrize("heights", [6360, 5703])
def test_pulses_in_feet_are_metres_where_the_truth_is(tmp_path, heights):
    """Ranges, from the optical centre, which is the anchor here, are metres too."""
    ground, sensor = (place - np.array([0.0, 1e6, 0.0]) for place in truth())
    unit = np.array([FEET, FEET, FEET if heights == 6360 else 1.0])
    rng = np.random.default_rng(3)
    pulses = []
    for k, (a, b) in enumerate(zip(sensor, ground, strict=True)):
        way = b - a
        time = np.linalg.norm(way) / METRES_PER_NS
        speed = np.linalg.norm(way / unit) / time
        begin = np.floor(time - 20.0)
        y = gaussian(60, [(150.0, time - begin, 3.5)], 10.0) + rng.normal(0, 1.0, 60)
        pulses.append(Pulse(a / unit, way / unit, [[(begin, digitise(y))]], time=1000.0 + 1e-4 * k, speed=speed))
    keys = {1024: 1, 3072: 32666, 4096: heights}
    path = write_pls(tmp_path / "a.pls", pulses, {1: PulseDescriptor([Sampling()])}, keys=keys)
    refused = fwclass("decompose", path, tmp_path / "o.laz")
    assert refused.returncode == 1 and "--set read.project_to=EPSG:<code> brings" in refused.stderr, refused.stderr
    ended = fwclass("decompose", path, tmp_path / "o.laz", "--set", "read.project_to=EPSG:32616+5703")
    assert ended.returncode == 0, ended.stderr
    las = laspy.read(tmp_path / "o.laz")
    off = np.array([np.linalg.norm(las.xyz - there, axis=1).min() for there in ground])
    assert np.median(off) < 0.01 and np.quantile(off, 0.99) < 0.02
    away = np.array([np.linalg.norm(sensor[int(k)] - ground[int(k)]) for k in las["pulse"]])
    assert np.median(np.abs(np.asarray(las["range"]) - away)) < 0.02


def test_no_setting_is_named_that_is_set(tmp_path):
    """The remedy for vectors that are still too long in metres was to bring the file into metres."""
    ground, sensor = (place - np.array([0.0, 1e6, 0.0]) for place in truth(60))
    path = in_feet(tmp_path / "a.las", ground, sensor, longer=1 / FEET)
    brought = fwclass("decompose", path, tmp_path / "o.laz", "--set", "read.project_to=EPSG:32616+5703")
    assert brought.returncode == 1 and "export it again with beam vectors in m/ps (they are 3.28" in brought.stderr
    assert "project_to" not in brought.stderr and "into metres" not in brought.stderr


def test_info_takes_a_system_in_feet_at_its_word(tmp_path):
    """No waveform could be read, it said, of files that a run reads."""
    ground, sensor = (place + np.array([-340_000.0, -5_339_000.0, 0.0]) for place in truth(60))
    las = in_feet(tmp_path / "a.las", ground, sensor, plane=2263)
    pulses = [
        Pulse(
            a / FEET,
            b - a,
            [[(3990.0, digitise(gaussian(60, [(150.0, 13.0, 3.5)], 10.0)))]],
            speed=METRES_PER_NS / FEET,
        )
        for a, b in zip(sensor, ground, strict=True)
    ]
    pls = write_pls(tmp_path / "b.pls", pulses, {1: PulseDescriptor([Sampling()])}, keys={3072: 2263, 4096: 6360})
    for path in (las, pls):
        told = info(path)
        assert told["waveforms"]["usable"] == 60
        assert not [fault for fault in told["faults"] if "WAVEFORM" in fault or "beam" in fault], told["faults"]
        assert abs(told["bounds"][2] * FEET - 240.0) < 10.0
        refused = fwclass("decompose", path, tmp_path / "o.laz")
        assert "--set read.project_to=EPSG:32118+5703 brings" in refused.stderr, refused.stderr


def test_beams_in_metres_through_places_in_degrees_are_refused(tmp_path):
    """Metres along x were taken for degrees: echoes of single returns lay kilometres away, in silence."""
    ground, sensor = truth()
    path = in_degrees(tmp_path / "a.las", ground, sensor)
    las = laspy.read(path)
    up = METRES_PER_NS * 1e-3 * (sensor - ground) / np.linalg.norm(sensor - ground, axis=1, keepdims=True)
    for name, values in zip(("x_t", "y_t", "z_t"), up.T, strict=True):
        las.points.array[name] = values
    las.write(path)
    ended = fwclass("decompose", path, tmp_path / "o.laz", "--crs", UTM)
    assert ended.returncode == 1 and "not in the units of their places" in ended.stderr, ended.stderr


@pytest.mark.parametrize(("crs", "words"), [("EPSG:4326", "in degrees"), ("EPSG:2263", "one of metres on a plane")])
def test_a_system_that_is_none_of_metres_is_refused(tmp_path, crs, words):
    path = in_degrees(tmp_path / "a.las", *truth(60))
    ended = fwclass("decompose", path, tmp_path / "o.laz", "--crs", crs)
    assert ended.returncode == 1 and words in ended.stderr and "Traceback" not in ended.stderr
    assert not (tmp_path / "o.laz").exists()


@pytest.mark.parametrize(("write", "name"), [(in_degrees, "a.las"), (geocentric, "a.pls")])
def test_a_run_brings_files_into_the_system_of_its_configuration(tmp_path, write, name):
    ground, sensor = truth()
    path = write(tmp_path / name, ground, sensor)
    words = ("profile", path, "--out", tmp_path / "run", "--samples", "--workers", "0", "--set", "profile.least=1")
    refused = fwclass(*words)
    assert refused.returncode == 1 and "read.project_to" in refused.stderr, refused.stderr
    ended = fwclass(*words, "--crs", UTM)
    assert ended.returncode == 0, ended.stderr
    tables = [pq.read_table(p) for p in sorted((tmp_path / "run" / "samples").glob("*.parquet"))]
    x, y, z, energy = (
        np.concatenate([t.column(n).to_numpy() for t in tables]) for n in ("x", "y", "z", "returned_energy")
    )
    bright = np.stack([x, y, z], axis=1)[energy > np.quantile(energy, 0.9)]
    off = np.array([np.linalg.norm(ground - one, axis=1).min() for one in bright])
    assert np.median(off) < 0.15  # within a sample
    other = fwclass(*words, "--set", f"read.project_to={UTM}", "--set", "survey.crs=EPSG:32632")
    assert other.returncode == 2 and "another system than the survey" in other.stderr, other.stderr
