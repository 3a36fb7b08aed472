"""GPS times of another kind than the header says are told, and tell no date."""

from __future__ import annotations

import json
from pathlib import Path

import lasmaker
import laspy
import numpy as np
import pytest
from commandline import fwclass
from smallsurvey import small_survey

WEEKLY = "seconds of the week, though they are called adjusted standard time"
EPOCH = "seconds of another epoch (1970, 1980), though they are called adjusted standard time"


@pytest.mark.parametrize(
    ("first", "standard", "told", "date"),
    [
        (312_886_441.0, True, "", "2021-08-13"),
        (100_316.0, True, WEEKLY, None),  # 2011-09-15 was told
        (1_312_886_441.0, True, EPOCH, None),  # 2053
        (3e20, True, "not in seconds", None),  # ended with a traceback
        (100_316.0, False, "", None),
        (312_886_441.0, False, "though they are called seconds of the week", None),
    ],
)
def test_times_of_another_kind_tell_no_date(
    tmp_path: Path, first: float, standard: bool, told: str, date: str | None
) -> None:
    survey = small_survey(tmp_path)
    las = laspy.read(tmp_path / "a.las")
    las.gps_time = first + np.linspace(0, 60, len(las.x))
    las.header.global_encoding.gps_time_type = laspy.header.GpsTimeType(int(standard))
    las.write(tmp_path / "a.las")
    faults = " ".join(json.loads(fwclass("info", tmp_path / "a.las", "--json").stdout)["faults"])
    assert (told in faults) and ("GPS times" in faults) == bool(told), faults
    ended = fwclass("run", survey, "--out", tmp_path / "r", "--workers", 0, "--workflow", "ground")
    assert ended.returncode == 0, ended.stderr
    place = json.loads((tmp_path / "r/report.json").read_text())["place"]
    assert place["flown"] == (date and [date, date])
    assert not standard or (told in " ".join(place["remarks"]) and bool(place["remarks"]) == bool(told))
    weekly = "GPS times of a.las are called seconds of the week and are beyond one"
    assert (weekly in ended.stderr) == (not standard and bool(told)), ended.stderr
    item = json.loads((tmp_path / "r/laz/survey.vpc").read_text())["features"][0]
    assert item["properties"]["datetime"][:10] == (date or "1980-01-06")


def test_a_file_without_gps_times_does_not_say_of_which_kind_the_others_are(tmp_path: Path) -> None:
    survey = small_survey(tmp_path)
    survey.write_text(survey.read_text().replace("[a.las]", '["*.las"]'))
    las = laspy.read(tmp_path / "a.las")
    las.gps_time = 312_886_441.0 + np.linspace(0, 60, len(las.x))
    las.header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    las.write(tmp_path / "a.las")
    xyz = np.c_[las.x, las.y, las.z][:500] + 0.25
    lasmaker.write_las(tmp_path / "b.las", xyz, point_format=0)
    lasmaker.write_las(tmp_path / "c.las", np.zeros((0, 3)), point_format=6)
    ended = fwclass("run", survey, "--out", tmp_path / "r", "--workers", 0, "--workflow", "ground")
    assert ended.returncode == 0, ended.stderr
    place = json.loads((tmp_path / "r/report.json").read_text())["place"]
    assert place["flown"] == ["2021-08-13", "2021-08-13"]
    for tile in (tmp_path / "r/laz/tiles").iterdir():
        assert laspy.read(tile).header.global_encoding.gps_time_type == laspy.header.GpsTimeType.STANDARD
