"""Surveys in places far apart, and with a point that strayed: work and memory follow what is there, not its extent."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio
from commandline import fwclass

from fwclass import conf
from fwclass.errors import InputError
from fwclass.graph.sites import in_sites, sites
from fwclass.grid import Box, Tile, TileGrid, Window, groups
from fwclass.operate.estimate.forecast import make_forecast
from fwclass.operate.estimate.headers import survey_facts
from fwclass.operate.estimate.limits import Room
from fwclass.operate.estimate.text import describe
from fwclass.run.local import Loop
from fwclass.run.progress import Display
from fwclass.run.runner import Runner
from fwclass.store.run_location import lock_run
from fwclass.walk import steps as of_walk
from fwclass.workflows import WORKFLOWS, workflow_of

begin = workflow_of("classification").begin

SETTINGS = (
    "train.trees=2",
    "train.samples_per_class=100",
    "publish.figure_pixels=200",
    "ground.block=64",
    "terrain.block=64",
    "ground.block_halo=16",
)
SURVEY = """
survey:
  name: far
  directory: .
  sources: ["*.las"]
  crs: EPSG:25832
  reference: {kind: source}
  features: [height_above_ground]
  classes: [{name: ground, code: 2, codes: [2]}, {name: building, code: 6, codes: [6]}]
areas:
  train: [[500000, 5400000, 500034, 5400040]]
  gap: 0
"""


def cluster(x0: float, y0: float, n: int = 600, size: float = 40.0):
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0, size, (2, n))
    house = (x > 25) & (y > 20)
    return x + x0, y + y0, 100 + 0.02 * x + np.where(house, 6.0, 0.0), np.where(house, 6, 2)


def write(path: Path, *clouds) -> None:
    x, y, z, codes = (np.concatenate(v) for v in zip(*clouds, strict=True))
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = [0.001] * 3, [500_000.0, 5_400_000.0, 0.0]
    las = laspy.LasData(header)
    las.x, las.y, las.z, las.classification = x, y, z, codes.astype(np.uint8)
    las.return_number = las.number_of_returns = np.ones(len(x), np.uint8)
    las.write(path)


STRAY = tuple(np.array([v]) for v in (1_000_000.0, 5_900_000.0, 100.0, 2))


@pytest.fixture(scope="module")
def far(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of one place, and one with a point 700 km away."""
    root = tmp_path_factory.mktemp("far")
    write(root / "a.las", cluster(500_000.0, 5_400_000.0))
    write(root / "b.las", cluster(500_030.0, 5_400_030.0), STRAY)
    (root / "S.yaml").write_text(SURVEY)
    return root


def walked(survey: Path, root: Path, *settings: str):
    config = conf.load(survey / "S.yaml", (*SETTINGS, *settings))
    with Display() as display, lock_run(root, display.say) as (own, held):
        runner = Runner(own, Loop(), display, held=held)
        report = WORKFLOWS["classification"](config, runner, None)
        made = runner.publish(config.run.keep_generations)
        return runner, report, made


def test_a_stray_point_leaves_the_delivery_whole_and_is_named(far, tmp_path, capsys):
    """Finding A8: 1.8 GB, exit 3, never whole."""
    runner, report, made = walked(far, tmp_path / "run")
    assert not runner.failures, runner.failures
    assert made.whole
    said = capsys.readouterr().err
    assert "2 places far apart" in said
    assert "x 1000000.00 to 1000000.00, y 5900000.00 to 5900000.00, echoes of b.las" in said
    rasters = sorted((tmp_path / "run" / "rasters").resolve().rglob("*.tif"))
    assert {p.parent.name for p in rasters} == {"5000_54000", "10000_59000"}
    cells = 0
    for path in rasters:
        with rasterio.open(path) as raster:
            cells += raster.width * raster.height
    assert cells < 5 * 2 * 200**2
    with rasterio.open(next(p for p in rasters if p.parent.name == "5000_54000" and p.stem == "dtm")) as raster:
        assert np.isfinite(raster.read(1)).sum() > 1000
    assert report["ground"]["seams"]["echoes"] == 1201
    assert report["ground"]["seams"]["left_out"] == 0


@pytest.mark.parametrize(
    ("size", "expected"), [(100, ["5000_54000", "5005_54000", "10000_59000"]), (1000, ["500_5400", "1000_5900"])]
)
def test_places_that_share_a_tile_are_one(tmp_path, size, expected):
    """Blocks of 64 m keep the two nearer ones apart; a tile of 1000 m holds both."""
    clouds = cluster(500_000.0, 5_400_000.0, 60), cluster(500_500.0, 5_400_000.0, 60), STRAY
    write(tmp_path / "a.las", *clouds)
    (tmp_path / "S.yaml").write_text(SURVEY)
    config = conf.load(tmp_path / "S.yaml", (*SETTINGS, f"tile.size={size}"))
    with Display() as display, lock_run(tmp_path / "run", display.say) as (own, held):
        runner = Runner(own, Loop(), display, held=held)
        layout = of_walk.until_tiles(of_walk.plan_with_features(config), runner).layout
    several = sites(layout)
    assert [site.name for site in several] == expected
    assert sorted(t.key for site in several for t in site.tiles) == sorted(t.key for t in layout.tiles)


