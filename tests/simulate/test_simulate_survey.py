"""A small simulated survey, read back byte by byte."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
import yaml
from defaults import BASE
from pydantic import ValidationError
from tolerances import FLOAT32_RTOL, FLOAT64_UNIT

from fwclass.errors import ConfigError
from fwclass.simulate.city import build_scene
from fwclass.simulate.flight import StripPlan, fire, measure_pose, plan_strips, pose
from fwclass.simulate.params import SimulateParams
from fwclass.simulate.scene import WATER, in_gap, terrain
from fwclass.simulate.stage import simulate_strip, write_trajectory
from fwclass.units import METRES_PER_NS

BLOCK = {4: 28, 9: 30}
PACKET = np.dtype([("index", "u1"), ("offset", "<u8"), ("size", "<u4"), ("location", "<f4"), ("v", "<f4", 3)])


def settings(**changes: Any) -> SimulateParams:
    base = BASE["simulate"]
    return SimulateParams(**{**base, "size": 110.0, "strips": 3, "seed": 4, "chunk": 4096, **changes})


@pytest.fixture(scope="module")
def params() -> SimulateParams:
    return settings()


@pytest.fixture(scope="module")
def survey(params: SimulateParams, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("survey")
    facts = [simulate_strip(params, strip, out) for strip in plan_strips(params)]
    (out / "facts.yaml").write_text(yaml.safe_dump(facts), encoding="utf-8")
    return out


def _strips(params: SimulateParams) -> list[StripPlan]:
    return plan_strips(params)


def read_raw(path: Path) -> dict[str, Any]:
    """A LAS file by the specification's byte positions, without the library that wrote it."""
    data = path.read_bytes()
    assert data[:4] == b"LASF"
    header_size, first_point, count_vlr = struct.unpack_from("<HII", data, 94)
    point_format, length = data[104], struct.unpack_from("<H", data, 105)[0]
    count = struct.unpack_from("<Q", data, 247)[0] if data[25] >= 4 else struct.unpack_from("<I", data, 107)[0]
    vlrs, at = [], header_size
    for _ in range(count_vlr):
        _, user, record, size, _ = struct.unpack_from("<H16sHH32s", data, at)
        vlrs.append((user.rstrip(b"\0").decode(), record, data[at + 54 : at + 54 + size]))
        at += 54 + size
    raw = np.frombuffer(data, np.uint8, count * length, first_point).reshape(count, length)
    grid = np.ascontiguousarray(raw[:, :12]).view("<i4").astype(np.int64)
    scale, offset = np.frombuffer(data, "<f8", 3, 131), np.frombuffer(data, "<f8", 3, 155)
    b = BLOCK.get(point_format)
    gps = 20 if point_format < 6 else 22
    return {
        "version": (data[24], data[25]),
        "encoding": struct.unpack_from("<H", data, 6)[0],
        "created": struct.unpack_from("<HH", data, 90),
        "start_of_packets": struct.unpack_from("<Q", data, 227)[0],
        "format": point_format,
        "vlrs": vlrs,
        "xyz": grid * scale + offset,
        "bits": raw[:, 14],
        "gps": np.ascontiguousarray(raw[:, gps : gps + 8]).view("<f8").ravel(),
        "packet": np.ascontiguousarray(raw[:, b : b + 29]).view(PACKET).ravel() if b else None,
    }


