"""Plain text points: every way to write them gives the same points, and damage is told by line."""

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fwclass.errors import InputError
from fwclass.publish.text import write_text
from fwclass.read.cloud import read_point_cloud
from fwclass.read.text import read_text

ROWS = [(513632.6, 5403197.75, 291.3, 0), (513632.54, 5403196.32, -1.5, 1), (513632.49, 5403194.8, 1e-3, 1)]


def text(path, content):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def lines(pattern, decimal=".", ends="\n"):
    return ends.join(pattern.format(*(str(v).replace(".", decimal) for v in row)) for row in ROWS) + ends


WAYS = {
    "spaces": lines("{} {} {} {}"),
    "tabs": lines("{}\t{}\t{}\t{}"),
    "runs of blanks": lines("  {} \t {}   {}\t\t{}  "),
    "commas": lines("{},{},{},{}"),
    "commas and spaces": lines("{}, {},  {}, {} "),
    "semicolons": lines("{};{};{};{}"),
    "decimal commas": lines("{};{};{};{}", decimal=","),
    "decimal commas and tabs": lines("{}\t{}\t{}\t{}", decimal=","),
    "windows": lines("{} {} {} {}", ends="\r\n"),
    "old mac": lines("{} {} {} {}", ends="\r"),
    "empty lines": "\n\n" + lines("{} {} {} {}\n\n"),
    "comments": "# made by hand\n" + lines("{} {} {} {} # seen"),
    "no last line end": lines("{} {} {} {}").rstrip("\n"),
    "byte order mark": b"\xef\xbb\xbf" + lines("{} {} {} {}").encode(),
    "header": "X Y Z label\n" + lines("{} {} {} {}"),
    "commented header": "# x y z label\n" + lines("{} {} {} {}"),
    "slashes": "//X Y Z label\n" + lines("{} {} {} {}"),
    "quoted header": '"x","y","z","label"\n' + lines("{},{},{},{}"),
    "another order": "label,z,northing,easting\n" + lines("{3},{2},{1},{0}"),
    "more columns": "x y z intensity label\n" + lines("{} {} {} 12.5 {}"),
}


@pytest.mark.parametrize("way", WAYS)
def test_every_way_to_write_points_gives_the_same_points(tmp_path, way):
    cloud = read_text(text(tmp_path / "a.txt", WAYS[way]))
    x, y, z, label = np.array(ROWS).T
    np.testing.assert_array_equal(np.stack(cloud.xyz), np.stack([x, y, z]))
    np.testing.assert_array_equal(cloud.label, label)
    assert cloud.kind == "isprs"
    np.testing.assert_array_equal(cloud.codes, [2, 1, 1])
    assert cloud.dropped == (("intensity",) if way == "more columns" else ())


def test_what_a_label_is(tmp_path):
    codes = read_text(text(tmp_path / "a.txt", "1 2 3 2\n1 2 4 1\n"))
    assert codes.kind == "code" and codes.codes.tolist() == [2, 1]
    named = read_text(text(tmp_path / "b.txt", "x y z classification\n1 2 3 1\n1 2 4 0\n"))
    assert named.kind == "code" and named.codes.tolist() == [1, 0]
    assert read_text(text(tmp_path / "c.txt", "1 2 3\n")).codes is None


def test_numbers_that_are_none_stay_in_their_place(tmp_path):
    cloud = read_text(text(tmp_path / "a.txt", "1 2 3 0\nnan 2 3 1\n1 inf 3 1\n1 2 NULL 0\n"))
    assert np.isfinite(np.stack(cloud.xyz)).sum(axis=0).tolist() == [3, 2, 2, 2]
    points = read_point_cloud(tmp_path / "a.txt")
    assert points.usable.tolist() == [True, False, False, False] and points.unfinished == 3


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("1 2 3\n\n1 2\n", ["line 3", "number of columns", "expected: 3", "got: 2"]),
        ("1 2 3 0\n1 2 3 0 5\n", ["line 2", "expected: 4", "got: 5"]),
        ("1 2\n3 4\n", ["line 1", "3 or 4", "got: 2"]),
        ("1 2 3 4 5\n", ["line 1", "3 or 4", "header"]),
        ("# head\n1 2 3\n1 2o 3\n", ["line 3", "no number", "'2o'", "as y"]),
        ("1 2 3 0.5\n", ["line 1", "0 to 255", "0.5", "intensity"]),
        ("1 2 3 0\n\n1 2 3 256\n", ["line 3", "0 to 255", "256"]),
        ("1 2 3 0\n1 2 3 nan\n", ["line 2", "0 to 255"]),
        ("a b c\n1 2 3\n", ["does not name x, y and z", "a b c"]),
        ("x y z\n1 2 3 0\n", ["line 2", "header and lines", "expected: 3"]),
        ("x y z\n", ["no points"]),
        ("", ["no points", "0 bytes"]),
        (" \n\n", ["no points"]),
        ("hello\nworld\n", ["line 2", "neither numbers nor a header"]),
        ("x,y,z,class\n1,2,3,NVA\n", ["line 2", "a number in column class (a code of the LAS specification)"]),
        ("X [ft],Y [ft],Z [ft],id\n1,2,3,P1\n", ["line 2", "header that names x, y and z", "none of them"]),
        (b"\x00\x01\x02\xff" * 50, ["this is no text", "byte 0"]),
        ("1 2 3\n".encode("utf-16"), ["UTF-16"]),
    ],
)
def test_what_is_no_table_is_told_by_line(tmp_path, content, told):
    with pytest.raises(InputError) as fault:
        read_text(text(tmp_path / "bad.txt", content))
    for words in ("bad.txt", *told):
        assert words in str(fault.value)


