"""Rasters as cloud-optimised GeoTIFF."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import escape

import numpy as np
import pyproj
from numpy.typing import NDArray

from fwclass.errors import InputError, StoreError, full_or
from fwclass.formats.epsg import without_old_codes
from fwclass.grid import Window
from fwclass.isolation import away_from
from fwclass.publish.files import written_whole
from fwclass.publish.palette import RGB, colours
from fwclass.publish.params import PublishParams

if TYPE_CHECKING:
    import rasterio

STRIPE = 64
"""Rows of a raster that are written together, counted from the north."""

Put = Callable[[Window, NDArray], None]


def write_cog(
    array: NDArray,
    window: Window,
    path: Path,
    crs: pyproj.CRS | None,
    params: PublishParams,
    nodata: float,
    colormap: Mapping[int, RGB] | None = None,
    tags: Mapping[str, str] | None = None,
    names: Mapping[int, str] | None = None,
    unit: float = 1.0,
) -> dict[str, Any]:
    """Write a raster that is in memory; see `cog`. Returns a dict with ``path, shape, cell, bytes``.

    `InputError`: the array is not of the window's shape, or the window is empty.
    """
    if array.shape != window.shape or not array.size:
        raise InputError("a raster does not fit its window", where=path, expected=window.shape, got=array.shape)
    with cog(array.dtype, window, path, crs, params, nodata, colormap, tags, names, unit) as put:
        put(window, array)
    return {"path": str(path), "shape": list(window.shape), "cell": window.cell, "bytes": path.stat().st_size}


@contextmanager
def cog(
    dtype: np.dtype,
    window: Window,
    path: Path,
    crs: pyproj.CRS | None,
    params: PublishParams,
    nodata: float,
    colormap: Mapping[int, RGB] | None = None,
    tags: Mapping[str, str] | None = None,
    names: Mapping[int, str] | None = None,
    unit: float = 1.0,
    smooth: bool = True,
) -> Iterator[Put]:
    """Write a raster north up with overviews, in stripes of any order; the same cells give the same bytes.

    ``put(stripe, array)`` lays an array of ``stripe.shape``, **row 0 in the south**, into the window; the outer corner
    of the window's cell (0, 0) is the south-west corner of ``window.box``. A stripe is as wide as the window and one or
    more times `STRIPE` rows high, counted from the north; the southernmost may be lower (`ValueError` for another
    piece: GDAL would tell no fault of writing it). What no stripe covers has no data. The file appears at the end, and
    only if no fault ended the block. Until then the cells lie beside it on the disk, and memory holds the stripes and
    `params.raster_cache`.

    Parameters
    ----------
    dtype : float32 or uint8.
    nodata : value of a cell without data; NaN for heights, 0 for classes.
    colormap : colour per code, for uint8; None takes the house's colours of `names`.
        Overviews take the commonest value if there are colours or names, else the mean.
    tags : texts for the file's metadata.
    unit : metres in one unit of the CRS; the window counts in metres.
    smooth : neighbours' values differ by little, as a surface's do: these compress by their differences, others do not.
    names : class name per code; stored as tags ``CLASS_<code>`` and, for desktop GIS, in ``<path>.aux.xml``.
    """
    import rasterio  # it takes its time, and is not needed to plan
    from rasterio.shutil import copy

    codes = bool(names or colormap)
    known = dict(sorted((names or {}).items()))
    if codes and known and colormap is None:
        colormap = colours({"name": name, "code": code} for code, name in known.items())
    raw_profile = _raw_profile(dtype, window, crs, nodata, unit)
    cog_profile = _cog_profile(dtype, params, codes, smooth)
    with written_whole(path) as beside, rasterio.Env(GDAL_CACHEMAX=params.raster_cache << 20):
        raw = beside.with_name(f"{beside.name}.raw")
        try:
            with rasterio.open(raw, "w", **raw_profile) as file:
                if colormap:
                    file.write_colormap(1, dict(sorted(colormap.items())))
                file.update_tags(AREA_OR_POINT="Area", TIFFTAG_SOFTWARE="fwclass", **(tags or {}))
                file.update_tags(1, **{f"CLASS_{code}": name for code, name in known.items()})

                def put(stripe: Window, array: NDArray) -> None:
                    rows, _ = stripe.within(window)
                    north = window.nrows - rows.stop
                    if stripe.ncols != window.ncols or north % STRIPE or (rows.start and stripe.nrows % STRIPE):
                        raise ValueError(f"{stripe} is no stripe of {window}")
                    place = rasterio.windows.Window(0, north, stripe.ncols, stripe.nrows)
                    file.write(np.ascontiguousarray(array[::-1]), 1, window=place)

                yield put
            _know_grids()
            copy(raw, beside, **cog_profile)
            _check_place(beside, path, raw_profile)
        except OSError as fault:  # before the cells go, and the disk has room again
            error = full_or(fault, path.parent)
            if error is fault:
                raise
            raise error from fault
        finally:
            for part in (raw, Path(f"{raw}.aux.xml"), Path(f"{beside}.aux.xml")):  # what no TIFF can hold
                part.unlink(missing_ok=True)
    if known:
        _write_names(path, known)


def _raw_profile(dtype: np.dtype, window: Window, crs: pyproj.CRS | None, nodata: float, unit: float) -> dict[str, Any]:
    """Of the file that the stripes are laid into."""
    import rasterio

    return {
        "driver": "GTiff",
        "width": window.ncols,
        "height": window.nrows,
        "count": 1,
        "dtype": dtype,
        "nodata": nodata,
        "transform": north_up(window, unit),
        "crs": rasterio.crs.CRS.from_wkt(without_old_codes(_flat(crs)).to_wkt()) if crs is not None else None,
        "blockysize": STRIPE,
        "sparse_ok": True,
        "bigtiff": "IF_SAFER",
    }


def _flat(crs: pyproj.CRS) -> pyproj.CRS:
    """`crs` without its heights where it is a projected one in space, as RIEGL's is, which no TIFF can hold."""
    return crs.to_2d() if crs.is_projected and not crs.is_compound and len(crs.axis_info) == 3 else crs


