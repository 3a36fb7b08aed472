"""A text that was cut off inside its last line is refused, by every reader of texts, where the line shows it."""

from __future__ import annotations

from pathlib import Path

import pytest

from fwclass.errors import InputError
from fwclass.formats.last_line import check_last_line
from fwclass.read.raw_csv import open_raw_csv
from fwclass.read.text import read_text
from fwclass.read.trajectory import read_trajectory
from fwclass.street.frames import Scan
from fwclass.street.recording_csv import CsvRecording

POINTS = "".join(f"{500000 + k}.25 {5400000 + k}.50 {100 + k}.125\n" for k in range(80))
TRACK = "time,x,y,z\n" + "".join(f"{100 + k}.0,{500000 + k}.25,{5400000 + k}.50,{900}.125\n" for k in range(80))
WAVES = "# spacing_ns: 1\nx,y,z,dx,dy,dz,samples\n" + "".join(
    f"{k}.0,0.0,900.0,0.0,0.0,-0.15,{' '.join(['12'] * 30)}\n" for k in range(80)
)
FRAMES = "time,speed,ranges\n" + "".join(f"{k}.0,1.0,{','.join(['10.25'] * 30)}\n" for k in range(80))

READERS = {
    "points": (POINTS, read_text),
    "trajectory": (TRACK, read_trajectory),
    "waves": (WAVES, open_raw_csv),
    "frames": (FRAMES, lambda path: CsvRecording(path, Scan(30, -1.0, 0.05, 0.1, 30.0))),
}


@pytest.mark.parametrize("name", READERS)
def test_a_text_cut_inside_its_last_line_is_refused(tmp_path: Path, name: str) -> None:
    text, reader = READERS[name]
    path = tmp_path / "a.csv"
    for whole in (text, text[:-1]):
        path.write_text(whole)
        reader(path)
    path.write_text(text[:-4])
    with pytest.raises(InputError, match="ends inside its last line"):
        reader(path)


def test_lines_of_several_shapes_and_few_lines_tell_nothing(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    for text in (POINTS + "1 2 3\n" + POINTS[len(POINTS) // 2 : -3], POINTS[: len(POINTS) // 2 - 3], "1.5 2.5 3", ""):
        path.write_text(text)
        check_last_line(path)
