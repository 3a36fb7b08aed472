"""Tiles checked out for QGIS and collected again; what QGIS does to a file is done here by other writers."""

from __future__ import annotations

import json
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
from commandline import fwclass
from copcreader import nodes_of
from smallsurvey import small_survey

from fwclass.formats.copc import Cube, write_copc
from fwclass.formats.echo_labels import TAKEN_BACK, EchoLabels, echo_labels_bytes, read_echo_labels
from fwclass.formats.las_header import read_header
from fwclass.store.atomic import file_digest
from fwclass.store.corrections import add_corrections, read_corrections

TILES = "20000_216000,20001_216000"
NAMES = {2: "ground", 5: "bush"}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A run of a small survey, which no test writes to: (survey, root)."""
    place = tmp_path_factory.mktemp("checked")
    survey = small_survey(place, tile=25)
    ended = fwclass("run", survey, "--out", place / "run", "--workers", 0)
    assert ended.returncode == 0, ended.stderr
    return survey, place / "run"


@pytest.fixture
def run(made, tmp_path) -> Path:
    root = tmp_path / "run"
    shutil.copytree(made[1], root, symlinks=True)
    return root


@pytest.fixture
def out(run, tmp_path) -> Path:
    ended = fwclass("label", "checkout", run, tmp_path / "out", "--tiles", TILES)
    assert ended.returncode == 0, ended.stderr
    return tmp_path / "out"


def collect(out, *words):
    return fwclass("label", "collect", out, "--who", "me", *words)


def tile(out, number=0) -> Path:
    return out / f"{TILES.split(',')[number]}.copc.laz"


def read(path):
    return laspy.read(path, laz_backend=laspy.LazBackend.Laszip)


def saved_plainly(las, path, pulse=True, rows=slice(None)):
    """As LAZ in the points' order, with no more than the fields that echoes are known by."""
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales, header.offsets = las.header.scales, las.header.offsets
    names = ("X", "Y", "Z", "point_source_id", "return_number", "classification")
    if pulse:
        header.add_extra_dims([laspy.ExtraBytesParams("pulse", "u4")])
        names = (*names, "pulse")
    plain = laspy.LasData(header)
    for name in names:
        plain[name] = np.asarray(las[name])[rows]
    path.unlink()
    plain.write(path, laz_backend=laspy.LazBackend.Lazrs)


def edited(path, change, copc=True):
    """Give a tile the classes that `change` makes of its points; as COPC node by node, or as plain LAZ."""
    las = read(path)
    las.classification = change(las)
    if not copc:
        saved_plainly(las, path)
        return
    header = read_header(path)
    nodes, block = nodes_of(header), bytearray(path.read_bytes()[:375])
    block[104] &= 0x3F
    records = [v.raw for v in header.vlrs if v.user not in ("copc", "laszip encoded")]
    rows = las.points.array.view(np.uint8).reshape(len(las.points), -1)
    stored = sorted(nodes, key=lambda n: n.offset)
    first = dict(zip([n.key for n in stored], np.cumsum([0, *(n.points for n in stored)]), strict=False))
    order = np.concatenate([first[n.key] + np.arange(n.points) for n in nodes])
    keys, counts = np.array([n.key for n in nodes], np.int64), np.array([n.points for n in nodes], np.int64)
    with path.open("w+b") as file:
        write_copc(file, bytes(block), records, rows, order, keys, counts, Cube((0, 0, 0), 100.0, 1.0, (0.0, 0.0)))


def some(las):
    """Points of a corner of a tile."""
    return np.flatnonzero((las.x < np.min(las.x) + 6) & (las.y < np.min(las.y) + 6))


def swapped(las):
    code = np.array(las.classification)
    rows = some(las)
    code[rows] = 7 - code[rows]
    return code


def one_less(las):
    """One echo of no class."""
    return np.where(np.arange(len(las.points)) == some(las)[0], 0, las.classification)


def delivered(run):
    return pq.read_table(run / "parquet").to_pandas()


