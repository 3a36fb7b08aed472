"""Ground in a run: the blocks' flags and heights reach the right echoes, rasters fit together, seams are told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import rasterio
from runmaker import SETTINGS, walk

from fwclass import conf
from fwclass.graph.ground_seams import windows
from fwclass.grid import Box, TileGrid, millimetres
from fwclass.ground.blocks import ground_by_blocks
from fwclass.ground.stage import filter_ground
from fwclass.ground.terrain.blocks import terrain_by_blocks

COLUMNS = ["x", "y", "z", "echo_number", "number_of_echoes", "ground", "noise", "height_above_ground"]


@pytest.fixture(scope="module")
def echoes(finished):
    tables = [pq.read_table(p, columns=COLUMNS) for p in sorted((finished[0] / "parquet").glob("*.parquet"))]
    return {n: np.concatenate([t.column(n).to_numpy() for t in tables]) for n in COLUMNS}


@pytest.fixture(scope="module")
def config():
    return conf.load("demo", SETTINGS)


def test_a_run_in_tiles_gives_what_the_cloud_in_memory_gives(echoes, config):
    place = echoes["x"], echoes["y"], echoes["z"]
    flags = ground_by_blocks(*place, echoes["echo_number"] >= echoes["number_of_echoes"], config.ground)
    np.testing.assert_array_equal(echoes["ground"].astype(bool), flags.ground)
    np.testing.assert_array_equal(echoes["noise"].astype(bool), flags.noise)
    terrain, _ = terrain_by_blocks(*place, flags.ground, flags.noise, config.terrain)
    step = 2.0 ** -(config.publish.parquet_bits + 1)  # what is delivered is rounded
    np.testing.assert_allclose(echoes["height_above_ground"], terrain.height, rtol=1.0001 * step)


def test_ground_echoes_are_low_and_only_last_ones(echoes):
    ground = echoes["ground"].astype(bool)
    assert 0.2 < ground.mean() < 0.8
    assert (echoes["echo_number"] == echoes["number_of_echoes"])[ground].all()
    assert np.abs(np.median(echoes["height_above_ground"][ground])) < 0.05
    assert np.median(echoes["height_above_ground"][~ground]) > 1.0


def test_the_report_tells_the_filter_s_errors(finished):
    root, report = finished
    told = report["ground"]["accuracy"]
    (a, b), (c, d) = told["confusion"]
    assert a + b + c + d > 0.9 * report["ground"]["echoes"] and a + c <= report["ground"]["ground"]
    assert told["type_i"] == pytest.approx(b / (a + b)) and told["type_ii"] == pytest.approx(c / (c + d))
    assert told["kappa"] > 0.7
    assert "Type II" in (root / "report.html").read_text()


def raster(root: Path, name: str) -> np.ndarray:
    with rasterio.open(root / "rasters" / f"{name}.tif") as opened:
        return opened.read(1)


def test_surface_less_terrain_is_the_normalised_surface(finished):
    dtm, dsm, ndsm = (raster(finished[0], n) for n in ("dtm", "dsm", "ndsm"))
    np.testing.assert_array_equal(np.isnan(ndsm), np.isnan(dtm) | np.isnan(dsm))
    np.testing.assert_allclose(ndsm, dsm - dtm, rtol=0, atol=2**-10, equal_nan=True)  # half a step of either
    assert np.nanmax(ndsm) > 3.0
    assert np.nanpercentile(ndsm, 5) > -0.5


def test_the_report_tells_what_the_seams_changed(finished):
    root, report = finished
    seams = report["ground"]["seams"]
    implausible = sum(strip["implausible"] for strip in report["plausibility"]["strips"])
    assert seams["echoes"] == report["counts"]["echoes_in_tiles"] - implausible
    assert seams["flags_differ"] < 0.002 * seams["echoes"]  # blocks of 64 m are small
    assert "in windows that lie elsewhere" in (root / "report.html").read_text()


@pytest.mark.parametrize("block", [64.0, 256.0, 0.3])
def test_every_border_of_blocks_lies_inside_a_window(block: float) -> None:
    """And no echo lies in two; the order is the seed's, whichever way the tiles come."""
    tiles = list(TileGrid(3 * block).touching(Box(-5 * block, 2 * block, 9 * block, 11 * block)))
    some = windows(tiles, block, 7)
    assert windows(reversed(tiles), block, 7) == some and sorted(windows(tiles, block, 8)) == sorted(some)
    assert len({(w.ix, w.iy) for w in some}) == len(some)
    for tile in tiles:
        for cut in TileGrid(block).touching(tile.box):
            x, y = cut.box.xmax, (cut.box.ymin + cut.box.ymax) / 2
            (window,) = (w.box for w in some if w.box.contains(np.array([x - 0.001]), np.array([y]))[0])
            assert window.xmin < x < window.xmax


@pytest.mark.slow
def test_what_blocks_got_wrong_shows(survey, tmp_path, monkeypatch):
    """Every hundredth echo, by its place, has another flag in all blocks."""

    def wrong(table, params):
        flags = filter_ground(table, params)
        return replace(flags, ground=flags.ground ^ (millimetres(table["x"]) % 100 == 0))

    monkeypatch.setattr("fwclass.graph.ground.filter_ground", wrong)
    _, report = walk(survey, tmp_path)
    seams = report["ground"]["seams"]
    assert 0.005 < seams["flags_differ"] / seams["echoes"] < 0.02
    assert seams["cells_off"] > 0.001 * seams["cells"]
    assert "choose larger blocks or a wider halo" in (tmp_path / "report.html").read_text()


@pytest.mark.slow
def test_some_windows_of_a_large_survey_are_filtered_twice(survey, tmp_path):
    _, report = walk(survey, tmp_path, "run.seam_check_echoes=1000")
    seams, echoes = report["ground"]["seams"], report["counts"]["echoes_in_tiles"]
    echoes -= sum(strip["implausible"] for strip in report["plausibility"]["strips"])
    assert 1000 <= seams["echoes"] < echoes and seams["left_out"] == echoes - seams["echoes"]
    assert "took no part" in (tmp_path / "report.html").read_text()
    _, report = walk(survey, tmp_path, "run.seam_check_echoes=0")
    assert report["ground"]["seams"] is None
    assert "were not measured" in (tmp_path / "report.html").read_text()


@pytest.mark.slow
@pytest.mark.parametrize("method", ["slope", "pmf", "moving-surface", "ptd", "iptd", "csf", "csf+smrf", "consensus"])
def test_every_filter_runs_and_tiles_do_not_change_it(method, survey, tmp_path):
    digests = []
    for size in ("100", "41.5"):
        root = tmp_path / size
        road, report = walk(survey, root, f"ground.method={method}", f"tile.size={size}")
        assert not road.failures, road.failures
        assert 0.2 < report["ground"]["ground"] / report["ground"]["echoes"] < 0.8
        digests.append([raster(root, n).tobytes() for n in ("dtm", "dsm")])
    assert digests[0] == digests[1]
