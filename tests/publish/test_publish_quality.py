"""The words and tables of a survey's quality: complete whatever is missing, and escaped."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
from browser import seen
from pyproj import CRS

from fwclass.grid import Window
from fwclass.publish.drawing import View
from fwclass.publish.params import PublishParams
from fwclass.publish.quality_page import density_picture, difference_picture, render_quality
from fwclass.publish.quality_section import LISTED, quality

STRIP = {
    "name": "a<b>",
    "files": ["a<b>"],
    "echoes": 1234,
    "times": None,
    "azimuth": 12.0,
    "timed": False,
    "centre": [0.0, 0.0],
    "width": 400.0,
    "length": 4000.0,
    "pairs": 0,
    "group": 0,
    **{f"{n}{e}": None for n in ("height", "roll", "pitch") for e in ("", "_error")},
}
BARE: dict[str, Any] = {
    "survey": "v<i>",
    "echoes": 10,
    "noise": 10,
    "noise_share": 1.0,
    "pulses": 0,
    "density": {"cell": 2.0, "area": 0.0, "echoes": None, "pulses": None, "spacing": None, "percentiles": None},
    "voids": {"least": 0.0, "count": 0, "area": 0.0, "share": None, "largest": []},
    "strips": {
        "by": "files",
        "pairs": 0,
        "adjusted": 0,
        "apart": 0,
        "rms": None,
        "left": None,
        "sigma": None,
        "strips": [],
        "between": [],
        "roughness": {"places": 0, "smoothest": None, "median": None},
    },
    "remarks": ["all echoes are <noise>"],
}


def test_nothing_but_noise_has_a_page(tmp_path: Path) -> None:
    render_quality(BARE, [], "1", tmp_path / "q.html")
    page = (tmp_path / "q.html").read_text()
    assert "All echoes are &lt;noise&gt;." in page and "v&lt;i&gt;" in page and "<i>" not in page and "None" not in page


def test_many_strips_are_cut_short_and_names_escaped(tmp_path: Path) -> None:
    made = copy.deepcopy(BARE)
    made["strips"]["strips"] = [STRIP] * (LISTED + 3)
    told = quality(made)
    assert told is not None and len(told["strips"]) == LISTED and told["more_strips"] == 3
    render_quality(made, [], "1", tmp_path / "q.html")
    page = (tmp_path / "q.html").read_text()
    assert "and 3 more" in page and "a&lt;b&gt;" in page and "<b>a" not in page and "12° or back" in page


def test_the_page_says_where_of_what_and_that_a_wide_map_moves(tmp_path: Path, params: PublishParams) -> None:
    values = np.ones((100, 200), np.float32)
    picture = density_picture(values, View.of(Window(2.0, 250_000, 2_700_000, 200, 100)), params)
    assert picture is not None
    path = tmp_path / "q.html"
    render_quality(BARE, [picture], "1", path, CRS.from_epsg(2154), ["a<b>", "c", "d", "e"])
    page = path.read_text()
    assert "RGF93 v1 / Lambert-93 (EPSG:2154)" in page and "4 files: a&lt;b&gt;, c, d and 1 more" in page
    assert 'class="long"' in page and seen(path, 390).width <= 390
    render_quality(BARE, [], "1", path)
    assert "in no known system" in path.read_text() and 'class="long"' not in path.read_text()


OFFSET = {"east": -0.03, "north": 0.04, "distance": 0.05, "error": 0.005, "slopes": 60}


def test_the_worst_pairs_come_first() -> None:
    made = copy.deepcopy(BARE)
    made["strips"]["strips"] = [{**STRIP, "name": n, "height": 0.012, "height_error": 0.001} for n in "abc"]
    made["strips"] |= {"pairs": 3, "rms": 0.1, "left": 0.02}
    made["strips"]["between"] = [
        {"first": 0, "second": 1, "pairs": 2, "mean": 0.01, "rms": 0.02},
        {"first": 0, "second": 2, "pairs": 1, "mean": -0.2, "rms": 0.3, "offset": OFFSET},
    ]
    told = quality(made)
    assert told is not None
    assert [row["names"] for row in told["between"]] == ["a – c", "a – b"]
    assert told["between"][0]["cells"] == ["1", "-20.0", "30.0", "-3.0", "+4.0", "0.5"]
    assert ("apart in plan", "5.0 ± 0.5 cm at most, a – c") in told["rows"]
    assert told["strips"][0]["cells"][4] == "+1.2\u00a0±\u00a00.10"


def test_maps_of_nothing_are_none_and_of_one_value_are_drawn(params: PublishParams) -> None:
    view = View.of(Window(2.0, 250_000, 2_700_000, 20, 10))
    nothing = np.full((10, 20), np.nan, np.float32)
    assert density_picture(nothing, view, params) is None and difference_picture(nothing, view, params) is None
    some = nothing.copy()
    some[3:5] = 2.0
    for picture in (density_picture(some, view, params), difference_picture(some, view, params)):
        assert picture is not None and picture.png.startswith(b"\x89PNG")
