"""`fwclass diff`: what changed between two deliveries, held against what the strips themselves say."""

from __future__ import annotations

import json
import shutil
import sqlite3
from types import SimpleNamespace

import laspy
import numpy as np
import pytest
import rasterio
from commandline import fwclass
from smallsurvey import small_survey

from fwclass.delivery.viewed_colours import compare_classes
from fwclass.graph.assess import BLOCKS
from fwclass.operate.assess_runs import counts_in
from fwclass.operate.difference.deliveries import _echo_lines, _height_lines, describe
from fwclass.operate.difference.rasters import raster_changes
from fwclass.report.write import _keep_counts
from fwclass.store.arrays import arrays_at, write_arrays

OTHER = "survey.features=[amplitude]"


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """`r`: two generations, the second by a feature that tells nothing; `s`: its settings in other tiles."""
    place = tmp_path_factory.mktemp("diff")
    with small_survey(place).open("a") as file:
        file.write("plausibility: {accept: true}\n")  # that feature agrees by chance
    for out, more in (("r", ()), ("r", ("--set", OTHER)), ("s", ("--set", "tile.size=40"))):
        ended = fwclass("run", "s.yaml", "--out", out, "--workers", 0, *more, cwd=place)
        assert ended.returncode == 0, ended.stderr
    return place


def test_a_survey_of_very_many_blocks_delivers_its_counts_too(tmp_path, monkeypatch):
    """They lie as a directory then, and were left out: a difference had no intervals."""
    counts = {"place": np.arange(6).reshape(3, 2), "blocks": np.arange(18).reshape(3, 2, 3) * 20}
    monkeypatch.setattr("fwclass.store.arrays.SMALL", 0)
    write_arrays(tmp_path / "counts", counts)
    store = SimpleNamespace(arrays_path=lambda *of: arrays_at(tmp_path / "counts"))
    _keep_counts({"accuracy": {}}, SimpleNamespace(store=store, pending=tmp_path))
    kept = counts_in(tmp_path / BLOCKS)
    assert (kept.place == counts["place"]).all() and (kept.counts == counts["blocks"]).all()
    assert kept.counts.dtype == np.int64


def test_why_there_are_no_intervals_names_the_delivery(runs, tmp_path):
    shutil.copytree(runs / "r", tmp_path / "r", symlinks=True)
    (tmp_path / "r" / "generations" / "0001" / BLOCKS).unlink()
    shown = fwclass("diff", "r", cwd=tmp_path).stdout
    assert "no intervals: r 0001 keeps no counts by block" in shown, shown


def classes_of(place, name):
    return np.asarray(laspy.read(place / name / "laz" / "strips" / "a.laz").classification)


def test_points_in_another_order_are_told_and_not_compared(tmp_path):
    """They have other pulses' names: half of them were told to be of another class, and no word."""
    small_survey(tmp_path)
    for out in ("r", "q"):
        assert fwclass("run", "s.yaml", "--out", out, "--workers", 0, cwd=tmp_path).returncode == 0
        points = laspy.read(tmp_path / "a.las")
        points.points = points.points[np.random.default_rng(1).permutation(len(points.points))]
        points.write(tmp_path / "a.las")
    ended = fwclass("diff", "r", "q", "--json", cwd=tmp_path)
    echoes = json.loads(ended.stdout)["echoes"]
    assert echoes["apart"] > 3000 and echoes["common"] < 100, echoes
    assert "lie more than 1 m apart, and are not compared" in fwclass("diff", "r", "q", cwd=tmp_path).stdout
    assert compare_classes(*tiles(tmp_path / "r"), [*tiles(tmp_path / "q")]).sum() < 50


def tiles(run):
    return sorted((run / "parquet").glob("*.parquet"))[:1]


