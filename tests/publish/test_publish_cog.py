"""Rasters: where their cells lie, and which echo gives a cell its class."""

from __future__ import annotations

import itertools
import random
import subprocess
import sys
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
from fwclass.errors import InputError, StoreError
from fwclass.formats.epsg import another
from fwclass.grid import Window
from fwclass.publish.class_raster import NO_CONFIDENCE, class_rasters
from fwclass.publish.cog import STRIPE, cog, write_cog
from fwclass.publish.params import PublishParams

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


@pytest.mark.parametrize("code", [32018, 2245, 28403, 4860])
def test_a_code_that_epsg_has_withdrawn_lies_where_it_did(params: PublishParams, tmp_path: Path, code: int) -> None:
    """GDAL reads the system that took its place, with other numbers."""
    own = pyproj.CRS(code)
    write_cog(codes(), WINDOW, tmp_path / "c.tif", own, params, 0)
    with rasterio.open(tmp_path / "c.tif") as file:
        assert not another(pyproj.CRS.from_wkt(file.crs.to_wkt()), own)


def test_a_projected_system_in_space_is_that_of_the_plane(params: PublishParams, tmp_path: Path) -> None:
    """No TIFF can hold one: GDAL laid it into files beside those that are renamed, which were delivered too."""
    space = pyproj.CRS.from_epsg(32633).to_3d()
    write_cog(codes(), WINDOW, tmp_path / "c.tif", space, params, 0)
    with rasterio.open(tmp_path / "c.tif") as file:
        assert file.crs.to_epsg() == 32633
    assert [path.name for path in tmp_path.iterdir()] == ["c.tif"]