def _check_place(written: Path, path: Path, profile: Mapping[str, Any]) -> None:
    """`StoreError` unless what was `written` lies where its `profile` has it, in a projected system where that has one:
    GDAL says nothing where settings of its own, or data of another PROJ, keep it from writing that, or lays it into a
    file beside, which is not looked at."""
    import rasterio

    alone = rasterio.Env(GDAL_PAM_ENABLED="NO")
    with warnings.catch_warnings(action="ignore"), alone, rasterio.open(written, driver="GTiff") as file:
        crs, place = file.crs, file.transform
    system = profile["crs"]
    if place.almost_equals(profile["transform"]) and (
        not (system and system.is_projected) or (crs and crs.is_projected)
    ):
        return
    named = [name for name in ("PROJ_DATA", "PROJ_LIB", "GDAL_DATA") if name in os.environ]
    raise StoreError(
        "a raster comes out without its coordinate system or its place",
        where=path,
        expected=system.to_string() if system else "its place",
        got=crs.to_string() if crs else "none",
        do=f"unset {' and '.join(named)} in the environment"
        if named
        else "unset GDAL's and PROJ's own variables in the environment, or install fwclass anew",
    )


def _cog_profile(dtype: np.dtype, params: PublishParams, codes: bool, smooth: bool) -> dict[str, Any]:
    """Of the file that is delivered; `codes`: its values are classes."""
    return {
        "driver": "COG",
        "compress": params.cog_compression,
        "blocksize": params.cog_block,
        "num_threads": 1,
        "predictor": _predictor(dtype) if smooth and not codes else "NO",
        "bigtiff": "IF_SAFER",
        "overview_resampling": "MODE" if codes else "AVERAGE",
        "statistics": "YES",  # or QGIS reckons them, and leaves a file beside
    }


@cache
def _know_grids() -> None:
    """Let GDAL read its grids of tiles, as it does once, before the first file; it looks for each by its name in the
    current directory first."""
    from rasterio.env import GDALDataFinder
    from rasterio.io import MemoryFile
    from rasterio.shutil import copy

    data = os.environ.get("GDAL_DATA") or GDALDataFinder().search()
    names = [path.stem.removeprefix("tms_") for path in Path(data).glob("tms_*.json")] if data else []
    if any(map(os.path.lexists, names)):
        with (
            away_from(*names),
            MemoryFile() as source,
            MemoryFile() as target,
            warnings.catch_warnings(action="ignore"),
        ):
            source.open(driver="GTiff", width=1, height=1, count=1, dtype="uint8").close()
            copy(source.name, target.name, driver="COG")


def _predictor(dtype: np.dtype) -> str:
    """What differences of neighbours are taken of."""
    return "FLOATING_POINT" if dtype.kind == "f" else "STANDARD"


def round_to_bits(raster: NDArray[np.float32], bits: int) -> NDArray[np.float32]:
    """`raster` in whole steps of 2^-bits, whose last bits are 0 and compress; NaN stays."""
    return np.ldexp(np.rint(np.ldexp(raster, bits)), -bits).astype(np.float32)


def north_up(window: Window, unit: float = 1.0) -> rasterio.Affine:
    """From (column, row counted from the north) to coordinates; cell corners lie on the window's box."""
    import rasterio

    cell = window.cell / unit
    return rasterio.Affine(cell, 0.0, window.box.xmin / unit, 0.0, -cell, window.box.ymax / unit)


def _write_names(path: Path, names: Mapping[int, str]) -> None:
    """Category names where GDAL looks for them: a TIFF has no place of its own."""
    rows = "\n".join(f"      <Category>{escape(names.get(i, ''))}</Category>" for i in range(max(names) + 1))
    text = (
        '<PAMDataset>\n  <PAMRasterBand band="1">\n    <CategoryNames>\n'
        f"{rows}\n    </CategoryNames>\n  </PAMRasterBand>\n</PAMDataset>\n"
    )
    with written_whole(path.with_name(path.name + ".aux.xml")) as beside:
        beside.write_text(text, encoding="utf-8")