def test_two_generations(runs):
    ended = fwclass("diff", "r", "--json", "--gpkg", "d.gpkg", cwd=runs)
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout)
    before, after = (classes_of(runs, f"r/generations/{n}") for n in ("0001", "0002"))
    echoes = found["echoes"]
    assert (echoes["common"], echoes["changed"]) == (6000, int((before != after).sum())) and echoes["changed"] > 500
    codes = echoes["codes"]
    matrix = [[int(((before == a) & (after == b)).sum()) for b in codes] for a in codes]
    assert echoes["matrix"] == matrix and echoes["only_first"] == echoes["only_second"] == 0
    assert found["settings"] == {"survey.features": [["zc", "height_range_c100"], ["amplitude"]]}
    assert found["files"] == {"added": [], "removed": [], "changed": []} and found["libraries"] == {}
    assert found["accuracy"]["kappa"][0] > found["accuracy"]["kappa"][1] and found["accuracy"]["why"] is None
    assert found["accuracy"]["paired"]["kappa"]["difference"] < 0, "two generations of one run had no intervals"
    assert found["accuracy"]["tested"][0] == found["accuracy"]["tested"][1] > 0 and "not the same ones" not in describe(
        found
    )
    found["accuracy"]["paired"]["kappa"]["interval"] = [-0.02, 0.01]
    assert "LOST        overall accuracy, mean IoU\n" in describe(found), "what chance explains was lost, too"
    assert "by chance   kappa: lower, and their intervals hold 0" in describe(found)
    found["accuracy"]["tested"][1] -= 40
    words = describe(found)
    assert "tested echoes, not the same ones" in words and "LOST" not in words, "of other echoes, too"
    assert "lower       overall accuracy, mean IoU: other echoes were tested" in words
    assert found["labels"] == {}
    assert found["quality"] == {}, "of the same echoes"
    found["quality"] = {"density.area": [14_700.0, 15_000.0], "check_points.all.rmse": [0.0512, None]}
    found["labels"] = {"corrections": [0, 1200], "labelled": [None, 6000]}
    found["accuracy"]["kappa"][1] = None
    words = describe(found)
    assert "corrections: 0 -> 1,200 echoes" in words and "labelled: none -> 6,000 echoes" in words
    assert f"{found['accuracy']['kappa'][0]:.4f} -> unknown" in words, "it was left out without a word"
    found["accuracy"]["tested"][1] = 0
    assert "and 0 tested echoes, not the same ones (areas, labels and corrections" in describe(found), "nor why"
    assert "quality     m² with echoes: 14,700 -> 15,000\n" in words
    assert "quality     m RMSEz at check points: 0.0512 -> unknown\n" in words
    with sqlite3.connect(runs / "d.gpkg") as layers:
        inside = layers.execute("select sum(changed) from places").fetchone()[0]
    assert 0.5 * echoes["changed"] < inside <= echoes["changed"]


def test_the_history_has_the_accuracy(runs):
    shown = fwclass("history", "r", cwd=runs).stdout.splitlines()
    report = json.loads((runs / "r" / "report.json").read_text())
    assert f"{100 * report['accuracy']['overall_accuracy']:.1f} %" in shown[2] and "6,000" in shown[2]


def test_a_run_that_is_worse_than_the_one_before_says_so(runs):
    said = []
    for more in ((), ("--set", OTHER), ("--set", OTHER, "--set", "train.trees=4")):
        ended = fwclass("run", "s.yaml", "--out", "u", "--workers", 0, *more, cwd=runs)
        assert ended.returncode == 0, ended.stderr
        said.append("points of overall accuracy against the run of" in ended.stderr)
    assert said == [False, True, False]


def test_the_words_say_what_was_lost(runs):
    ended = fwclass("diff", "r", "1", "2", cwd=runs)
    assert "survey.features: ['zc', 'height_range_c100'] -> ['amplitude']" in ended.stdout
    assert "LOST        overall accuracy, kappa, mean IoU" in ended.stdout and "from bush to ground" in ended.stdout