def test_metres_in_a_heading_change_nothing(tmp_path):
    cloud = read_text(text(tmp_path / "a.csv", "Name;Easting [m];Northing (m);Height [metres]\nP1;1,5;2;3\nP2;4;5;6\n"))
    assert cloud.x.tolist() == [1.5, 4.0] and cloud.z.tolist() == [3.0, 6.0]


@pytest.mark.statistics
@settings(max_examples=300, deadline=None)
@given(st.one_of(st.binary(max_size=300), st.text('0123456789.,;-+einfa #\t\r\n"xyz/_', max_size=200)))
def test_any_bytes_are_points_or_refused(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "fuzz.txt"
    text(path, content)
    try:
        cloud = read_text(path)
    except InputError:
        return
    assert len(cloud.x) == len(cloud.y) == len(cloud.z) > 0
    assert cloud.label is None or len(cloud.label) == len(cloud.x)


@pytest.mark.statistics
@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(*[st.floats(width=64)] * 3), min_size=1, max_size=20))
def test_written_points_are_read_back_to_the_last_bit(tmp_path_factory, points):
    path = tmp_path_factory.getbasetemp() / "round.csv"
    xyz = np.array(points, float).T.copy()
    write_text(path, *xyz, np.full(len(points), 2, np.uint8))
    back = read_text(path)
    np.testing.assert_array_equal(np.stack(back.xyz), xyz)
    assert back.kind == "code" and (back.codes == 2).all()


@pytest.mark.statistics
def test_a_million_lines_take_seconds(tmp_path):
    r = np.random.default_rng(0)
    x, y, z = np.round(r.uniform(0, 1e6, (3, 1_000_000)), 3)
    write_text(tmp_path / "a.txt", x, y, z, np.ones(len(x), np.uint8))
    read_text(text(tmp_path / "warm.txt", "1  2 3\n"))
    started = time.process_time()
    cloud = read_text(tmp_path / "a.txt")
    assert time.process_time() - started < 5.0
    np.testing.assert_array_equal(cloud.z, z)


@pytest.mark.parametrize("sample", ["21", "54"])
def test_isprs_samples_agree_with_another_reader(shared_data, sample):
    path = shared_data / "isprs" / f"samp{sample}.txt"
    cloud = read_text(path)
    np.testing.assert_array_equal(np.column_stack([*cloud.xyz, cloud.label]), np.loadtxt(path))


def test_a_german_list_of_points_is_read(tmp_path):
    rows = "Punkt Nr.\tRechtswert [m]\tHochwert [m]\tHöhe\nP 1\t1,5\t2\t3\nP 2\t4\t5\t6,25\n"
    cloud = read_text(text(tmp_path / "a.txt", rows))
    assert cloud.x.tolist() == [1.5, 4.0] and cloud.y.tolist() == [2.0, 5.0] and cloud.z.tolist() == [3.0, 6.25]
    (tmp_path / "c.csv").write_bytes("Punktnr;Ost;Nord;Höhe;Code\nSüd 1;1,5;2;3,25;BP\n".encode("cp1252"))
    cloud = read_text(tmp_path / "c.csv", ignored=("code",), named=("punktnr",))
    assert (cloud.x[0], cloud.y[0], cloud.z[0], cloud.names) == (1.5, 2.0, 3.25, ("Süd 1",))
    cloud = read_text(text(tmp_path / "b.txt", "Name\tEasting [m]\tNorthing [m]\tHeight\nP1\t1.5\t2\t3\n"))
    assert cloud.x.tolist() == [1.5] and cloud.z.tolist() == [3.0]