def test_what_was_changed_becomes_corrections_and_the_next_run_takes_them(run, out, made):
    before = {k: tile(out, k).read_bytes() for k in (0, 1)}
    kept = {p: p.read_bytes() for p in (run / "laz" / "tiles").iterdir()}
    assert all(before[k] == kept[run / "laz" / "tiles" / tile(out, k).name] for k in (0, 1))
    edited(tile(out), swapped)
    edited(tile(out, 1), swapped, copc=False)
    ended = collect(out)
    assert ended.returncode == 0, ended.stderr
    rows = read_corrections(run)
    table = delivered(run)
    wanted = {}
    for k in (0, 1):
        west, south = (25.0 * int(v) for v in TILES.split(",")[k].split("_"))
        mine = table[(table.x >= west) & (table.x < west + 25) & (table.y >= south) & (table.y < south + 25)]
        mine = mine[(mine.x < mine.x.min() + 6) & (mine.y < mine.y.min() + 6)]
        wanted |= {(r.strip, r.pulse, r.echo_number): (7 - r.classification, r.x, r.y, r.z) for r in mine.itertuples()}
    assert len(wanted) > 50 and (rows.who == "me").all() and len(set(rows.time)) == 1
    assert wanted == {
        (s, p, e): (c, x, y, z)
        for s, p, e, c, x, y, z in zip(
            *(getattr(rows, n).tolist() for n in ("strip", "pulse", "echo_number", "code", "x", "y", "z")), strict=True
        )
    }
    for old, new in ((2, 5), (5, 2)):
        count = sum(c == new for c, *_ in wanted.values())
        assert f"{NAMES[old]} -> {NAMES[new]}: {count}\n" in ended.stdout
    assert {p: p.read_bytes() for p in kept} == kept
    again = fwclass("run", made[0], "--out", run, "--workers", 0)
    assert again.returncode == 0, again.stderr
    report = json.loads((run / "report.json").read_text())
    assert report["sampling"]["corrections"] == {"standing": len(wanted), "taken_back": 0, "applied": len(wanted)}
    # another delivery by now, with all echoes at their place: more can be collected
    edited(tile(out, 1), one_less, copc=False)
    ended = collect(out)
    assert ended.returncode == 0 and "no class: 1\n" in ended.stdout, ended.stderr
    assert read_corrections(run).rows == rows.rows + 1


def test_what_was_not_changed_is_confirmed_on_request(run, out, made):
    edited(tile(out), swapped)
    ended = collect(out, "--confirm")
    assert ended.returncode == 0 and "keep their class" in ended.stdout, ended.stderr
    changed, table = read_corrections(run).standing(), delivered(run)
    mine = table[(table.x >= 500_000) & (table.x < 500_050) & (table.y >= 5_400_000) & (table.y < 5_400_025)]
    assert changed.rows == len(mine)
    by_echo = {(r.strip, r.pulse, r.echo_number): r.classification for r in mine.itertuples()}
    now = zip(changed.strip.tolist(), changed.pulse.tolist(), changed.echo_number.tolist(), strict=True)
    differ = sum(by_echo[k] != c for k, c in zip(now, changed.code.tolist(), strict=True))
    assert 0 < differ < 0.5 * changed.rows
    assert "nothing new" in collect(out).stdout and read_corrections(run).standing().rows == changed.rows
    assert fwclass("run", made[0], "--out", run, "--workers", 0, "--set", "train.trees=3").returncode == 0
    ended = collect(out, "--confirm")
    assert ended.returncode == 1 and "delivered anew since" in ended.stderr


def test_again_adds_nothing_and_what_is_undone_is_taken_back(run, out):
    original = tile(out).read_bytes()
    assert "nothing new" in collect(out).stdout and not (run / "labels").exists()
    edited(tile(out), swapped)
    collect(out)
    first = read_corrections(run)
    same = (run / "labels" / "corrections.parquet").read_bytes()
    assert "nothing new" in collect(out).stdout
    assert (run / "labels" / "corrections.parquet").read_bytes() == same
    # by another hand meanwhile: one echo twice, another taken back
    other = EchoLabels.of(
        {n: getattr(first, n)[:2] for n in ("strip", "pulse", "echo_number", "x", "y", "z")}, [0, TAKEN_BACK], 5, "you"
    )
    add_corrections(run, lambda _: other)
    assert "nothing new" in collect(out).stdout
    tile(out).write_bytes(original)
    ended = collect(out)
    assert f"taken back: {first.rows - 2}\n" in ended.stdout
    standing = read_corrections(run).standing()
    assert (standing.code == TAKEN_BACK).sum() == first.rows - 1 and (standing.code == 0).sum() == 1
    assert "nothing new" in collect(out).stdout
    edited(tile(out), swapped)
    ended = collect(out)
    assert ended.returncode == 0
    assert (read_corrections(run).standing().code == first.standing().code).sum() >= first.rows - 2


