"""A recording that is not what it says is told, and ends with exit code 4; a sound one is not."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from commandline import fwclass
from streetmaker import SHORT, config, directory, drive

from fwclass.errors import InputError
from fwclass.graph.street_recordings import TrajectoryFiles, Way
from fwclass.schema import Table
from fwclass.single_file.street.info import describe, info

BEAMS = 1081
ALONE = ("--workers", 0)
"""Two workers take four seconds of the processor to start: one command of these tests has them."""


def columns() -> dict:
    """The short drive as plain lists; the vehicle's stop is left out."""
    frames = [f for f in drive() if f.speed > 0.1]
    time = np.arange(len(frames)) * 0.025
    speed = np.array([f.speed for f in frames])
    return {
        "frame": np.arange(len(frames)),
        "time": time,
        "speed": speed,
        "place": np.concatenate([[0.0], np.cumsum(speed[1:] * 0.025)]),
        "ranges": np.stack([f.ranges for f in frames]),
    }


def write(path: Path, changed: dict) -> Path:
    values = columns() | changed
    table = {k: pa.array(list(v) if np.ndim(v) > 1 else v) for k, v in values.items() if v is not None}
    pq.write_table(pa.table(table), path)
    return path


def told(path: Path, *settings: str) -> list[str]:
    return info(path, config("street.speed=null", *settings).street)["implausible"]


@pytest.mark.parametrize("column", ["speed", "place"])
def test_a_sound_recording_is_not_told(tmp_path: Path, column: str) -> None:
    assert told(write(tmp_path / "a.parquet", {column: None})) == []


def frozen(c: dict) -> dict:
    ranges = c["ranges"].copy()
    ranges[60:] = ranges[60]
    return {"ranges": ranges}


def with_code(c: dict, code: float) -> dict:
    return {"ranges": np.where(np.isnan(c["ranges"]), np.float32(code), c["ranges"])}


def jumped(c: dict) -> dict:
    return {"time": c["time"] + 3600.0 * (np.arange(len(c["time"])) > 40), "place": None}


WRONG = {
    "milliseconds": (lambda c: {"time": 1000 * c["time"]}, "are times in seconds?"),
    "a clock that was set": (jumped, "of road lie in leaps of the clock"),
    "whole seconds": (lambda c: {"time": np.floor(c["time"])}, "frames are left out"),
    "millimetres": (lambda c: {"ranges": 1000 * c["ranges"]}, "are they in metres, and their limits too?"),
    "a blind scanner": (lambda c: {"ranges": np.full_like(c["ranges"], np.nan)}, "ranges are returns"),
    "a scanner that hangs": (frozen, "repeat the one before to the last digit"),
    "a code for no return": (lambda c: with_code(c, 21.5), "of the returns have one range, 21.5 m"),
    "places in millimetres": (lambda c: {"place": 1000 * c["place"], "speed": None}, "the vehicle goes"),
    "speed in km/h beside places": (lambda c: {"speed": 3.6 * c["speed"]}, "places go 0.278 times as far"),
    "a speed that is lost": (
        lambda c: {"speed": np.where(np.arange(len(c["speed"])) < 60, c["speed"], np.nan), "place": None},
        "have no speed, and the last one was taken",
    ),
    "a speed that is 0": (
        lambda c: {"speed": np.where(np.arange(len(c["speed"])) < 60, c["speed"], 0.0), "place": None},
        "by its speed or place, and yet the scene passes",
    ),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_is_wrong_is_told(tmp_path: Path, what: str) -> None:
    change, words = WRONG[what]
    path = write(tmp_path / "a.parquet", change(columns()))
    assert any(words in fault for fault in told(path)), told(path)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("street.mounting.height=2.6", "the road lies 1.80 m below the scanner, and street.mounting.height is 2.6 m"),
        ("street.mounting.roll=10", "the road leans by "),  # a car's side hid it from a line of least squares
        ("street.mounting.roll=-10", "the road leans by -"),
        ("street.mounting.roll=180", "is the scanner the other way up"),
    ],
)
def test_another_mounting_is_told_by_the_road(tmp_path: Path, setting: str, words: str) -> None:
    faults = told(write(tmp_path / "a.parquet", {}), setting)
    assert len(faults) == 1 and words in faults[0], faults


def test_ranges_that_mean_no_return_are_none(tmp_path: Path) -> None:
    """0, and the furthest range of the scanner."""
    path = write(tmp_path / "a.parquet", {})
    for code in (0.0, 30.0):
        other = write(tmp_path / "b.parquet", with_code(columns(), code))
        assert told(other) == [] and info(other, config().street)["returns"] == info(path, config().street)["returns"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"angle_min": -135.0, "angle_increment": 0.25}, "the beams go more than once around"),
        ({"angle_min": 135.0, "angle_increment": -0.25}, "the beams go more than once around"),
    ],
)
def test_beams_that_no_scanner_has(tmp_path: Path, change: dict, words: str) -> None:
    n = len(columns()["time"])
    path = write(tmp_path / "a.parquet", {k: np.full(n, v) for k, v in change.items()})
    with pytest.raises(InputError, match=words):
        told(path)


@pytest.mark.parametrize(("speed", "said"), [(None, True), ("given", False)])
def test_a_trajectory_that_nothing_tests_is_told(tmp_path: Path, speed: str | None, said: bool) -> None:
    """27.7 m of road by a trajectory in feet: a map of 90.8 m, and not a word."""
    path = write(tmp_path / "a.parquet", {"place": None} | ({} if speed else {"speed": None}))
    (tmp_path / "way.csv").write_text("time,x,y,z\n" + "".join(f"{k},{1.5 * k},0,0\n" for k in range(-1, 9)))
    way = TrajectoryFiles((tmp_path / "way.csv",))
    summary = info(path, config("street.speed=null").street, way)
    assert "m (1.50 to " in describe(summary), "where places begin"
    remarks = summary["remarks"]
    assert any("nothing tells whether the" in text for text in remarks) is said, remarks
    assert not any("nothing tells whether the" in text for text in info(path, config().street)["remarks"])


