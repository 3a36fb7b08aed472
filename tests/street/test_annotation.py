"""Rectangles by hand: applied in their order, checked, shown, continued."""

import math

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from streetmaker import config, directory

from fwclass.errors import InputError
from fwclass.graph.street_recordings import open_recording
from fwclass.single_file.street.annotate import annotate
from fwclass.street.annotation import read_boxes
from fwclass.street.frames import Scan

HEAD = "begin,end,y0,y1,z0,z1,kind,class\n"
SCAN = Scan(1081, -2.356, 0.00436, 0.1, 30.0)


def annotated(tmp_path, lines, out=True, preview=False):
    path = tmp_path / "a.csv"
    if lines is not None:
        path.write_text(HEAD + lines)
    there = tmp_path / "out.parquet" if out else None
    shown = tmp_path / "shown" if preview else None
    return annotate(directory() / "drive.parquet", path, there, shown, 2.0, True, config().street)


def test_the_drive_that_tests_share_lies_where_pytest_sweeps(tmp_path_factory):
    """In the system's directory for temporary files it would stay for good."""
    assert directory().is_relative_to(tmp_path_factory.getbasetemp())


def test_rectangles_give_labels_in_their_order(tmp_path):
    made = annotated(
        tmp_path,
        "0,2,-20,0,1,20,include,5\n0,2,-20,0,3,4,exclude,\n0,2,,,,,rest,2\n1,3,50,60,0,1,include,5\n",
        preview=True,
    )
    assert any("line 5: no return" in text for text in made["remarks"])
    assert made["next"] == [2.0, 4.0]
    assert {p.rsplit("/", 1)[1] for p in made["pictures"]} >= {"slice-000000.00.png", "next.png"}
    frames = list(open_recording(tmp_path / "out.parquet", SCAN).frames())
    for frame in frames[::20]:
        here = np.isfinite(frame.ranges)
        z = frame.ranges * np.sin(frame.scan.first + frame.scan.step * np.arange(1081))
        inner = here & (z > 3.01) & (z < 3.99)
        if frame.place < 2:
            assert (frame.labels[here] > 0).all()
            assert not (frame.labels[inner] == 5).any()
        else:
            assert not frame.labels.any()
    assert set(np.unique(np.concatenate([f.labels for f in frames]))) == {0, 2, 5}


def test_an_annotation_is_begun_and_goes_on(tmp_path):
    made = annotated(tmp_path, None, out=False, preview=True)
    assert made["begun"]
    assert made["next"] == [0.0, 2.0]
    assert made["unlabelled"] == 1.0
    made = annotated(tmp_path, "0,2,,,,,rest,2\n", out=False)
    assert made["next"] == [2.0, 4.0]


def test_boxes_that_overlap_are_told(tmp_path):
    made = annotated(tmp_path, "0,2,-9,0,1,9,include,5\n1,2,-9,0,1,9,include,6\n", out=False)
    assert any("lines 2 and 3: class 5 and 6 overlap" in text for text in made["remarks"])


def test_a_crowd_of_rectangles_is_refused_and_few_of_their_pairs_are_named(tmp_path):
    """Pairs grow with the square of the rectangles: 3 000 lines took 1.1 GB."""
    crowd = "".join(f"0,2,-9,0,1,9,include,{5 + k % 2}\n" for k in range(1001))
    (tmp_path / "a.csv").write_text(HEAD + crowd)
    with pytest.raises(InputError, match="too many rectangles lie at one place of the road"):
        read_boxes(tmp_path / "a.csv")
    (tmp_path / "a.csv").write_text(HEAD + "".join(f"{k},{k + 1},-9,0,1,9,include,5\n" for k in range(1001)))
    assert len(read_boxes(tmp_path / "a.csv")) == 1001
    made = annotated(tmp_path, crowd[: 100 * (len(crowd) // 1001)], out=False)
    assert sum("overlap" in text for text in made["remarks"]) == 21
    assert "more rectangles overlap" in made["remarks"]


@pytest.mark.parametrize("letters", [140_000, 5_000_000])
def test_a_field_too_long_for_a_table_is_refused_in_words(letters, tmp_path):
    """Of a process that reads waveforms as text, csv takes longer ones (`read.raw_csv`)."""
    (tmp_path / "a.csv").write_text(HEAD + "0,2,-9,0,1,9,include," + "5" * letters + "\n")
    with pytest.raises(InputError, match="no table" if letters > 1 << 22 else "no table|cannot be used"):
        read_boxes(tmp_path / "a.csv")


def test_all_that_is_wrong_is_told_at_once(tmp_path):
    (tmp_path / "a.csv").write_text(
        HEAD
        + "2,0,0,1,0,1,include,5\n0,1,1,0,0,1,include,5\n0,1,0,1,0,1,maybe,5\n"
        + "0,1,0,1,0,1,include,300\n0,1\n0,x,0,1,0,1,include,5\n"
    )
    with pytest.raises(InputError, match="6 rectangles cannot be used") as told:
        read_boxes(tmp_path / "a.csv")
    assert "line 2: begin, end are turned round" in str(told.value)
    (tmp_path / "b.csv").write_text("x,y\n")
    with pytest.raises(InputError, match="another heading"):
        read_boxes(tmp_path / "b.csv")


def test_a_slice_wider_than_any_road_is_shown(tmp_path):
    """Its picture's name was 312 letters."""
    made = annotated(tmp_path, "-1e308,1e308,,,,,rest,2\n", preview=True)
    assert {p.rsplit("/", 1)[1] for p in made["pictures"]} == {"slice--1e+308.png"}


def test_many_rectangles_without_returns_are_counted(tmp_path):
    """100 000 lines were 6.8 MB of remarks, and pictures asked every frame for each."""
    lines = "".join(f"{k * 1e-3:g},{k * 1e-3 + 5e-4:g},-9,0,100,101,include,5\n" for k in range(20_000))
    made = annotated(tmp_path, lines, preview=True)
    assert len(made["remarks"]) == 21
    assert made["remarks"][-1] == "no return lies in 19,980 more rectangles"


def test_a_recording_without_a_frame_is_told_where_it_would_be_written(tmp_path):
    """It was told that the file beside the output is not there."""
    columns = {"time": pa.array([math.nan]), "speed": pa.array([1.0]), "ranges": pa.array([[1.0, 2.0]])}
    pq.write_table(pa.table(columns), tmp_path / "r.parquet")
    (tmp_path / "a.csv").write_text(HEAD)
    with pytest.raises(InputError, match="no frame of the recording can be used"):
        annotate(tmp_path / "r.parquet", tmp_path / "a.csv", tmp_path / "o.parquet", None, 2.0, True, config().street)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.csv", "r.parquet"]


@pytest.mark.parametrize(
    "line", ["0,1_2,-20,0,1,20,include,5", "0,2,-20,0,1,20,include,1_5", "0,\u0662,-20,0,1,20,include,5"]
)
def test_words_that_python_alone_takes_for_numbers_are_refused(tmp_path, line):
    """1_2 was taken for 12 m of road."""
    path = tmp_path / "a.csv"
    path.write_text(HEAD + line + "\n")
    with pytest.raises(InputError, match=r"cannot be used[\s\S]*no number"):
        read_boxes(path)