def test_a_system_that_a_tiff_cannot_hold_is_refused(
    params: PublishParams, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fwclass.publish.cog._flat", lambda crs: crs)
    with pytest.raises(StoreError, match="without its coordinate system"):
        write_cog(codes(), WINDOW, tmp_path / "c.tif", pyproj.CRS.from_epsg(32633).to_3d(), params, 0)
    assert list(tmp_path.iterdir()) == []


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
@given(st.lists(st.integers(1, 9), max_size=4), st.randoms())
@pytest.mark.slow
def test_stripes_in_any_order_give_the_bytes_of_the_whole(cuts: list[int], order: random.Random) -> None:
    array, top = codes(), WINDOW.row + WINDOW.nrows
    edges = [0, *sorted(STRIPE * c for c in set(cuts)), WINDOW.nrows]  # from the north
    pieces = []
    for first, last in itertools.pairwise(edges):
        low = WINDOW.nrows - last
        pieces.append(
            (Window(0.5, WINDOW.col, top - last, WINDOW.ncols, last - first), array[low : low + last - first])
        )
    order.shuffle(pieces)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_cog(array, WINDOW, folder / "a.tif", CRS, PARAMS, 0, names=NAMES)
        with cog(array.dtype, WINDOW, folder / "b.tif", CRS, PARAMS, 0, names=NAMES) as put:
            for piece in pieces:
                put(*piece)
        assert (folder / "a.tif").read_bytes() == (folder / "b.tif").read_bytes()


def test_what_no_stripe_covers_has_no_data_and_a_fault_leaves_no_file(params: PublishParams, tmp_path: Path) -> None:
    south = Window(0.5, WINDOW.col, WINDOW.row, WINDOW.ncols, WINDOW.nrows % STRIPE)
    heights = np.arange(np.prod(south.shape), dtype=np.float32).reshape(south.shape)
    with cog(heights.dtype, WINDOW, tmp_path / "d.tif", CRS, params, np.nan) as put:
        put(south, heights)
    with rasterio.open(tmp_path / "d.tif") as file:
        found = file.read(1)[::-1]
    assert np.array_equal(found[: south.nrows], heights) and np.isnan(found[south.nrows :]).all()
    with pytest.raises(ZeroDivisionError), cog(heights.dtype, WINDOW, tmp_path / "e.tif", CRS, params, 0) as put:
        put(south, heights)
        raise ZeroDivisionError
    assert [p.name for p in tmp_path.iterdir()] == ["d.tif"]


@pytest.mark.parametrize(
    ("left", "low", "wide", "high", "told"),
    [
        (-1, 0, 700, 24, "does not lie inside"),
        (0, 0, 350, 600, "no stripe"),
        (0, 0, 700, 30, "no stripe"),  # its northern edge is not one of a stripe
        (0, 536, 700, 32, "does not lie|no stripe"),
        (0, 24, 700, 32, "no stripe"),
    ],
)
def test_what_is_no_stripe_is_refused(left, low, wide, high, told, params: PublishParams, tmp_path: Path) -> None:
    piece = Window(0.5, WINDOW.col + left, WINDOW.row + low, wide, high)
    with (
        pytest.raises(ValueError, match=told),
        cog(np.dtype(np.uint8), WINDOW, tmp_path / "f.tif", CRS, params, 0) as put,
    ):
        put(piece, np.ones(piece.shape, np.uint8))
    assert not list(tmp_path.iterdir())


WIDE = """
import sys
import numpy as np
from pathlib import Path
from fwclass import conf
from fwclass.grid import Window
from fwclass.publish.cog import STRIPE, cog

window, rows = Window(1.0, 0, 0, 20_000, 16 * STRIPE), np.random.default_rng(1)
with cog(np.dtype(np.float32), window, Path(sys.argv[1]) / "w.tif", None, conf.section("publish"), np.nan) as put:
    for k in range(16):
        stripe = Window(1.0, 0, window.nrows - (k + 1) * STRIPE, window.ncols, STRIPE)
        put(stripe, np.full(stripe.shape, k, np.float32))
read = next(int(line.split()[1]) for line in open("/proc/self/io") if line.startswith("rchar"))
print(read / (4 * window.ncols * window.nrows))
"""


def test_a_wide_raster_is_read_about_once_to_be_finished(tmp_path: Path) -> None:
    """A cache that holds less than a row of tiles would read every stripe for every tile of it, 40 times."""
    if not Path("/proc/self/io").exists():
        pytest.skip("this system does not count what is read")
    ended = subprocess.run([sys.executable, "-c", WIDE, tmp_path], capture_output=True, text=True, check=True)
    assert 0.5 < float(ended.stdout) < 4


def test_another_shape_is_refused(params: PublishParams, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not fit its window"):
        write_cog(codes()[1:], WINDOW, tmp_path / "c.tif", None, params, 0)


cell = Window(1.0, 10, 20, 3, 2)
places = st.integers(8000, 15000), st.integers(18000, 24000), st.integers(-3, 3)
echo = st.tuples(*places, st.sampled_from([0, 2, 5, 6]), st.booleans())


def slow_class_raster(rows: list[tuple[int, int, int, int, bool]]) -> np.ndarray:
    """The rule as it is written: per cell the highest that is no noise, then the smallest code."""
    out = np.zeros(cell.shape, np.uint8)
    for r in range(cell.nrows):
        for c in range(cell.ncols):
            sound = [e for e in rows if e[3] and not e[4]]
            here = [(-z, k) for x, y, z, k, _ in sound if (y // 1000 - cell.row, x // 1000 - cell.col) == (r, c)]
            out[r, c] = min(here)[1] if here else 0
    return out


@pytest.mark.statistics
@settings(max_examples=100, deadline=None)
@given(rows=st.lists(echo, max_size=40), data=st.data())
def test_the_highest_echo_gives_the_class_in_any_order(rows: list, data: st.DataObject) -> None:
    shuffled = data.draw(st.permutations(rows))
    wanted = slow_class_raster(rows)
    for some in (rows, shuffled):
        x, y, z, k = (np.array([r[i] for r in some], float) for i in range(4))
        noise = np.array([r[4] for r in some], bool)
        sure = (np.abs(z) / 4 + k / 100).astype(np.float32)
        made = class_rasters(x / 1000, y / 1000, z / 1000, k.astype(np.uint8), sure, noise, cell)
        assert np.array_equal(made.classes, wanted)
        inside = [r for r in some if r[3] and 0 <= r[0] // 1000 - 10 < 3 and 0 <= r[1] // 1000 - 20 < 2]
        assert made.echoes.sum() == len(inside)
        assert np.array_equal(made.confidence == NO_CONFIDENCE, wanted == 0)
    if rows:
        percent = np.rint(100 * sure).astype(np.uint8)
        assert set(np.unique(made.confidence)) <= {NO_CONFIDENCE, *percent.tolist()}