def test_a_trajectory_of_another_day(tmp_path: Path) -> None:
    path = write(tmp_path / "a.parquet", {"place": None})
    (tmp_path / "way.csv").write_text("time,x,y,z\n" + "".join(f"{90000 + k},{k},0,0\n" for k in range(9)))
    (tmp_path / "c.yaml").write_text(
        "survey: {name: s, sources: [a.parquet], reference: {kind: source}, crs: EPSG:32632, "
        "trajectory: {files: [way.csv]}, "
        "classes: [{name: crown, code: 5, codes: [5]}, {name: other, code: 1, codes: [2]}]}\n"
        "areas: {train: [[0, -9, 9, 9]]}\n"
    )
    ended = fwclass("street", "info", path, "--conf", tmp_path / "c.yaml", "--set", "street.speed=1.5")
    assert ended.returncode == 0 and "frames are outside the trajectory's time" in ended.stdout, ended.stdout


@pytest.mark.slow
def test_commands_end_with_4_after_their_work(tmp_path: Path) -> None:
    sets = [word for s in SHORT for word in ("--set", s)]
    wrong = write(tmp_path / "a.parquet", {"time": 1000 * columns()["time"]})
    for command in (("classify", wrong, tmp_path / "o", *ALONE), ("run", wrong, "--out", tmp_path / "o")):
        line = ("street", *command, "--model", directory() / "model", "--overwrite", *sets)
        ended = fwclass(*line)
        assert ended.returncode == 4 and "the recording is not what it says" in ended.stderr, ended.stderr
        assert (tmp_path / "o" / "prescription.csv").exists()
        assert "seconds" in json.loads((tmp_path / "o" / "summary.json").read_text())["implausible"][0]
        assert fwclass(*line, "--accept-implausible").returncode == 0


def test_a_clock_of_nanoseconds_leaves_no_frame(tmp_path: Path) -> None:
    """All were counted as out of order, and the command ended with 0."""
    nanoseconds = write(tmp_path / "a.parquet", {"time": 1e9 * (1.7e9 + columns()["time"])})
    sets = [word for s in SHORT for word in ("--set", s)]
    line = ("street", "run", nanoseconds, "--out", tmp_path / "o", "--model", directory() / "model", *sets)
    ended = fwclass(*line)
    assert ended.returncode == 4 and "frames can be used" in ended.stderr and "seconds" in ended.stderr, ended.stderr


def test_the_model_knows_its_mounting(tmp_path: Path) -> None:
    path = directory() / "drive.parquet"
    line = ("street", "classify", path, tmp_path / "o", "--model", directory() / "model", "--overwrite")
    ended = fwclass(*line, *ALONE, "--set", "street.mounting.side=left", "--set", "street.radii=[0.5]")
    assert "another mounting (side right there, left here)" in ended.stderr, ended.stderr
    assert "street.radii is the model's, [0.3], not [0.5]" in ended.stderr
    ended = fwclass(*line, *ALONE)
    assert ended.returncode == 0 and "looks right, 1.8 m above the road (measured: 1.80 m)" in ended.stderr
    assert "remark" not in ended.stderr


@pytest.mark.slow
def test_what_the_model_has_not_seen_is_told_alike_online_and_whole(tmp_path: Path) -> None:
    near = write(tmp_path / "a.parquet", {"ranges": 0.4 * columns()["ranges"]})
    drifts = []
    for command in (("classify", near, tmp_path / "o", *ALONE), ("run", near, "--out", tmp_path / "o")):
        line = ("street", *command, "--model", directory() / "model", "--overwrite", "--set", "street.chunk=37")
        ended = fwclass(*line, "--accept-implausible", "--set", "classify.max_outside=0.1")
        assert ended.returncode == 4 and "the model has not seen such data" in ended.stderr, ended.stderr
        drifts.append(json.loads((tmp_path / "o" / "summary.json").read_text())["drift"])
        assert fwclass(*line, "--accept-implausible", "--accept-drift").returncode == 0
    assert drifts[0] == drifts[1] and max(drifts[0]["outside"].values()) > 0.3


def test_what_is_wrong_is_told_before_anybody_knows_the_speed(tmp_path: Path) -> None:
    still = {"speed": None, "place": None}
    assert told(write(tmp_path / "a.parquet", still)) == []
    (fault,) = told(write(tmp_path / "a.parquet", still), "street.mounting.height=2.6")
    assert "the road lies 1.80 m below the scanner" in fault


@pytest.mark.parametrize(("rate", "noise"), [(100.0, 0.01), (10.0, 0.02), (1.0, 0.0)])
def test_noise_of_a_trajectory_makes_no_way(rate: float, noise: float) -> None:
    r = np.random.default_rng(2)
    time = np.arange(0.0, 80.0, 1.0 / rate)
    true = np.clip(time, 0.0, 20.0) + np.clip(time - 60.0, 0.0, 20.0)  # 40 m at 1 m/s, 40 s of standing between
    angle = true / 30.0
    xy = np.stack([30.0 * np.sin(angle), 30.0 * (1.0 - np.cos(angle))], axis=1) + r.normal(0.0, noise, (len(time), 2))
    fixes = Table({"gps_time": time, "x": xy[:, 0], "y": xy[:, 1], "z": np.zeros(len(time))})
    along = Way.of(fixes).place(time)
    assert np.abs(along - true).max() < 0.15  # 39 m more, before
