"""Rasters: where their cells lie, and which echo gives a cell its class."""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pyproj
import pytest
import rasterio
from hypothesis import given, settings
from hypothesis import strategies as st

from fwclass import conf
from fwclass.errors import InputError
from fwclass.grid import Window
from fwclass.publish.cog import cog
from fwclass.publish.params import PublishParams
from fwclass.publish.stage import class_raster, write_cog

CRS = pyproj.CRS(2154)
PARAMS = conf.section("publish")
WINDOW = Window(0.5, 1_540_000, 12_554_000, 700, 600)
NAMES = {2: "ground", 5: "vegetation", 6: "building", 64: "artificial & <other>"}


def codes(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).choice(np.array([0, 2, 5, 6], np.uint8), WINDOW.shape)


def test_heights_lie_where_the_window_says(params: PublishParams, tmp_path: Path) -> None:
    row, col = np.mgrid[0 : WINDOW.nrows, 0 : WINDOW.ncols]
    heights = (row + 1000 * col).astype(np.float32)
    heights[3, 4] = np.nan
    write_cog(heights, WINDOW, tmp_path / "d.tif", CRS, params, np.nan, tags={"what": "terrain"})
    with rasterio.open(tmp_path / "d.tif") as file:
        assert tuple(file.bounds) == WINDOW.box.bounds and file.res == (0.5, 0.5)
        assert file.crs.to_epsg() == 2154 and np.isnan(file.nodata) and file.dtypes == ("float32",)
        assert file.tags()["what"] == "terrain" and file.tags()["AREA_OR_POINT"] == "Area"
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert file.block_shapes == [(512, 512)] and file.overviews(1) == [2]
        assert np.array_equal(file.read(1)[::-1], heights, equal_nan=True)
        east, north = WINDOW.box.xmin + 10.25, WINDOW.box.ymin + 100.75  # middle of cell (201, 20)
        assert next(file.sample([(east, north)]))[0] == heights[201, 20]
        south_west = (WINDOW.box.xmin + 0.01, WINDOW.box.ymin + 0.01)
        assert next(file.sample([south_west]))[0] == heights[0, 0]


def test_classes_have_colours_and_names(params: PublishParams, tmp_path: Path) -> None:
    colours = {2: (1, 2, 3), 6: (200, 100, 50)}
    write_cog(codes(), WINDOW, tmp_path / "c.tif", CRS, params, 0, colormap=colours, names=NAMES)
    with rasterio.open(tmp_path / "c.tif") as file:
        assert file.colormap(1)[6][:3] == (200, 100, 50) and file.colormap(1)[2][:3] == (1, 2, 3)
        assert file.nodata == 0 and file.dtypes == ("uint8",)
        assert file.tags(1)["CLASS_64"] == "artificial & <other>"
        assert np.array_equal(file.read(1)[::-1], codes())
        coarse = file.read(1, out_shape=(300, 350))
        assert set(np.unique(coarse)) <= {0, 2, 5, 6}, "overviews of codes are codes"
    root = ET.parse(tmp_path / "c.tif.aux.xml").getroot()  # noqa: S314
    listed = [c.text or "" for c in root.iter("Category")]
    assert len(listed) == 65 and listed[64] == "artificial & <other>" and listed[3] == ""


def test_shades_of_grey_are_averaged(params: PublishParams, tmp_path: Path) -> None:
    board = (np.indices(WINDOW.shape).sum(axis=0) % 2 * 200 + 10).astype(np.uint8)
    write_cog(board, WINDOW, tmp_path / "h.tif", CRS, params, 0)
    with rasterio.open(tmp_path / "h.tif") as file:
        assert np.array_equal(file.read(1)[::-1], board)
        assert set(np.unique(file.read(1, out_shape=(300, 350)))) == {110}


def test_names_alone_bring_the_house_s_colours(params: PublishParams, tmp_path: Path) -> None:
    write_cog(codes(), WINDOW, tmp_path / "c.tif", CRS, params, 0, names=NAMES)
    with rasterio.open(tmp_path / "c.tif") as file:
        shown = {file.colormap(1)[code][:3] for code in NAMES}
    assert len(shown) == len(NAMES) and (0, 0, 0) not in shown


