"""Rasters of the whole survey: blocks laid together stripe by stripe, without holding them all."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import rasterio

from fwclass import conf
from fwclass.graph.raster_outputs import deliver_rasters
from fwclass.graph.rasters import Mosaic, stripes, write_rasters
from fwclass.graph.stage_work import StageInputs
from fwclass.grid import Box, Tile, TileGrid, Window
from fwclass.publish.figures import class_map
from fwclass.publish.shade import hillshade, slope
from fwclass.report import figures as report
from fwclass.run.inputs import PartInputs
from fwclass.store.run_store import Store

SIZE = 32.0
BOX = Box(512_010.0, 5_403_005.0, 512_150.0, 5_403_190.0)
NAMES = {2: "ground", 6: "building"}


class Counted(PartInputs):
    """Inputs that count how often each part is read."""

    def arrays(self, stage: str, part: str, name: str, only=None):
        self.read[stage, part] = self.read.get((stage, part), 0) + 1
        return super().arrays(stage, part, name, only)

    @property
    def read(self) -> dict:
        return self.__dict__.setdefault("_read", {})


def block_rasters(block: Tile, cell: float) -> tuple[dict[str, np.ndarray], Window]:
    window = Window.covering(block.box, cell)
    rng = np.random.default_rng((block.ix, block.iy))
    dtm = np.where(rng.random(window.shape) < 0.1, np.nan, rng.normal(100, 3, window.shape)).astype(np.float32)
    dsm = dtm + rng.random(window.shape, np.float32)
    classes = rng.choice(np.array([0, 2, 6], np.uint8), window.shape)
    confidence = np.where(classes > 0, rng.integers(0, 101, window.shape), 255).astype(np.uint8)
    echoes = np.where(classes > 0, rng.integers(1, 9, window.shape), 0).astype(np.uint32)
    distance = np.where(np.isnan(dtm), np.nan, rng.random(window.shape)).astype(np.float32)
    mask = np.where(np.isnan(dtm), 0, rng.integers(1, 4, window.shape)).astype(np.uint8)
    roughness = np.where(np.isnan(dtm), np.nan, rng.random(window.shape)).astype(np.float32)
    terrain = {"dtm": dtm, "dsm": dsm, "distance": distance, "mask": mask, "roughness": roughness}
    return {**terrain, "classes": classes, "confidence": confidence, "echoes": echoes}, window


def written(arrays: dict[str, np.ndarray], window: Window, directory: Path) -> dict:
    write_rasters(directory, arrays, window)
    return {"without_terrain": 0, "pieces": []}


@pytest.fixture(params=[1.0, 3.0])
def laid(request, tmp_path: Path):
    """(inputs, blocks, cell): blocks with a gap of two rows of them; of 3 m cells neighbours share some."""
    cell, store = request.param, Store(tmp_path / "run")
    blocks = tuple(b for b in TileGrid(SIZE).touching(BOX) if b.iy % 5 not in (2, 3))
    for block in blocks:
        arrays, window = block_rasters(block, cell)
        terrain = ("dtm", "dsm", "distance", "mask", "roughness")
        for stage, names in (("terrain", terrain), ("class-block", ("classes", "confidence", "echoes"))):
            work = partial(written, {n: arrays[n] for n in names}, window)
            store.commit(stage, block.key, "k", {}, "store", work)
    return Counted(store), blocks, cell


def expected(blocks: tuple[Tile, ...], cell: float, window: Window) -> dict[str, np.ndarray]:
    """Cell by cell: what the last block that has it says."""
    out = {n: np.full(window.shape, np.nan, np.float32) for n in ("dtm", "dsm", "distance", "roughness")}
    out["mask"] = np.zeros(window.shape, np.uint8)
    out["classes"] = np.zeros(window.shape, np.uint8)
    out["confidence"] = np.full(window.shape, 255, np.uint8)
    out["echoes"] = np.zeros(window.shape, np.uint32)
    for block in blocks:
        arrays, own = block_rasters(block, cell)
        for r in range(own.nrows):
            for c in range(own.ncols):
                row, column = own.row + r - window.row, own.col + c - window.col
                if 0 <= row < window.nrows and 0 <= column < window.ncols:
                    for name, raster in out.items():
                        raster[row, column] = arrays[name][r, c]
    return out


@pytest.mark.parametrize("rows", [1, 7, 64, 1000])
def test_stripes_of_any_width_make_the_whole_and_read_each_block_once(laid, rows: int) -> None:
    inputs, blocks, cell = laid
    window, empty = Window.covering(BOX, cell), {"dtm": np.float32(np.nan), "dsm": np.float32(np.nan)}
    whole = expected(blocks, cell, window)
    mosaic, found = Mosaic(inputs, "terrain", blocks, cell, empty), []
    for stripe in stripes(window, rows):
        found.append(mosaic.laid(stripe))
        there = np.isfinite(found[-1]["dtm"]).any()
        assert mosaic.touches(stripe) or not there
    assert set(inputs.read.values()) == {1} and len(inputs.read) == len(blocks)
    for name in empty:
        assert np.array_equal(np.concatenate([f[name] for f in found[::-1]]), whole[name], equal_nan=True)


@pytest.mark.parametrize("step", [1, 2, 7, 500])
def test_a_thinned_mosaic_is_every_so_manyth_cell(laid, step: int) -> None:
    inputs, blocks, cell = laid
    window = Window.covering(BOX, cell)
    empty = {"dtm": np.float32(np.nan), "dsm": np.float32(np.nan)}
    whole = expected(blocks, cell, window)
    for name, raster in Mosaic(inputs, "terrain", blocks, cell, empty).thinned(window, step).items():
        assert np.array_equal(raster, whole[name][::step, ::step], equal_nan=True)


def test_a_map_of_a_large_survey_is_drawn_from_the_cells_that_it_shows(laid, monkeypatch) -> None:
    inputs, blocks, cell = laid
    config = conf.load("demo", ())
    config = replace(config, publish=config.publish.model_copy(update={"figure_pixels": 20}))
    window = Window.covering(BOX, cell)
    classes = expected(blocks, cell, window)["classes"]
    drawn, report_cells = {}, report.MAP_CELLS
    for limit in (report_cells, 100):
        monkeypatch.setattr(report, "MAP_CELLS", limit)
        mosaic = Mosaic(inputs, "class-block", blocks, cell, {"classes": np.uint8(0)})
        drawn[limit] = report.drawable(mosaic, window, config)
    assert np.array_equal(drawn[report_cells][0], classes)
    few = drawn[100][0]
    assert max(few.shape) <= 20 and drawn[100][1].shape == few.shape
    pictures = {class_map(*one, [{"name": "ground", "code": 2}], config.publish) for one in drawn.values()}
    assert len(pictures) == 1  # the same cells are shown at the same places


def test_the_delivered_rasters_are_those_of_one_array(laid, tmp_path: Path) -> None:
    """Light and slope on an edge ask for the cells beyond it; a stripe without any block has no data."""
    inputs, blocks, cell = laid
    params = conf.load("demo", ()).publish.model_copy(update={"class_cell": cell})
    window = Window.covering(BOX, cell)
    whole = expected(blocks, cell, window)
    here = StageInputs(inputs, tmp_path, "all", tuple(("terrain", b.key) for b in blocks))
    names = {str(code): name for code, name in NAMES.items()}
    told = deliver_rasters(here, params, "EPSG:25832", names, cell, SIZE, BOX.bounds)
    there = np.isfinite(whole["dtm"])
    ranges = told.pop("ranges")
    assert told["dtm_cells"] == there.sum() and told["covered"][0]["count"] == (whole["classes"] > 0).sum()
    for name in ("dtm", "dsm"):
        low, high = ranges[name]
        assert np.nanmin(whole[name]) - 0.01 <= low < high <= np.nanmax(whole[name]) + 0.01
    many = whole.pop("echoes")
    whole["density"] = np.where(many > 0, many / cell**2, np.nan).astype(np.float32)
    whole["dtm_distance"], whole["dtm_mask"] = whole.pop("distance"), whole.pop("mask")
    beyond = expected(blocks, cell, window.grown(1))["dtm"]
    light = hillshade(beyond, cell, params)[1:-1, 1:-1]
    tone = np.where(there, 1 + 254 * light, 0).astype(np.uint8)
    wanted = {**whole, "ndsm": whole["dsm"] - whole["dtm"], "hillshade": tone, "slope": slope(beyond, cell)}
    for name, step in {"dtm": 2**-10, "ndsm": 2**-10, "roughness": 2**-10, "slope": 2**-7}.items():
        wanted[name] = (np.round(wanted[name].astype(float) / step) * step).astype(np.float32)
    assert sorted(p.name for p in (tmp_path / "rasters").iterdir()) == sorted(
        ["classes.tif.aux.xml", "dtm_mask.tif.aux.xml", *(f"{n}.tif" for n in wanted), *(f"{n}.qml" for n in wanted)]
    )
    for name, raster in wanted.items():
        with rasterio.open(tmp_path / "rasters" / f"{name}.tif") as file:
            assert file.bounds == rasterio.coords.BoundingBox(*window.box.bounds)
            assert np.array_equal(file.read(1)[::-1], raster, equal_nan=raster.dtype.kind == "f"), name
            held = file.tags(1)
            known = raster[raster != 255] if name == "confidence" else raster[np.isfinite(raster) & (raster != 0)]
            assert float(held["STATISTICS_MAXIMUM"]) == pytest.approx(float(known.max()), rel=1e-6), name
