"""Beams that come from below, or from nowhere: which of sign, axis and unit is wrong, and what mends it."""

from __future__ import annotations

import laspy
import numpy as np
import pytest
from commandline import process
from lasmaker import METRES_PER_NS, digitise, gaussian, survey, write_las
from lasmaker import Descriptor as OfLas
from plsmaker import OUTGOING, Descriptor, Pulse, Sampling, write_pls
from rawmaker import HALF_LIGHT, scene, write_csv, write_parquet

from fwclass.errors import InputError
from fwclass.read.info import info
from fwclass.read.params import ReadParams
from fwclass.read.source import open_source
from fwclass.read.stage import check_source, index_source, read_span

PULSES, HEIGHT = 240, 700.0
TURNS = {
    "right": lambda v: v,
    "mirrored": lambda v: v * (-1.0, -1.0, 1.0),
    "reversed": lambda v: -v,
    "x": lambda v: v * (-1.0, 1.0, 1.0),
    "y": lambda v: v * (1.0, -1.0, 1.0),
    "exchanged": lambda v: v[..., [1, 0, 2]],
}
WORDS = {
    "mirrored": "below the ground: the sign of their horizontal parts",
    "reversed": "the sign of the whole vectors",
    "x": "the sign of their x",
    "y": "the sign of their y",
    "exchanged": "axes x and y are exchanged",
}


@pytest.fixture
def params(base) -> ReadParams:
    return ReadParams(**base["read"])


def scan(rng):
    """Sensor's places and unit vectors down of an oblique scan line, and true places on rough ground."""
    k = np.arange(PULSES)
    tilt = np.linspace(-0.3, 0.3, PULSES)
    away = np.c_[np.sin(tilt) * 0.8, np.sin(tilt) * 0.6 + 0.05, -np.ones(PULSES)]
    away /= np.linalg.norm(away, axis=1)[:, None]
    sensor = np.c_[500000.0 + 6e-4 * k, 5400000.0 + 2e-4 * k, np.full(PULSES, 200.0 + HEIGHT)]
    ground = 200.0 + np.cumsum(rng.normal(0.0, 0.2, PULSES))
    return sensor, away, sensor + ((sensor[:, 2] - ground) / -away[:, 2])[:, None] * away


def las(path, turn="right", unit=1.0, second=8.0):
    """A return at the first of two echoes `second` ns apart."""
    rng = np.random.default_rng(2)
    _, away, xyz = scan(rng)
    y = [gaussian(60, [(120.0, 20.0, 3.5), (90.0, 20.0 + second, 3.5)]) + rng.normal(0, 0.7, 60) for _ in range(PULSES)]
    return write_las(
        path,
        xyz,
        waveforms=[digitise(v) for v in y],
        pulse=np.arange(PULSES),
        location=20.0,
        step=unit * TURNS[turn](-away * METRES_PER_NS),
        gps_time=1000.0 + 1e-5 * np.arange(PULSES),
        descriptors={1: OfLas(8, 60, 1000)},
    )


def pls(path, turn="right"):
    rng = np.random.default_rng(2)
    _, away, xyz = scan(rng)
    made = []
    for p in range(PULSES):
        t = 30.0  # as old converters have it: the anchor is at the first sample, or near it
        begin = 10.0
        samples = digitise(gaussian(60, [(120.0, t - begin, 3.5)]) + rng.normal(0, 0.7, 60))
        made.append(
            Pulse(
                np.round(xyz[p] - t * METRES_PER_NS * away[p], 3),
                TURNS[turn](away[p]),
                [[(-8.0, digitise(gaussian(20, [(180.0, 8.0, 3.5)])))], [(begin, samples)]],
                time=1000.0 + 1e-5 * p,
            )
        )
    kinds = [Sampling(OUTGOING, length_bits=0, samples=20, segment_bits=0, segments=1), Sampling()]
    return write_pls(path, made, {1: Descriptor(kinds)})


@pytest.mark.parametrize("turn", TURNS)
def test_what_is_wrong_is_told(tmp_path, params, turn):
    path = las(tmp_path / "a.las", turn)
    faults = [f for f in info(path)["faults"] if "beams" in f]
    if turn == "right":
        check_source(open_source(path), params)
        assert faults == []
        return
    with pytest.raises(InputError, match=WORDS[turn]) as refused:
        check_source(open_source(path), params)
    assert ("--mirror-beams" in str(refused.value)) == (turn == "mirrored")
    assert len(faults) == 1 and WORDS[turn] in faults[0]