@pytest.mark.parametrize("compression", ["deflate", "zstd"])
def test_same_array_gives_same_bytes(compression: str, params: PublishParams, tmp_path: Path) -> None:
    chosen = params.model_copy(update={"cog_compression": compression})
    for name in "ab":
        write_cog(codes(), WINDOW, tmp_path / f"{name}.tif", None, chosen, 0, names=NAMES)
    assert (tmp_path / "a.tif").read_bytes() == (tmp_path / "b.tif").read_bytes()
    with rasterio.open(tmp_path / "a.tif") as file:
        assert file.crs is None and file.compression.name == compression
    assert len(list(tmp_path.iterdir())) == 4, "nothing is left beside"


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_pieces_in_any_order_give_the_bytes_of_the_whole(seed: int) -> None:
    rng, array = np.random.default_rng(seed), codes(seed)
    window, params = WINDOW, PARAMS
    rows, cols = (np.unique(np.r_[0, rng.integers(0, n, 3), n]) for n in window.shape)
    pieces = [
        (Window(window.cell, window.col + c, window.row + r, w, h), array[r : r + h, c : c + w])
        for r, h in zip(rows[:-1], np.diff(rows), strict=True)
        for c, w in zip(cols[:-1], np.diff(cols), strict=True)
    ]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_cog(array, window, folder / "a.tif", CRS, params, 0, names=NAMES)
        with cog(array.dtype, window, folder / "b.tif", CRS, params, 0, names=NAMES) as put:
            for k in rng.permutation(len(pieces)):
                put(*pieces[k])
        assert (folder / "a.tif").read_bytes() == (folder / "b.tif").read_bytes()


def test_what_no_piece_covers_has_no_data_and_a_fault_leaves_no_file(params: PublishParams, tmp_path: Path) -> None:
    corner = Window(0.5, WINDOW.col, WINDOW.row, 3, 2)
    with cog(np.dtype(np.float32), WINDOW, tmp_path / "d.tif", CRS, params, np.nan) as put:
        put(corner, np.arange(6, dtype=np.float32).reshape(2, 3))
    with rasterio.open(tmp_path / "d.tif") as file:
        found = file.read(1)
    assert found[-1, :3].tolist() == [0, 1, 2] and found[-2, :3].tolist() == [3, 4, 5]
    assert np.isfinite(found).sum() == 6
    with pytest.raises(ZeroDivisionError), cog(np.dtype(np.uint8), WINDOW, tmp_path / "e.tif", CRS, params, 0) as put:
        put(corner, np.ones((2, 3), np.uint8))
        raise ZeroDivisionError
    assert [p.name for p in tmp_path.iterdir()] == ["d.tif"]
    with (
        pytest.raises(ValueError, match="does not lie inside"),
        cog(np.dtype(np.uint8), WINDOW, tmp_path / "f.tif", CRS, params, 0) as put,
    ):
        put(Window(0.5, WINDOW.col - 1, WINDOW.row, 3, 2), np.ones((2, 3), np.uint8))


def test_another_shape_is_refused(params: PublishParams, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not fit its window"):
        write_cog(codes()[1:], WINDOW, tmp_path / "c.tif", None, params, 0)


cell = Window(1.0, 10, 20, 3, 2)
echo = st.tuples(st.integers(8000, 15000), st.integers(18000, 24000), st.integers(-3, 3), st.sampled_from([0, 2, 5, 6]))


def slow_class_raster(rows: list[tuple[int, int, int, int]]) -> np.ndarray:
    """The rule as it is written: per cell the highest, then the smallest code."""
    out = np.zeros(cell.shape, np.uint8)
    for r in range(cell.nrows):
        for c in range(cell.ncols):
            here = [(-z, k) for x, y, z, k in rows if k and x // 1000 - cell.col == c and y // 1000 - cell.row == r]
            out[r, c] = min(here)[1] if here else 0
    return out


@settings(max_examples=100, deadline=None)
@given(rows=st.lists(echo, max_size=40), data=st.data())
def test_the_highest_echo_gives_the_class_in_any_order(rows: list, data: st.DataObject) -> None:
    shuffled = data.draw(st.permutations(rows))
    wanted = slow_class_raster(rows)
    for some in (rows, shuffled):
        x, y, z, k = (np.array([r[i] for r in some], float) for i in range(4))
        found = class_raster(x / 1000, y / 1000, z / 1000, k.astype(np.uint8), cell)
        assert np.array_equal(found, wanted)
