"""Flight lines of one file that do not lie at one height: told, and exit code 4, by commands on the file alone."""

from __future__ import annotations

import json

import lasmaker
import numpy as np
import pytest
from commandline import fwclass


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Files of two lines over a meadow of 40 m with a knoll: the second line higher by 0, 0.1 and 0.4 m, and by 0.4 m
    without times."""
    place, rng = tmp_path_factory.mktemp("lines"), np.random.default_rng(1)
    x, y = rng.uniform(0, 40, (2, 12_000))
    second = rng.random(12_000) < 0.5
    z = 100 + 0.02 * x + 2 * np.exp(-((x - 20) ** 2 + (y - 20) ** 2) / 50) + rng.normal(0, 0.01, 12_000)
    for name, lifted, times in (("sound", 0, True), ("told", 0.1, True), ("lifted", 0.4, True), ("bare", 0.4, False)):
        lasmaker.write_las(
            place / f"{name}.las",
            np.c_[500_000 + x, 5_400_000 + y, z + lifted * second],
            point_format=6,
            gps_time=np.where(second, 9000.0, 1000.0) + rng.uniform(0, 5, 12_000) if times else 0.0,
        )
    return place


def test_a_line_that_lies_aside_is_told(place):
    rng = np.random.default_rng(2)
    x, y = rng.uniform(0, 60, (2, 40_000))
    second = rng.random(40_000) < 0.5
    gables = np.where(y < 48, 0.6 * np.abs(np.where(y < 24, x, y) % 12 - 6), 0)  # and a meadow behind them
    z = 100 + gables + rng.normal(0, 0.01, 40_000)
    lasmaker.write_las(
        place / "aside.las",
        np.c_[500_000 + x + 0.6 * second, 5_400_000 + y, z],
        point_format=6,
        gps_time=np.where(second, 9000.0, 1000.0) + rng.uniform(0, 5, 40_000),
    )
    ended = features(place, "aside")
    assert "line 2 lies 0.6" in ended.stderr or "line 1 lies 0.6" in ended.stderr, ended.stderr
    assert (ended.returncode == 0 and "m east" in ended.stderr) or "m west" in ended.stderr, ended.stderr


def test_noisy_heights_are_told(place):
    rng = np.random.default_rng(3)
    x, y = rng.uniform(0, 60, (2, 20_000))
    z = 100 + rng.normal(0, 0.2, 20_000)
    lasmaker.write_las(place / "noisy.las", np.c_[500_000 + x, 5_400_000 + y, z], point_format=6)
    ended = features(place, "noisy")
    assert ended.returncode == 0 and "heights are noisy" in ended.stderr, ended.stderr


def features(place, name, *words):
    (place / "one.yaml").write_text("features: [height_range_c100]\n")
    words = ("--set", "one.yaml", "--overwrite", *words)
    return fwclass("features", f"{name}.las", f"{name}.parquet", *words, cwd=place)


def test_lines_at_two_heights_end_with_4(place):
    ended = features(place, "lifted")
    assert ended.returncode == 4 and (place / "lifted.parquet").is_file(), ended.stderr
    assert "files or flight lines of the survey do not lie at one height" in ended.stderr
    assert "line 2 lies 0.40" in ended.stderr and "above line 1" in ended.stderr
    accepted = features(place, "lifted", "--accept-implausible", "--json")
    assert accepted.returncode == 0 and "above line 1" in accepted.stderr, accepted.stderr
    (step,) = json.loads(accepted.stdout)["judged"]["strips"]["steps"]
    assert step["by"] == "times" and step["step"] == pytest.approx(-0.4, abs=0.01)


@pytest.mark.parametrize("words", [("ground",), ("normalize", "--method", "smrf")])
def test_ground_and_heights_of_lines_at_two_heights(place, words):
    ended = fwclass(words[0], "lifted.las", f"{words[0]}.las", *words[1:], "--overwrite", cwd=place)
    assert ended.returncode == 4 and (place / f"{words[0]}.las").is_file(), ended.stderr
    assert "line 2 lies 0.40" in ended.stderr and "do not lie at one height" in ended.stderr
    for name in ("sound", "bare"):
        ended = fwclass(words[0], f"{name}.las", f"{words[0]}.las", *words[1:], "--overwrite", cwd=place)
        assert ended.returncode == 0 and "line 1" not in ended.stderr, ended.stderr


def test_a_small_step_is_told(place):
    ended = features(place, "told")
    assert ended.returncode == 0 and "line 2 lies 0.1" in ended.stderr, ended.stderr


@pytest.mark.parametrize("name", ["sound", "bare"])
def test_sound_lines_and_unknown_ones_are_not_spoken_of(place, name):
    ended = features(place, name)
    assert ended.returncode == 0 and "line 1" not in ended.stderr, ended.stderr