@pytest.mark.slow
def test_other_tiles_change_no_class(runs):
    found = json.loads(fwclass("diff", "r", "s", "--json", cwd=runs).stdout)
    assert found["echoes"]["common"] == 6000 and found["echoes"]["only_second"] == 0
    fwclass("run", "s.yaml", "--out", "t", "--workers", 0, "--set", "tile.size=15", cwd=runs)
    found = json.loads(fwclass("diff", "s", "t", "--json", cwd=runs).stdout)
    assert (found["echoes"]["common"], found["echoes"]["changed"]) == (6000, 0)
    assert found["settings"] == {"tile.size": [40.0, 15.0]}
    assert found["accuracy"]["paired"]["kappa"]["difference"] == 0


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("s",), "delivered once only"),
        (("r", "7"), "no such delivery"),
        (("nothing",), "nothing was delivered there"),
        (("r", "1", "2", "3"), "two deliveries"),
        (("r", "1", "s"), "two deliveries"),
    ],
)
def test_what_cannot_be_compared(runs, words, says):
    ended = fwclass("diff", *words, cwd=runs)
    assert ended.returncode == 2 and says in ended.stderr


def test_a_report_that_was_changed_is_refused_in_words(runs):
    report = runs / "s" / "generations" / "0001" / "report.json"
    before = report.read_bytes()
    report.unlink()
    report.write_text(json.dumps({**json.loads(before), "config": None}))
    ended = fwclass("diff", "r", "s", cwd=runs)
    report.write_bytes(before)
    assert ended.returncode == 1 and "the delivery is damaged" in ended.stderr and "Traceback" not in ended.stderr


def test_deliveries_without_a_common_echo_are_told() -> None:
    """As where the later one is of the survey's quality alone, and has no tiles."""
    nothing = {"common": 0, "only_first": 6000, "only_second": 0, "apart": 0, "changed": 0, "classes": [], "matrix": []}
    assert list(_echo_lines(nothing))[1].split() == ["6,000", "in", "the", "first", "alone"]


def test_a_diff_of_quality_runs_tells_the_quality(tmp_path):
    small_survey(tmp_path)
    for pulses in (6000, 3000):
        points = laspy.read(tmp_path / "a.las")
        points.points = points.points[:pulses]
        points.write(tmp_path / "a.las")
        ended = fwclass("run", "s.yaml", "--out", "r", "--workflow", "quality", "--workers", 0, cwd=tmp_path)
        assert ended.returncode == 0, ended.stderr
    quality = [json.loads((tmp_path / f"r/generations/{n}/quality.json").read_text()) for n in ("0001", "0002")]
    told = fwclass("diff", "r", cwd=tmp_path).stdout
    before, after = (one["density"]["pulses"] for one in quality)
    assert before > after and f"quality     pulses per m²: {before:.4g} -> {after:.4g}\n" in told
    assert "echoes  " not in told, "none are delivered"