def test_the_project_names_the_tiles_and_their_classes(out):
    with zipfile.ZipFile(out / "checkout.qgz") as archive:
        root = ElementTree.fromstring(archive.read("checkout.qgs"))  # noqa: S314 - our own
    layers = root.findall("projectlayers/maplayer")
    assert [m.findtext("datasource") for m in layers] == [f"./{t}.copc.laz" for t in TILES.split(",")]
    assert {m.findtext("provider") for m in layers} == {"copc"} and {m.get("type") for m in layers} == {"point-cloud"}
    labels = {c.get("label") for c in layers[0].iter("category")}
    assert any("ground" in (t or "") for t in labels) and any("bush" in (t or "") for t in labels)


def test_tiles_are_checked_out_whole_or_not_at_all(run, out, tmp_path):
    def refused(words, code, *line):
        before = sorted(p.name for p in tmp_path.iterdir())
        ended = fwclass("label", "checkout", *line)
        assert ended.returncode == code and words in ended.stderr, ended.stderr
        assert sorted(p.name for p in tmp_path.iterdir()) == before

    refused("a directory of its own", 2, run, out, "--tiles", TILES)
    refused("no such tile", 2, run, tmp_path / "new", "--tiles", "20000_216000,1_2")
    refused("not a tile key", 2, run, tmp_path / "new", "--tiles", "../x")
    refused("no tile is named", 2, run, tmp_path / "new", "--tiles", " ")
    refused("no such run", 1, tmp_path / "none", tmp_path / "new", "--tiles", TILES)
    refused("on object storage", 2, "s3://b/run", tmp_path / "new", "--tiles", TILES)
    path = (run / "laz" / "tiles" / tile(out).name).resolve()
    path.chmod(0o644)
    data = bytearray(path.read_bytes())
    data[-1000] ^= 1
    path.unlink()
    path.write_bytes(data)
    refused("a delivered tile is damaged", 1, run, tmp_path / "new", "--tiles", TILES)


def doubled(path):
    las = read(path)
    rows = np.arange(len(las.points))
    rows[7] = 8
    saved_plainly(las, path, rows=rows)


def shifted(path):
    las = read(path)
    las.Z[0] += 1
    saved_plainly(las, path)


def alien(path):
    edited(path, lambda las: np.where(np.arange(len(las.points)) < 3, 17, las.classification))


def forged(out, change):
    """Echoes that the run has not: a tile and the classes that it had, both made to fit each other and the note."""
    path, key = out / "labels" / "20000_216000.parquet", "20000_216000"
    las, labels = read(tile(out)), read_echo_labels(path, path)
    las.classification = swapped(las)
    labels = change(las, labels)
    saved_plainly(las, tile(out))
    path.write_bytes(echo_labels_bytes(labels))
    note = json.loads((out / "checkout.json").read_text())
    relabel(out / "checkout.json", tiles=note["tiles"] | {key: file_digest(path)})


def other_pulses(las, labels):
    las.pulse = np.asarray(las.pulse) + 1_000_000
    return replace(labels, pulse=labels.pulse + np.uint32(1_000_000))


def moved(las, labels):
    las.x = np.asarray(las.x) + 1
    return replace(labels, x=labels.x + 1)


def relabel(note, **changes):
    note.write_text(json.dumps(json.loads(note.read_text()) | changes))


FAULTS = {
    "1 of them are missing": lambda out, run: doubled(tile(out)),
    "has not the echoes": lambda out, run: shifted(tile(out)),
    "expected: ": lambda out, run: saved_plainly(read(tile(out)), tile(out), rows=slice(1, None)),
    "lacks the number of the pulse": lambda out, run: saved_plainly(read(tile(out)), tile(out), pulse=False),
    "17 (3 echoes)": lambda out, run: alien(tile(out)),
    "is missing": lambda out, run: tile(out).unlink(),
    "cut short": lambda out, run: tile(out).write_bytes(tile(out).read_bytes()[:-9000]),
    "not what was written": lambda out, run: (out / "labels" / "20000_216000.parquet").write_bytes(b"PAR1"),
    "no tiles were checked out": lambda out, run: (out / "checkout.json").unlink(),
    "cannot be read": lambda out, run: (out / "checkout.json").write_text("{"),
    "not a tile key": lambda out, run: relabel(out / "checkout.json", tiles={"../../x": "1"}),
    "got: not a tile key": lambda out, run: relabel(out / "checkout.json", tiles={"1_2\n": "1"}),
    "has no absolute path": lambda out, run: relabel(out / "checkout.json", run="../run"),
    "others, for example": lambda out, run: forged(out, other_pulses),
    "not at their place any more": lambda out, run: forged(out, moved),
    "times are wanted": lambda out, run: relabel(out / "checkout.json", collected=[2**63]),
    "of another run": lambda out, run: relabel(out / "checkout.json", survey="other"),
    "--run where it is now": lambda out, run: run.rename(run.with_name("elsewhere")),
    "delivered nothing": lambda out, run: (run / "current").unlink(),
}