def returns_of(las: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    if las["format"] < 6:
        return las["bits"] & 7, (las["bits"] >> 3) & 7
    return las["bits"] & 15, las["bits"] >> 4


def descriptors(las: dict[str, Any]) -> dict[int, tuple[int, int, int, int, float, float]]:
    found = {}
    for user, record, body in las["vlrs"]:
        if user == "LASF_Spec" and 100 <= record <= 354:
            assert len(body) == 26
            found[record - 99] = struct.unpack("<BBIIdd", body)
    return found


@pytest.fixture(params=[0, 1, 2], ids=["1.4-pf9-8bit", "1.3-pf4-8bit", "1.4-pf9-16bit"])
def strip(
    request: pytest.FixtureRequest, params: SimulateParams, survey: Path
) -> tuple[StripPlan, dict[str, Any], bytes]:
    plan = _strips(params)[request.param]
    path = survey / "strips" / f"{plan.name}.las"
    return plan, read_raw(path), path.with_suffix(".wdp").read_bytes()


def test_header_says_what_the_strip_is(strip: tuple[StripPlan, dict[str, Any], bytes], params: SimulateParams) -> None:
    plan, las, _ = strip
    assert las["version"] == tuple(int(v) for v in plan.recording.las.split("."))
    assert las["format"] == plan.recording.point_format
    assert las["encoding"] & 0b0111 == 0b0101  # adjusted GPS time, packets outside, none inside
    assert las["start_of_packets"] == 0
    assert las["created"] == (76, 2021)  # the day of the flight, 1.3e9 s after 6 January 1980; not today
    projection = {record for user, record, _ in las["vlrs"] if user == "LASF_Projection"}
    if plan.recording.point_format >= 6:
        assert las["encoding"] & 16
        assert 2112 in projection
    else:
        assert not las["encoding"] & 16
        assert 34735 in projection
        keys = next(b for u, r, b in las["vlrs"] if u == "LASF_Projection" and r == 34735)
        values = np.frombuffer(keys, "<u2").reshape(-1, 4)
        assert (3072, 25832) in {(int(k[0]), int(k[3])) for k in values}
    found = descriptors(las)
    sensor = params.sensor
    assert [found[k][2] for k in sorted(found)] == [sensor.short_segment, sensor.long_segment, 0, 0]
    assert all(d[0] == plan.recording.bits and d[1] == 0 for d in found.values())
    assert found[1][3] == found[2][3] == 1000


def test_packets_lie_in_the_wdp_one_after_the_other(strip: tuple[StripPlan, dict[str, Any], bytes]) -> None:
    _, las, wdp = strip
    _, user, record, size, _ = struct.unpack_from("<H16sHQ32s", wdp)
    assert (user.rstrip(b"\0"), record, size) == (b"LASF_Spec", 65535, len(wdp) - 60)
    packet = las["packet"]
    first = np.unique(packet["offset"])
    assert first[0] == 60
    sizes = packet["size"][np.unique(packet["offset"], return_index=True)[1]]
    np.testing.assert_array_equal(first[1:], first[:-1] + sizes[:-1])
    assert first[-1] + sizes[-1] == len(wdp)
    lengths = {k: d[2] * d[0] // 8 for k, d in descriptors(las).items()}
    np.testing.assert_array_equal(packet["size"], [lengths[int(i)] for i in packet["index"]])
    assert set(np.unique(packet["index"])) == {1, 2}


def test_one_packet_and_one_time_per_pulse(strip: tuple[StripPlan, dict[str, Any], bytes]) -> None:
    _, las, _ = strip
    number, of = returns_of(las)
    assert np.all(np.diff(las["gps"]) >= 0)
    same_time = np.diff(las["gps"]) == 0
    np.testing.assert_array_equal(same_time, np.diff(las["packet"]["offset"].astype(np.int64)) == 0)
    np.testing.assert_array_equal(same_time, number[1:] > 1)
    assert np.all((number >= 1) & (number <= of))
    assert np.all(number[1:][same_time] == number[:-1][same_time] + 1)


def test_position_follows_from_any_other_return_of_the_pulse(strip: tuple[StripPlan, dict[str, Any], bytes]) -> None:
    _, las, _ = strip
    packet, xyz = las["packet"], las["xyz"]
    k = np.flatnonzero(np.diff(packet["offset"].astype(np.int64)) == 0)
    assert len(k) > 100
    step = (packet["location"][k] - packet["location"][k + 1])[:, None].astype(np.float64) * packet["v"][k]
    error = np.abs(xyz[k] + step - xyz[k + 1])
    # half a millimetre of rounding at both ends, and float32 locations of up to 208 000 ps
    assert error.max() < 0.0012
    speed = np.linalg.norm(packet["v"].astype(np.float64), axis=1)
    np.testing.assert_allclose(speed, METRES_PER_NS / 1000, rtol=FLOAT32_RTOL)
    assert np.all(packet["v"][:, 2] > 0)  # up the beam


def test_samples_peak_where_the_return_says(
    strip: tuple[StripPlan, dict[str, Any], bytes], params: SimulateParams
) -> None:
    plan, las, wdp = strip
    packet = las["packet"]
    for k in range(0, len(packet), 37):
        p = packet[k]
        count = int(p["size"]) * 8 // plan.recording.bits
        samples = np.frombuffer(wdp, f"<u{plan.recording.bits // 8}", count, int(p["offset"]))
        at = round(float(p["location"]) / 1000)
        assert samples[max(at - 2, 0) : at + 3].max() >= params.sensor.baseline + params.sensor.detection
        lead = samples[: params.sensor.lead - 7].astype(float)
        assert abs(lead.mean() - params.sensor.baseline) < 3.0


def test_reference_has_the_pulses_of_the_strip(strip: tuple[StripPlan, dict[str, Any], bytes], survey: Path) -> None:
    plan, las, _ = strip
    truth = laspy.read(survey / "reference" / f"{plan.name}.las")
    assert (str(truth.header.version), truth.header.point_format.id) == ("1.4", 6)
    np.testing.assert_array_equal(np.unique(truth.gps_time), np.unique(las["gps"]))
    assert set(np.unique(np.asarray(truth.classification))) <= {2, 3, 4, 5, 6, 64}
    number, of = np.asarray(truth.return_number), np.asarray(truth.number_of_returns)
    first = np.flatnonzero(number == 1)
    np.testing.assert_array_equal(np.diff(np.append(first, len(number))), of[first])
    truth_xyz = np.column_stack([truth.x, truth.y, truth.z])
    one, truth_one = returns_of(las)[1] == 1, of == 1
    both = np.intersect1d(las["gps"][one], np.asarray(truth.gps_time)[truth_one])
    mine = las["xyz"][one][np.searchsorted(las["gps"][one], both)]
    theirs = truth_xyz[truth_one][np.searchsorted(np.asarray(truth.gps_time)[truth_one], both)]
    distance = np.linalg.norm(mine - theirs, axis=1)
    # the sensor's centre of gravity is honest but crude
    assert np.median(distance) < 0.03
    assert distance.max() > 1e-3


def test_survey_stays_in_its_area_and_out_of_its_gap(params: SimulateParams, survey: Path) -> None:
    scene = build_scene(params)
    for plan in _strips(params):
        for folder in ("strips", "reference"):
            las = laspy.read(survey / folder / f"{plan.name}.las")
            x, y = np.asarray(las.x) - params.origin_x, np.asarray(las.y) - params.origin_y
            assert min(x.min(), y.min()) > 0 and max(x.max(), y.max()) < params.size
            if folder == "reference":
                assert not any(in_gap(scene.gap, a, b) for a, b in zip(x, y, strict=True)) or (
                    sum(in_gap(scene.gap, a, b) for a, b in zip(x, y, strict=True)) < 0.002 * len(x)
                )


def test_water_gives_nothing(params: SimulateParams, survey: Path) -> None:
    scene = build_scene(params)
    on_water = total = 0
    for plan in _strips(params):
        las = laspy.read(survey / "reference" / f"{plan.name}.las")
        ground = np.asarray(las.classification) == 2
        x, y = np.asarray(las.x)[ground] - params.origin_x, np.asarray(las.y)[ground] - params.origin_y
        cover = scene.cover[(y + scene.margin).astype(int), (x + scene.margin).astype(int)]
        on_water += int((cover == WATER).sum())
        total += len(x)
    assert (scene.cover == WATER).mean() > 0.03
    # only footprints that lie across the water's edge
    assert on_water < 0.004 * total


def test_ground_echoes_lie_on_the_terrain(params: SimulateParams, survey: Path) -> None:
    scene = build_scene(params)
    las = laspy.read(survey / "reference" / "strip_02.las")
    rows = np.flatnonzero((np.asarray(las.classification) == 2) & (np.asarray(las.number_of_returns) == 1))[::5]
    x, y = np.asarray(las.x)[rows] - params.origin_x, np.asarray(las.y)[rows] - params.origin_y
    level = np.array([terrain(scene.height, scene.margin, scene.step, a, b) for a, b in zip(x, y, strict=True)])
    error = np.asarray(las.z)[rows] - params.base_height - level
    # navigation (30 mm a side, 25 mm for attitude at 369 m), clock (12 mm), herbs in the footprint
    assert abs(np.median(error)) < 0.1
    assert np.subtract(*np.percentile(error, [84, 16])) < 0.2


@pytest.mark.parametrize("chunk", [777, 100_000])
def test_bytes_do_not_depend_on_the_chunk(params: SimulateParams, survey: Path, tmp_path: Path, chunk: int) -> None:
    other = settings(chunk=chunk)
    plan = _strips(other)[1]
    simulate_strip(other, plan, tmp_path)
    for name in (f"strips/{plan.name}.las", f"strips/{plan.name}.wdp", f"reference/{plan.name}.las"):
        assert (tmp_path / name).read_bytes() == (survey / name).read_bytes(), name
    assert sorted(p.name for p in tmp_path.rglob("*") if p.is_file()) == sorted(
        [f"{plan.name}.las", f"{plan.name}.las", f"{plan.name}.wdp"]
    )


def test_scene_built_anew_is_the_same(params: SimulateParams) -> None:
    first = build_scene(params)
    second = build_scene.__wrapped__(params)
    for name, a, b in zip(first._fields, first, second, strict=True):
        np.testing.assert_array_equal(a, b, err_msg=name)


def test_another_seed_is_another_town(params: SimulateParams) -> None:
    assert not np.array_equal(build_scene(params).height, build_scene(settings(seed=5)).height)


def test_facts_count_what_was_written(params: SimulateParams, survey: Path) -> None:
    facts = yaml.safe_load((survey / "facts.yaml").read_text(encoding="utf-8"))
    for fact in facts:
        assert fact["pulses"] == fact["recorded"] + fact["silent"] + fact["cut"] + fact["unseen"]
        with laspy.open(survey / "strips" / f"{fact['name']}.las") as las:
            assert las.header.point_count == fact["returns"]
        truth = laspy.read(survey / "reference" / f"{fact['name']}.las")
        codes, counts = np.unique(np.asarray(truth.classification), return_counts=True)
        assert dict(zip(codes.tolist(), counts.tolist(), strict=True)) == fact["classes"]
        assert len(np.unique(truth.gps_time)) == fact["recorded"]
        assert fact["returns"] < fact["echoes"]  # the on-board detection misses some


def test_pulse_does_not_depend_on_those_before_it(params: SimulateParams) -> None:
    plan = _strips(params)[0]
    whole, part = fire(params, plan, 0, 3000), fire(params, plan, 1234, 57)
    np.testing.assert_array_equal(whole.direction[1234:1291], part.direction)
    np.testing.assert_array_equal(whole.measured_origin[1234:1291], part.measured_origin)
    np.testing.assert_allclose(np.linalg.norm(whole.direction, axis=1), 1.0, atol=FLOAT64_UNIT)
    assert np.all(np.diff(whole.time) > 0)


@pytest.mark.parametrize(
    "changes",
    [
        {"recordings": [{"las": "1.3", "point_format": 9, "bits": 8}]},
        {"recordings": [{"las": "1.4", "point_format": 9, "bits": 12}]},
        {"strips": 0},
        {"sise": 3},
    ],
)
def test_settings_that_make_no_survey_are_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        settings(**changes)


@pytest.mark.parametrize("crs", ["EPSG:999999", "EPSG:4326"])
def test_crs_that_is_unknown_or_in_degrees_is_refused(crs: str, tmp_path: Path) -> None:
    other = settings(crs=crs)
    with pytest.raises(ConfigError, match=crs):
        simulate_strip(other, _strips(other)[0], tmp_path)


def test_plan_covers_the_area_with_the_density_asked_for() -> None:
    for size, strips in ((300.0, 4), (1200.0, 8)):
        asked = settings(size=size, strips=strips)
        plans = _strips(asked)
        total = sum(p.pulses for p in plans)
        # a few metres are fired beyond the area on every side
        assert asked.pulse_density * size**2 < total < 1.08 * asked.pulse_density * size**2
        assert max(p.pulses for p in plans) < 1.6 * min(p.pulses for p in plans)
        assert len({p.name for p in plans}) == strips


def test_trajectory_is_the_measured_path(params: SimulateParams, tmp_path: Path) -> None:
    path = write_trajectory(params, tmp_path)
    rows = np.genfromtxt(path, delimiter=",", names=True, dtype=None, encoding="utf-8")
    plan = _strips(params)[1]
    mine = rows[rows["strip"] == plan.name]
    when = mine["gps_time"] - plan.first_time
    at = measure_pose(params, plan, pose(params, plan, when), when)
    # coordinates are written to the millimetre
    np.testing.assert_allclose(mine["y"], at.y + params.origin_y, atol=0.0006)
    assert np.all(np.abs(mine["heading"] - 180.0) < 5.0)
    assert when[-1] >= fire(params, plan, plan.pulses - 1, 1).time[0]