def test_a_tile_that_is_damaged_is_not_compared(runs, tmp_path):
    """One bit of one value, which Parquet cannot tell."""
    shutil.copytree(runs / "s", tmp_path / "s", symlinks=True)
    tile = min((tmp_path / "s" / "current").resolve().glob("parquet/*.parquet"))
    data = bytearray(tile.read_bytes())
    data[len(data) // 3] ^= 1
    tile.chmod(0o644)
    tile.write_bytes(data)
    ended = fwclass("diff", "s", "s", cwd=tmp_path)
    assert ended.returncode == 1 and tile.name in ended.stderr and "the delivery is damaged" in ended.stderr


def raised(path, by, rows):
    """Lift the first `rows` of a raster by so much, in the file."""
    with rasterio.open(path) as file:
        values, profile = file.read(1), file.profile
    values[:rows] += np.float32(by)
    path.unlink()  # a link to the store's
    with rasterio.open(path, "w", **{**profile, "driver": "GTiff"}) as file:
        file.write(values, 1)
    return values


def test_heights_that_changed_are_told(runs, tmp_path):
    for name in "ab":
        shutil.copytree(runs / "r" / "generations" / "0001" / "rasters", tmp_path / name)
    assert all(one["changed"] == 0 and one["mean"] == 0.0 for one in raster_changes(tmp_path / "a", tmp_path / "b"))
    dtm = raised(tmp_path / "b" / "dtm.tif", 40.0, 3)
    told = {one["name"]: one for one in raster_changes(tmp_path / "a", tmp_path / "b")}
    lifted = int(np.isfinite(dtm[:3]).sum())
    assert told["dsm.tif"]["changed"] == 0 and told["dtm.tif"]["changed"] == lifted > 0
    assert told["dtm.tif"]["highest"] == pytest.approx(40, abs=1e-4) and told["dtm.tif"]["lowest"] == 0.0
    cells = told["dtm.tif"]["cells"]
    assert told["dtm.tif"]["mean"] == pytest.approx(40 * lifted / cells) and cells == np.isfinite(dtm).sum()
    assert "off by over 1 cm" in next(_height_lines([told["dtm.tif"]]))


def test_rasters_of_other_extents_and_cells(tmp_path):
    rng = np.random.default_rng(1)
    whole = rng.normal(100, 1, (1200, 40)).astype(np.float32)
    whole[rng.random(whole.shape) < 0.1] = np.nan
    pieces = {"a": (0, 0, 1100, 30, 2.0), "b": (50, 5, 1150, 35, 2.0), "c": (0, 0, 9, 9, 1.0)}
    for name, (row, column, rows, columns, cell) in pieces.items():
        (tmp_path / name).mkdir()
        at = rasterio.Affine(cell, 0, 500_000 + column * cell, 0, -cell, 5_400_000 - row * cell)
        shape = {"width": columns, "height": rows, "count": 1, "dtype": "float32", "nodata": np.nan, "transform": at}
        with rasterio.open(tmp_path / name / "dtm.tif", "w", driver="GTiff", **shape) as file:
            file.write(whole[row : row + rows, column : column + columns], 1)
    (one,) = raster_changes(tmp_path / "a", tmp_path / "b")
    there = np.isfinite(whole)
    assert one["cells"] == there[50:1100, 5:30].sum() and one["changed"] == 0 and one["rmse"] == 0.0
    assert one["only_first"] == there[:1100, :30].sum() - one["cells"]
    assert one["only_second"] == there[50:, 5:].sum() - one["cells"]
    assert "do not lie on each other" in raster_changes(tmp_path / "a", tmp_path / "c")[0]["why"]


def test_a_diff_of_ground_runs_tells_the_terrain(runs):
    words = ("--workflow", "ground", "--workers", 0)
    for out, more in (("g", ()), ("h", ("--set", "ground.max_building_size=3"))):
        assert fwclass("run", "s.yaml", "--out", out, *words, *more, cwd=runs).returncode == 0
    again = fwclass("run", "s.yaml", "--out", "g", "--workers", 0, "--workflow", "quality", cwd=runs)
    assert "showed what the workflow ground delivered, and shows what quality does now" in again.stderr
    assert "the earlier delivery is its generations/0001" in again.stderr
    assert fwclass("run", "s.yaml", "--out", "g", *words, cwd=runs).returncode == 0
    shown = fwclass("diff", "g", "h", cwd=runs).stdout
    assert "dtm         " in shown and "dsm         " in shown and "no intervals" not in shown, shown


def test_a_tile_that_was_not_delivered_is_not_compared(runs, tmp_path):
    shutil.copytree(runs / "s", tmp_path / "s", symlinks=True)
    tables = (tmp_path / "s" / "current" / "parquet").resolve()
    tables.chmod(0o755)
    shutil.copy(min(tables.iterdir()), tables / "mine.parquet")
    ended = fwclass("diff", "s", "s", cwd=tmp_path)
    assert ended.returncode == 1 and "mine.parquet" in ended.stderr and "the delivery is damaged" in ended.stderr


@pytest.mark.parametrize("below", ["parquet/*.parquet", "rasters/classes.tif"])
def test_a_file_of_another_size_is_not_read(runs, tmp_path, below):
    """A raster of a terabyte that takes no room on the disk was read to its end, for hours."""
    shutil.copytree(runs / "s", tmp_path / "s", symlinks=True)
    file = min((tmp_path / "s" / "current").resolve().glob(below))
    file.chmod(0o644)
    with file.open("r+b") as stream:
        stream.truncate(1 << 40)
    ended = fwclass("diff", "s", "s", cwd=tmp_path)
    assert ended.returncode == 1 and file.name in ended.stderr and "the delivery is damaged" in ended.stderr