def test_a_wrong_unit_is_told(tmp_path, params):
    with pytest.raises(InputError, match=r"they are 1000 times as long as light"):
        check_source(open_source(las(tmp_path / "a.las", unit=1000.0)), params)


def test_feet_are_told(tmp_path, params):
    with pytest.raises(InputError, match="look like feet"):
        check_source(open_source(las(tmp_path / "a.las", unit=1.0 / 0.3048)), params)


def test_mirrored_beams_of_pulses(tmp_path, params):
    """Where anchors are near the ground. At the sensor, beams meet there whatever their signs."""
    with pytest.raises(InputError, match="by the file it was 1 m away"):  # the optical centre of old converters
        check_source(open_source(pls(tmp_path / "a.pls")), params)
    params = params.model_copy(update={"sensor_ranges": False})
    check_source(open_source(pls(tmp_path / "a.pls")), params)
    wrong = pls(tmp_path / "b.pls", "mirrored")
    assert any(WORDS["mirrored"] in f for f in info(wrong)["faults"])
    with pytest.raises(InputError, match=WORDS["mirrored"]):
        check_source(open_source(wrong), params)
    turned = params.model_copy(update={"mirror_beams": True})
    check_source(open_source(wrong), turned)
    (a,), (b,) = (
        [read_span(open_source(p), s, how) for s in index_source(open_source(p), how)]
        for p, how in ((tmp_path / "a.pls", params), (wrong, turned))
    )
    assert np.isnan(a.pulses["anchor_range"]).all()
    for name in a.pulses:
        np.testing.assert_array_equal(a.pulses[name], b.pulses[name])


@pytest.mark.slow
def test_beams_that_are_turned_round_give_the_echoes_of_right_ones(tmp_path):
    """By command: refused with 1, mended by the option; a right file is refused with it."""
    right, wrong = las(tmp_path / "a.las"), las(tmp_path / "b.las", "mirrored")
    alike = "--accept-implausible"  # the same two echoes in every pulse
    assert process("decompose", right, tmp_path / "a.laz", alike).returncode == 0
    refused = process("decompose", wrong, tmp_path / "b.laz")
    assert refused.returncode == 1 and "--mirror-beams" in refused.stderr and not (tmp_path / "b.laz").exists()
    assert process("decompose", wrong, tmp_path / "b.laz", "--mirror-beams", alike).returncode == 0
    a, b = laspy.read(tmp_path / "a.laz"), laspy.read(tmp_path / "b.laz")
    assert len(a.points) == 2 * PULSES
    for axis in "xyz":
        np.testing.assert_array_equal(np.asarray(a[axis]), np.asarray(b[axis]))
    twice = process("decompose", right, tmp_path / "c.laz", "--mirror-beams")
    assert twice.returncode == 1 and "leave --mirror-beams" in twice.stderr


def test_beams_that_have_nothing_to_meet_in_are_left_alone(tmp_path, params):
    """Directions without any order, parallel ones, and fewer pulses than make a group."""
    check_source(open_source(survey(tmp_path / "a.las", pulses=200).path), params)
    rng = np.random.default_rng(0)
    xyz = np.c_[rng.uniform(0, 50, (200, 2)), np.zeros(200)]
    waves = [digitise(gaussian(60, [(99.0, 20.0, 3.5)]))] * 200
    for name, some in (("p", 200), ("q", 5)):
        check_source(
            open_source(write_las(tmp_path / f"{name}.las", xyz[:some], waveforms=waves[:some], location=20.0)), params
        )


def raw(path, change) -> str:
    columns = scene(pulses=600, n=80).columns(at="sensor")
    change(columns)
    write_parquet(path, columns, {"crs": "EPSG:32632", "spacing_ns": "1.0"})
    return next((f for f in info(path)["faults"] if "neighbouring pulses meet" in f), "")


