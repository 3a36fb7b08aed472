"""Full waveforms of HELIOS++, written by its published rules: places through the command line, words for damage."""

from __future__ import annotations

import json

import heliosmaker
import laspy
import numpy as np
import pytest
from commandline import fwclass

from fwclass.errors import InputError
from fwclass.read.source import open_source

BIN = heliosmaker.C
"""Metres of a bin of one nanosecond: HELIOS++ puts a hit into the bin that holds it."""

LAG = 0.35
"""Metres from the peak of its skewed pulse to what a Gaussian fits to it, and a bin."""


@pytest.mark.parametrize(
    ("bin_ns", "tilt", "digits"), [pytest.param(0.2, 0.0, 9, marks=pytest.mark.slow), (0.2, 25.0, 4), (0.25, 0.0, 9)]
)
def test_places_lie_a_constant_behind(tmp_path, bin_ns, tilt, digits):
    path = tmp_path / "leg000_fullwave.txt"
    ground, crown, times = heliosmaker.survey(path, bin_ns=bin_ns, tilt=tilt, digits=digits)
    ended = fwclass("decompose", path, tmp_path / "o.laz", "--crs", "EPSG:32632", "--accept-implausible")
    assert ended.returncode == 0, ended.stderr
    assert "a quarter of their samples at 0" not in ended.stdout + ended.stderr, ended.stdout
    assert "the samples have no noise" in ended.stderr and "is in truth" not in ended.stderr, ended.stderr
    las = laspy.read(tmp_path / "o.laz")
    places = np.stack([las.x, las.y, las.z], axis=1)
    row = np.rint((np.asarray(las.gps_time) - times[0]) / 1e-3).astype(int)
    low, high = (np.linalg.norm(places - there[row], axis=1) for there in (ground, crown))
    assert len(set(row[low < LAG])) == 300 and len(set(row[high < LAG])) == 100
    assert ((low > LAG) & ~(high < LAG)).mean() < 0.02
    off = np.fmin(low, high)
    assert np.quantile(off, 0.95) - np.quantile(off, 0.05) < BIN * bin_ns
    away = np.linalg.norm(ground - (1000.0, 2015.0, 450.0), axis=1)
    assert abs(np.median(las["range"][low < LAG]) - np.median(away)) < 5.0


@pytest.mark.parametrize("bin_ns", [0.1, 0.2, 0.25, 0.3, 1.0])
def test_width_of_a_bin_is_found(tmp_path, bin_ns):
    path = tmp_path / "a_fullwave.txt"
    heliosmaker.survey(path, bin_ns=bin_ns)
    found = json.loads(fwclass("info", path, "--json").stdout)
    assert found["waveforms"]["spacing_ns"] == pytest.approx([2 * bin_ns, 2 * bin_ns], rel=1e-9)
    assert found["format"].startswith("HELIOS++") and found["pulses"] == 300
    if bin_ns == 0.1:
        assert fwclass("info", "--waveforms", path, "--out", tmp_path / "a.png").returncode == 0


def mend(lines, how):
    if how == "cut":
        return "\n".join(lines)[: len("\n".join(lines[:40])) + 30]
    if how == "word":
        return "\n".join([*lines[:7], lines[7].replace(" ", " x", 1), *lines[8:]])
    if how == "counts":
        return "\n".join([*lines[:9], lines[9] + " 0.0" * 500, *lines[10:]])
    if how == "direction":
        return "\n".join(" ".join([*w[:4], "3", "4", "5", *w[7:]]) for w in (line.split() for line in lines))
    return "\n".join(" ".join([*w[:7], "nan", "nan", *w[9:]]) for w in (line.split() for line in lines))


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("cut", "too short"),
        ("word", "no number"),
        ("counts", "do not fit"),
        ("direction", "length"),
        ("times", "no waveform"),
    ],
)
def test_damage_is_told(tmp_path, how, words):
    path = tmp_path / "a_fullwave.txt"
    heliosmaker.survey(path, pulses=60)
    path.write_text(mend(path.read_text().splitlines(), how))
    ended = fwclass("decompose", path, tmp_path / "o.laz")
    assert ended.returncode == 1 and words in ended.stderr, ended.stderr


def test_nothing_and_one(tmp_path):
    path = tmp_path / "a_fullwave.txt"
    path.write_text("")
    assert fwclass("info", path).returncode == 0
    assert fwclass("decompose", path, tmp_path / "o.laz").returncode == 1
    heliosmaker.survey(path, pulses=1)
    assert open_source(path).census.rows == 1
    path.write_bytes(b"\0" * 5_000_000)
    with pytest.raises(InputError):
        open_source(path)
