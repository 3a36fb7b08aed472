"""Breaklines in a run: a wall between echoes far apart stands where its lines are; flat lines are refused."""

from __future__ import annotations

import struct
from pathlib import Path

import lasmaker
import numpy as np
import pyogrio
import pytest
import rasterio
from commandline import fwclass

from fwclass.errors import InputError
from fwclass.formats.wkb import lines
from fwclass.store.run_store import Store
from fwclass.water import along

X, Y = 500_000, 5_400_000
WORDS = ("--workflow", "ground", "--workers", "0")
FOOT = [(X + 40.0, Y - 5.0, 200.0), (X + 40.0, Y + 45.0, 200.0)]
CREST = [(X + 41.0, Y - 5.0, 203.0), (X + 41.0, Y + 45.0, 203.0)]


def wkb(points: list, kind: int = 1002) -> bytes:
    return struct.pack("<BII", 1, kind, len(points)) + np.array(points, "<f8").tobytes()


def gpkg(path: Path, kind: str, *geometry: bytes) -> None:
    shapes = np.array([*geometry, None], object)[:-1]
    pyogrio.raw.write(path, shapes, [], np.array([], object), geometry_type=kind, crs="EPSG:25832", driver="GPKG")


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two terraces, 200 m and 203 m high, with a strip of 8 m between them that no echo came back from."""
    place = tmp_path_factory.mktemp("breaklines")
    x, y = np.random.default_rng(0).uniform(0, 1, (2, 10_000)) * [[80], [40]]
    kept = abs(x - 40) > 4
    x, y = x[kept], y[kept]
    z = np.where(x < 40, 200.0, 203.0)
    lasmaker.write_las(place / "a.las", np.c_[X + x, Y + y, z], point_format=6, intensity=np.ones(len(x), int))
    gpkg(place / "wall.gpkg", "LineString Z", wkb(FOOT), wkb(CREST))
    gpkg(place / "flat.gpkg", "LineString", wkb([p[:2] for p in FOOT], 2))
    gpkg(place / "endless.gpkg", "LineString Z", wkb([FOOT[0], (X + 40.0, 1e15, 200.0)]))
    gpkg(place / "far.gpkg", "LineString Z", wkb([(a + 5000, b, c) for a, b, c in FOOT]))
    path = place / "s.yaml"
    path.write_text('survey: {name: wall, sources: [a.las], crs: "EPSG:25832"}\n')
    return path


def dtm(run: Path) -> np.ndarray:
    with rasterio.open(run / "rasters/dtm.tif") as file:
        return file.read(1)[::-1]


@pytest.mark.parametrize(
    ("lift", "side"), [(0.0, ""), pytest.param(47.6, "above", marks=pytest.mark.slow), (-2.5, "below")]
)
def test_heights_of_another_kind_are_told(survey: Path, tmp_path: Path, lift: float, side: str) -> None:
    """Along both edges of the gap, where echoes of the terraces lie within 3 m."""
    edges = [[(X + at, y, z + lift) for y in (Y - 5.0, Y + 45.0)] for at, z in ((35.5, 200.0), (44.5, 203.0))]
    gpkg(tmp_path / "edges.gpkg", "LineString Z", *map(wkb, edges))
    words = ("--set", f"breaklines.file={tmp_path / 'edges.gpkg'}", "--out", tmp_path / "r")
    ended = fwclass("run", survey, *WORDS, *words)
    assert ended.returncode == 0, ended.stderr
    said = f"breaklines lie more than 1 m {side} the ground echoes beside them at "
    assert (said in ended.stderr) == bool(side) and ("of one kind" in ended.stderr) == bool(side)


def test_lines_away_from_the_survey_are_counted(survey: Path, tmp_path: Path) -> None:
    far = [
        [(a, b + 1e5, c) for a, b, c in FOOT],
        [(X - 9000.0, Y + 10_000.0, 200.0), (X + 10_000.0, Y + 9000.0, 200.0)],
    ]
    over = [(X - 1e5, Y + 20.0, 200.0), (X + 1e5, Y + 20.0, 200.0)]  # none of its points lies there
    gpkg(tmp_path / "more.gpkg", "LineString Z", wkb(FOOT), *map(wkb, far), wkb(over))
    words = ("--set", f"breaklines.file={tmp_path / 'more.gpkg'}", "--out", tmp_path / "r")
    ended = fwclass("run", survey, *WORDS, *words)
    assert ended.returncode == 0 and "2 of 4 breaklines lie away from the survey" in ended.stderr, ended.stderr


def test_a_wall_is_no_fault_of_heights_and_its_cells_are_no_measured_ones(survey: Path, tmp_path: Path) -> None:
    words = ("--set", "breaklines.file=wall.gpkg", "--out", tmp_path / "r")
    assert "of one kind" not in fwclass("run", survey, *WORDS, *words).stderr
    with rasterio.open(tmp_path / "r/rasters/dtm_mask.tif") as file:
        mask, west, cell = file.read(1), file.transform.c, file.transform.a
    columns = sorted({int((points[0][0] - west) // cell) for points in (FOOT, CREST)})
    assert (mask[:, columns] == 5).all() and (mask == 5).sum() == mask[:, columns].size


@pytest.mark.slow
def test_the_terrain_passes_through_breaklines_whatever_the_tiles(survey: Path) -> None:
    made = {}
    for name, words in (
        ("plain", ()),
        ("wall", ("breaklines.file=wall.gpkg",)),
        ("other", ("breaklines.file=wall.gpkg", "tile.size=30")),
    ):
        settings = [w for one in words for w in ("--set", one)]
        told = fwclass("run", survey, "--out", survey.parent / name, *WORDS, *settings)
        assert told.returncode == 0, told.stderr
        made[name] = dtm(survey.parent / name)[2:38]
    wall, plain = made["wall"], made["plain"]
    assert np.abs(wall[:, 37:40] - 200.0).max() < 0.01 and np.abs(wall[:, 41:44] - 203.0).max() < 0.01
    assert np.abs(plain[:, 38] - 200.0).min() > 0.3  # without them a ramp
    assert (wall[:, :35] == plain[:, :35]).all()
    assert (survey.parent / "other/rasters/dtm.tif").read_bytes() == (
        survey.parent / "wall/rasters/dtm.tif"
    ).read_bytes()


@pytest.mark.parametrize(
    ("name", "words"), [("flat", "a line without heights"), ("far", "no breakline lies in the survey")]
)
def test_lines_that_tell_no_terrain_are_refused(survey: Path, name: str, words: str, tmp_path: Path) -> None:
    told = fwclass("run", survey, "--out", tmp_path / "r", *WORDS, "--set", f"breaklines.file={name}.gpkg")
    assert told.returncode in (1, 2) and words in told.stderr and "Traceback" not in told.stderr
    assert not (tmp_path / "r" / "store").exists()


def test_heights_are_told_from_measures_in_every_dialect() -> None:
    several = struct.pack("<BII", 1, 1005, 2) + wkb(FOOT) + wkb(CREST)
    with_both = struct.pack("<BII", 1, 3002, 2) + np.array([(*p, 7.0) for p in FOOT], "<f8").tobytes()
    shapes, z = lines([wkb(FOOT), None, several, wkb(FOOT, 0x80000002), with_both], "here")
    assert shapes.feature.tolist() == [0, 2, 2, 3, 4] and shapes.empty == 1
    assert z.tolist() == [200.0] * 2 + [200.0] * 2 + [203.0] * 2 + [200.0] * 4
    bad = [wkb(FOOT, 2002), wkb(FOOT, 1003), wkb(FOOT)[:-1], wkb(FOOT) + b"0", wkb(FOOT[:1]), b"", b"\x01\x02"]
    bad += [
        wkb([(0.0, 0.0, np.nan)] * 2),
        wkb([(0.0, 0.0, 1e300)] * 2),
        wkb([(0.0, 0.0, 200.0), (1.0, 0.0, -9999.0)]),
        struct.pack("<BII", 1, 1005, 1) + wkb([p[:2] for p in FOOT], 2),
    ]
    bad += [struct.pack("<BII", 1, 1005, 1) + wkb(FOOT, 2002), struct.pack("<BII", 1, 1005, 3) + wkb(FOOT)]
    for data in bad:
        with pytest.raises(InputError, match="breaklines"):
            lines([data], "here")


def test_a_line_without_end_costs_no_memory(survey: Path, tmp_path: Path) -> None:
    told = fwclass("run", survey, "--out", tmp_path / "r", *WORDS, "--set", "breaklines.file=endless.gpkg")
    assert told.returncode == 2 and "lines are too long" in told.stderr and "endless.gpkg" in told.stderr
    assert not (tmp_path / "r" / "store").exists()


def test_lines_are_refused_before_a_run_where_its_part_would_refuse_them(
    survey: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And no others: what lies around the survey counts, as far as blocks of the terrain read."""
    words = ("run", survey, *WORDS, "--set", "breaklines.file=wall.gpkg", "--out")
    assert fwclass(*words, tmp_path / "r").returncode == 0
    knots = Store(tmp_path / "r", read_only=True).receipt("breaklines", "all").meta["knots"]
    for most, code in ((knots, 0), (knots // 2, 2)):
        monkeypatch.setattr(along, "MOST", most)
        told = fwclass(*words, tmp_path / f"most-{most}")
        assert told.returncode == code and ("lines are too long" in told.stderr) == (code == 2), told.stderr