def test_a_plan_counts_the_places_that_a_run_makes(far, tmp_path):
    config = conf.load(far / "S.yaml", SETTINGS)
    plan = make_forecast(begin(config), survey_facts(config, tmp_path), 0, Room(16_000.0, 1e12))
    stages = {s.name: s.amount for s in plan.estimate.stages}
    assert plan.tiles.number == 2
    assert stages["publish-rasters"].parts == 2
    assert stages["publish-rasters"].units < 10_000
    assert plan.fits
    assert "b.las: its points lie in 2 places, 1 of them at x 1000000.00" in describe(plan)


@pytest.mark.parametrize("stage", ["seams", "confusion"])
def test_a_failed_check_leaves_the_delivery_whole(stage, far, tmp_path, monkeypatch):
    def broken(*_):
        raise InputError("this check cannot be made", where=stage)

    if stage == "seams":
        monkeypatch.setattr("fwclass.graph.ground_seams._Differences", broken)
    else:
        monkeypatch.setattr("fwclass.graph.assess.confusion", broken)
    runner, _, made = walked(far, tmp_path / "run", "survey.sources=[a.las]")
    assert {o.stage for o in runner.failures} == {stage}
    assert made.whole
    assert (tmp_path / "run" / "current").readlink().name == made.name


def test_a_failed_part_of_the_delivery_is_not_whole(far, tmp_path, monkeypatch):
    def broken(*_):
        raise InputError("no")

    monkeypatch.setattr("fwclass.graph.raster_outputs._terrain_rasters", broken)
    runner, _, made = walked(far, tmp_path / "run", "survey.sources=[a.las]")
    assert runner.failures
    assert not made.whole


def test_tiles_that_touch_are_one_group():
    grid = TileGrid(10.0)
    keys = ("0_0", "1_1", "5_5", "5_6", "-3_0")
    found = groups(grid.tile(k) for k in keys)
    assert [[t.key for t in part] for part in found] == [["-3_0"], ["0_0", "1_1"], ["5_5", "5_6"]]
    assert groups(()) == ()
    assert Window.covering(Tile(5, 5, 10.0).box, 1.0).shape == (10, 10)


@pytest.mark.slow
def test_a_file_without_waveforms_costs_few_parts_and_files(far, tmp_path):
    """Finding on 2 000 files of 60 points: what is not there was written, flushed and read again for each of them."""
    runner, _, _ = walked(far, tmp_path / "run", "survey.sources=[a.las]")
    assert not {"pulse", "read"} & set(runner.tallies)
    store = tmp_path / "run" / "store"
    kept = {p.name for p in (store / "decompose").rglob("*") if p.is_file()}
    assert kept == {"table.parquet", "links.parquet", "receipt.json"}
    one = {p.name for p in (store / "params").iterdir()}
    both, _, _ = walked(far, tmp_path / "both", "survey.sources=[a.las, b.las]")
    assert both.tallies["decompose"].parts == 2
    more = len(list((tmp_path / "both" / "store" / "params").iterdir())) - len(one)
    assert more <= 9  # boxes, spans, and the edges that cut a block; not by file


def test_tiles_that_hold_hardly_anything_are_told(far, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(of_walk, "MANY", 2)
    walked(far, tmp_path / "run", "survey.sources=[a.las]", "tile.size=20")
    assert "tiles of 20 m hold" in capsys.readouterr().err


def test_the_directory_of_the_sources_is_no_run_directory(far):
    before = sorted(p.name for p in far.iterdir())
    done = fwclass("run", far / "S.yaml", "--out", far, "--workers", "0")
    assert done.returncode == 2
    assert "directory of the sources" in done.stderr
    assert sorted(p.name for p in far.iterdir()) == before


def test_a_point_that_strayed_along_a_line_makes_no_thin_raster_of_a_thousand_tiles():
    """Of a file 10 m wide and 1 000 km long few cells are missing, but a raster's tiles are 512 cells high."""
    thin = Box(500_000.0, 5_400_000.0, 1_500_000.0, 5_400_010.0)
    assert in_sites(thin, 0.5, 2 * 512.0**2, 512)
    full = Box(500_000.0, 5_400_000.0, 1_500_000.0, 5_400_512.0)
    assert not in_sites(full, 1.0, full.area / 2, 512)
    assert not in_sites(Box(0.0, 0.0, 10.0, 10.0), 0.5, 400.0, 512)
    assert in_sites(Box(-1e300, 0.0, 1e300, 1e300), 0.5, 400.0, 512)  # as a damaged header has it