@pytest.mark.parametrize("words", FAULTS)
def test_what_cannot_be_collected_is_told_and_nothing_is_written(run, out, words):
    edited(tile(out, 1), swapped)
    FAULTS[words](out, run)
    before = {p: p.read_bytes() for p in out.rglob("*") if p.is_file()}
    ended = collect(out)
    assert ended.returncode == 1 and words in ended.stderr and "Traceback" not in ended.stderr, ended.stderr
    assert before == {p: p.read_bytes() for p in out.rglob("*") if p.is_file()}
    for root in run.parent.glob("*"):
        assert not (root / "labels" / "corrections.parquet").exists()
    assert not list(out.parent.rglob(".*.parquet*"))


def test_only_echoes_of_the_tiles_are_taken_back(run, out):
    """A note that named the times of others' corrections took them back, wherever they were."""
    labels = read_echo_labels(out / "labels" / "20000_216000.parquet", "")
    elsewhere = EchoLabels.of(
        {**{n: getattr(labels, n)[:3] for n in ("strip", "echo_number", "x", "y", "z")}, "pulse": [2**31] * 3},
        [5] * 3,
        7,
        "you",
    )
    add_corrections(run, lambda _: elsewhere)
    relabel(out / "checkout.json", collected=[7])
    ended = collect(out)
    assert ended.returncode == 0 and "nothing new" in ended.stdout, ended.stderr
    assert (read_corrections(run).standing().code == 5).all()


def test_a_run_that_was_moved_is_named(run, out):
    edited(tile(out), swapped)
    moved = run.rename(run.with_name("elsewhere"))
    ended = collect(out, "--run", moved)
    assert ended.returncode == 0 and read_corrections(moved).rows > 20, ended.stderr


def test_a_new_delivery_is_refused_only_where_changed_echoes_moved(made, run, out, tmp_path):
    """The same survey, its points in the corner of one tile 0.1 m higher; of the same names, so a run of it may be."""
    survey, _ = made
    place = tmp_path / "other"
    place.mkdir()
    shutil.copy(survey, place)
    las = laspy.read(survey.with_name("a.las"))
    high = (las.x < 500_010) & (las.y < 5_400_010)
    las.z = np.where(high, las.z + 0.1, las.z)
    las.write(place / "a.las")
    ended = fwclass("run", place / survey.name, "--out", place / "run", "--workers", 0)
    assert ended.returncode == 0, ended.stderr
    edited(tile(out, 1), swapped)
    ended = collect(out, "--run", place / "run")
    assert ended.returncode == 0 and read_corrections(place / "run").rows > 20, ended.stderr
    edited(tile(out), swapped)
    ended = collect(out, "--run", place / "run")
    assert ended.returncode == 1 and "not at their place any more" in ended.stderr
    assert read_corrections(place / "run").rows == len(set(read_corrections(place / "run").key.tolist()))


def test_the_least_sure_tiles_are_those_of_the_report(run, tmp_path):
    listed = json.loads((run / "report.json").read_text())["sureness"]["tiles"]
    ended = fwclass("label", "checkout", run, tmp_path / "least", "--least-sure", 2)
    assert ended.returncode == 0, ended.stderr
    note = json.loads((tmp_path / "least" / "checkout.json").read_text())
    assert set(note["tiles"]) == {one["tile"] for one in listed[:2]}
    for words in ((), ("--least-sure", 1, "--tiles", TILES)):
        ended = fwclass("label", "checkout", run, tmp_path / "other", *words)
        assert ended.returncode == 2 and "one of --tiles, --least-sure and --places" in ended.stderr
    assert not (tmp_path / "other").exists()


def test_info_tells_what_labels_by_echo_hold(run, out):
    """It took them for polygons, and advised to write them as GeoParquet."""
    told = fwclass("info", out / "labels" / "20000_216000.parquet")
    assert told.returncode == 0 and "labels by echo" in told.stdout and "no faults found" in told.stdout, told.stderr
    labels = read_echo_labels(out / "labels" / "20000_216000.parquet", "")
    assert f"2: {(labels.code == 2).sum():,}, 5: {(labels.code == 5).sum():,}" in told.stdout
    edited(tile(out), one_less)
    collect(out)
    told = json.loads(fwclass("info", "--json", run / "labels" / "corrections.parquet").stdout)
    assert "'labels': 1" in str(told) and "'codes': {'0': 1}" in str(told)
    assert "polygons" in fwclass("info", run / "parquet" / "20000_216000.parquet").stdout