def test_a_distance_that_the_beams_contradict(tmp_path, params):
    path = tmp_path / "a.parquet"
    assert raw(path, lambda columns: None) == ""
    assert raw(path, lambda columns: columns.pop("range_m")) == ""
    for wrong in (
        lambda c: c.update(range_m=c["begin_ns"] * HALF_LIGHT),
        lambda c: c.update(range_m=c["range_m"] - 300),
    ):
        fault = raw(path, wrong)
        assert "meet 599 m before" in fault and "range_m, optical centre) is wrong" in fault, fault
        with pytest.raises(InputError, match="give range_m of the place"):
            check_source(open_source(path), params)


@pytest.mark.parametrize("begin", [None, 0.0, 5.0])
def test_a_sensor_without_times_of_the_first_samples(tmp_path, params, begin):
    path = tmp_path / "a.parquet"
    columns = scene(pulses=600, n=80).columns(at="sensor")
    columns["begin_ns"] = np.full(600, 0.0 if begin is None else begin)
    if begin is None:
        del columns["begin_ns"]
    write_parquet(path, columns, {"crs": "EPSG:32632", "spacing_ns": "1.0"})
    (fault,) = [f for f in info(path)["faults"] if "begin_ns" in f]
    assert "of where the beams of neighbouring pulses meet, which is the sensor" in fault
    with pytest.raises(InputError, match="begin_ns in nanoseconds, there and back"):
        check_source(open_source(path), params)


@pytest.mark.parametrize("ending", ["parquet", "csv"])
def test_long_records_at_a_sensor_say_when_they_begin(tmp_path, params, ending):
    """Records of 45 m could hold the ground; without times only a table that says 0 is taken to begin at the sensor."""
    path, write = tmp_path / f"a.{ending}", {"parquet": write_parquet, "csv": write_csv}[ending]
    columns = scene(pulses=150, n=300).columns(at="sensor")
    del columns["begin_ns"]
    told = {"crs": "EPSG:32632", "spacing_ns": "1.0"}
    write(path, columns, told)
    assert [f for f in info(path)["faults"] if "the first samples lie within" in f]
    with pytest.raises(InputError, match="begin_ns"):
        check_source(open_source(path), params)
    write(path, columns | {"begin_ns": np.zeros(150)}, told)
    assert not [f for f in info(path)["faults"] if "begin_ns" in f]


@pytest.mark.parametrize("where", ["half", "end"])
def test_beams_that_are_turned_in_a_part_of_the_file(tmp_path, params, monkeypatch, where):
    """Half of 600 pulses; or the last fifth, further behind than what is looked at from the begin on."""
    if where == "end":
        monkeypatch.setattr("fwclass.read.beams.LOOKED_AT", 300)
    columns = scene(pulses=600).columns(at="first")
    beams = np.stack([columns[f"d{a}"] for a in "xyz"], axis=1)
    part = np.arange(600) >= (300 if where == "half" else 480)
    beams[part] = TURNS["mirrored"](beams[part])
    columns |= {f"d{a}": beams[:, k] for k, a in enumerate("xyz")}
    path = write_parquet(tmp_path / "a.parquet", columns, {"crs": "EPSG:32632", "spacing_ns": "1.0"})
    with pytest.raises(InputError, match="in a part of the file the beams of neighbouring pulses meet") as fault:
        check_source(open_source(path), params)
    assert WORDS["mirrored"] in str(fault.value) and "cut it where its beams change" in fault.value.do


def test_samples_of_one_time_that_are_there_twice_are_no_sound_file(tmp_path):
    """A third of all samples was left out, with exit code 0."""
    columns = scene(pulses=300, n=80).columns(at="sensor")
    both = {k: np.repeat(np.asarray(v), 2) for k, v in columns.items() if k != "samples"} | {
        "pulse": np.arange(600) // 2
    }
    both["begin_ns"] = both["begin_ns"] + 30.0 * (np.arange(600) % 2)
    both["samples"] = [part for s in columns["samples"] for part in (s[:40], s[30:])]
    path = write_parquet(tmp_path / "a.parquet", both, {"crs": "EPSG:32632", "spacing_ns": "1.0"})
    ended = process("decompose", path, tmp_path / "a.laz")
    assert (
        ended.returncode == 4 and "waveforms that begin before the one before them ends, left out: 300" in ended.stderr
    )
    assert "300 of 600 pulses (50.0 %) have a waveform that cannot be read" in ended.stderr, ended.stderr
