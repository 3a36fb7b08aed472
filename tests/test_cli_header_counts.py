"""Headers whose counts by return, or in fields of older versions, are not those of the points."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import lasmaker
import numpy as np
import pytest
from commandline import fwclass
from smallsurvey import small_survey

ALL, BY_RETURN, OLDER = 247, 255, 107
"""Bytes of a header where its counts are."""

PLACE = np.array([500_000, 5_400_000, 203])


def written(path: Path, changes, point_format: int = 6) -> Path:
    """Points of one and of two returns, whose header says `changes`: bytes by place."""
    number = np.array([1, 1, 2] * 40)
    of = np.array([1, 2, 2] * 40)
    xyz = np.random.default_rng(0).uniform(0, 30, (120, 3)) + PLACE
    lasmaker.write_las(path, xyz, point_format=point_format, version=(1, 4), return_number=number, number_of_returns=of)
    data = bytearray(path.read_bytes())
    for at, value in changes.items():
        data[at : at + len(value)] = value
    path.write_bytes(data)
    return path


def counts(*numbers: int, kind: str = "Q") -> bytes:
    return struct.pack(f"<{len(numbers)}{kind}", *numbers)


@pytest.mark.parametrize(
    ("changes", "point_format", "words"),
    [
        ({}, 6, ""),
        ({}, 1, ""),
        ({BY_RETURN: counts(0, 0)}, 6, "the header's counts of points by return are all 0: there are 80, 40, 0"),
        ({BY_RETURN: counts(0, 80, 40)}, 6, "by return begin with 0, 80, 40: there are 80, 40, 0"),
        (
            {OLDER: counts(119, 79, 40, kind="I")},
            1,
            "fields of older versions count other points than those of LAS 1.4 (119 and 120, by return 79, 40, 0 and "
            "80, 40, 0)",
        ),
    ],
)
def test_info_tells_what_a_header_counts_otherwise(tmp_path, changes, point_format, words):
    path = written(tmp_path / "a.las", changes, point_format)
    told = json.loads(fwclass("info", path, "--json").stdout)
    faults = [fault for fault in told["faults"] if "count" in fault]
    assert told["points"] == 120 and told["returns"] == {"1": 80, "2": 40}
    assert len(faults) == bool(words) and words in "".join(faults)


def test_points_that_the_older_field_alone_counts_are_told_as_such(tmp_path):
    """It was a file that is cut short, to be copied again."""
    path = written(tmp_path / "a.las", {ALL: counts(0)}, 1)
    for ended in (fwclass("info", path), fwclass("ground", path, tmp_path / "g.las", "--crs", "EPSG:25832")):
        assert ended.returncode == 1 and "counts no points, and its field of older" in ended.stdout + ended.stderr


def test_a_run_tells_it_and_counts_for_itself(tmp_path):
    path = small_survey(tmp_path)
    data = bytearray((tmp_path / "a.las").read_bytes())
    data[BY_RETURN : BY_RETURN + 8] = counts(17)
    (tmp_path / "a.las").write_bytes(data)
    ended = fwclass("run", path, "--out", tmp_path / "r", "--workers", 0)
    assert ended.returncode == 0, ended.stderr
    words = "a.las: the header's counts of points by return begin with 17, 0, 0: there are 6,000, 0, 0"
    report = json.loads((tmp_path / "r/report.json").read_text())
    assert words in ended.stderr and words in "\n".join(report["remarks"])
    assert words.replace("'", "&#39;") in (tmp_path / "r/report.html").read_text()
    assert report["counts"]["returns"] == 6_000 and report["input"]["files"][0]["header"] == [words[7:]]


def test_echoes_without_a_time_are_told(tmp_path):
    """Points of format 0 beside others that have times."""
    path = small_survey(tmp_path)
    xyz = np.random.default_rng(1).uniform(0, [80, 40, 0.1], (500, 3)) + PLACE
    lasmaker.write_las(tmp_path / "b.las", xyz, point_format=0, classification=np.full(500, 2))
    path.write_text(path.read_text().replace("[a.las]", "[a.las, b.las]"))
    ended = fwclass("run", path, "--out", tmp_path / "r", "--workers", 0, "--accept-implausible")
    assert ended.returncode == 0, ended.stderr
    words = "500 of 6,500 echoes have no GPS time, which is 0 in the LAZ tiles"
    assert words in ended.stderr and words in (tmp_path / "r/report.html").read_text()
