"""The report's section about labels: figures as they are in the data, a map, remarks that cannot break the page."""

import pytest

from fwclass.publish.report import render_report
from fwclass.publish.sampling_map import sampling_map
from fwclass.publish.sampling_section import LISTED, sampling

CLASSES = [
    {"name": "ground", "code": 2, "labelled": 4000, "train": 1200, "taken": 1000, "test": 700},
    {"name": "building", "code": 6, "labelled": 500, "train": 90, "taken": 90, "test": 0},
]


COUNTS = {"labelled": [600, 45], "taken": [500, 45]}


def made(boxes=2, **changes):
    found = {
        "reference": "polygons",
        "echoes": 10_000,
        "labelled": 4500,
        "unlabelled": 5400,
        "other_codes": {"9": 100},
        "ambiguous": 7,
        "classes": CLASSES,
        "boxes": [{"box": [10.0 * k, 0.0, 10.0 * k + 8, 10.0], **COUNTS} for k in range(boxes)],
        "test_boxes": [[60.0, 0.0, 100.0, 40.0]],
        "tiles": [
            {
                "key": "0_0",
                "box": [0.0, 0.0, 50.0, 50.0],
                "echoes": 5000,
                "labelled": [3000, 500],
                "train": [1200, 90],
                "taken": [1000, 90],
                "test": [0, 0],
            },
            {
                "key": "1_0",
                "box": [50.0, 0.0, 100.0, 50.0],
                "echoes": 5000,
                "labelled": [1000, 0],
                "train": [0, 0],
                "taken": [0, 0],
                "test": [700, 0],
            },
        ],
        "gap": {"asked": 15.0, "found": 42.0},
        "polygons": [],
        "remarks": ["'<b>building</b>' has 90 rows."],
    }
    return {**found, **changes}


def test_the_section_says_what_the_data_say():
    view = sampling(made())
    assert [r["taken"] for r in view["rows"]] == ["1\u202f000", "90"]
    facts = dict(view["facts"])
    assert facts["labelled"].endswith("45.0 %") and "42.00 m" in facts["tested echoes"]
    assert facts["codes of no class"] == "9: 100" and facts["in polygons of different classes"].startswith("7 echoes")
    assert view["boxes"][0]["cells"] == ["500 of 600", "45 of 45"] and view["more"] == 0
    assert sampling(made(boxes=LISTED + 3))["more"] == 3
    assert sampling(None) is None and sampling({}) is None
    assert "no tested echo" in dict(sampling(made(gap={"asked": 15.0, "found": None}))["facts"])["tested echoes"]


@pytest.mark.parametrize("boxes", [0, 1, 4])
def test_the_page_holds_the_section_and_the_map(boxes, tmp_path):
    figure = sampling_map(made(boxes))
    assert figure.startswith(b"\x89PNG") and figure == sampling_map(made(boxes))
    told = render_report({"survey": "s", "sampling": made(boxes)}, {"sampling": figure}, tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text()
    assert "sampling" in told["sections"] and 'id="sampling"' in page and "data:image/png" in page
    assert "&lt;b&gt;building" in page and "<b>building" not in page
    assert ("training area</th>" in page) == (boxes > 0)


def test_an_area_without_labels_is_crossed_out_and_changes_the_map():
    empty = made()
    empty["boxes"] = [{**empty["boxes"][0], "labelled": [0, 0], "taken": [0, 0]}, empty["boxes"][1]]
    assert sampling_map(empty) != sampling_map(made())
