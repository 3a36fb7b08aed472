"""Work of the parts that deliver: classified tiles and strips, GeoParquet, rasters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from fwclass.errors import InputError, StoreError
from fwclass.graph.work.rasters import Mosaic, stripes, write_rasters
from fwclass.graph.work.sources import link_table
from fwclass.grid import Box, Tile, Window
from fwclass.publish.cog import STRIPE, class_raster, cog
from fwclass.publish.geoparquet import write_geoparquet
from fwclass.publish.laz import write_tile_laz
from fwclass.publish.palette import colours
from fwclass.publish.params import PublishParams
from fwclass.publish.shade import hillshade
from fwclass.publish.strips import write_strip_laz
from fwclass.run.inputs import PartInputs
from fwclass.schema import Table
from fwclass.store.remote_file import Location

_ECHO_BITS = 8
MAX_CELLS = 1 << 35
"""Cells of a survey-wide raster: 34 000 km² at 1 m. More are stray points, which would fill a disk with nothing."""


def crs_of(text: str | None) -> CRS | None:
    return CRS.from_user_input(text) if text else None


def delivered_tile(
    tile: Tile,
    columns: Mapping[str, str],
    crs: str | None,
    standard_time: bool,
    params: PublishParams,
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """A tile as LAZ and as GeoParquet."""
    table = inputs.rows(tile.key, columns)
    for name in ("laz/tiles", "parquet"):
        (directory / name).mkdir(parents=True)
    path = directory / "laz" / "tiles" / f"{tile.key}.laz"
    write_tile_laz(table, path, crs_of(crs), params, standard_time=standard_time)
    write_geoparquet(table, directory / "parquet" / f"{tile.key}.parquet", crs_of(crs), params)
    return {"rows": table.rows}


def delivered_strip(
    source: Location,
    strip: int,
    chunks: tuple[str, ...],
    tiles: tuple[str, ...],
    codes: Mapping[int, int],
    params: PublishParams,
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """A source strip in its own order with every point's class: that of its nearest echo of the same pulse.

    `codes` maps class codes to those that the strip's point format can hold.
    """
    keys, classes = _classes_of_strip(strip, tiles, inputs)
    links = Table.concat([link_table(inputs, c) for c in chunks])
    wanted = _keys(links)
    place = np.searchsorted(keys, wanted)
    if links.rows and (len(keys) == 0 or (keys[np.minimum(place, len(keys) - 1)] != wanted).any()):
        raise StoreError(
            "a return's echo is in no tile",
            where=source,
            do="run again without --tiles: a strip is delivered when all its tiles are classified",
        )
    legal = np.arange(256, dtype=np.uint8)
    for code, other in codes.items():
        legal[code] = other
    output = directory / "laz" / "strips" / f"{source.stem}.laz"
    output.parent.mkdir(parents=True)
    facts = write_strip_laz(inputs.local(source), output, legal[classes[place]], None, params)
    return {"points": links.rows, "notes": [str(n) for n in facts.get("notes", ())]}


def _keys(table: Table) -> NDArray[np.uint64]:
    return (table["pulse"].astype(np.uint64) << np.uint64(_ECHO_BITS)) | table["echo_number"].astype(np.uint64)


def _classes_of_strip(
    strip: int, tiles: tuple[str, ...], inputs: PartInputs
) -> tuple[NDArray[np.uint64], NDArray[np.uint8]]:
    """(key, class) of every echo of a strip, by key."""
    columns = {**dict.fromkeys(("strip", "pulse", "echo_number"), "tile"), "classification": "classify"}
    tables = []
    for tile in tiles:
        table = inputs.rows(tile, columns)
        tables.append(table.take(table["strip"] == strip))
    if not tables:
        return np.empty(0, np.uint64), np.empty(0, np.uint8)
    table = Table.concat(tables)
    keys = _keys(table)
    order = np.argsort(keys)
    return keys[order], table["classification"][order]


def class_block(
    block: Tile, tile_size: float, present: tuple[str, ...], params: PublishParams, inputs: PartInputs, directory: Path
) -> dict[str, Any]:
    """Class of the highest echo of every cell of one block of the fixed grid."""
    window = Window.covering(block.box, params.class_cell)
    columns = {"z": "tile", "classification": "classify"}
    points = inputs.inside(window.box, tile_size, columns, present)
    raster = class_raster(points["x"], points["y"], points["z"], points["classification"], window)
    write_rasters(directory, {"classes": raster}, window)
    return {"cells": int((raster > 0).sum())}


def delivered_rasters(
    box: Box,
    cell: float,
    blocks: tuple[Tile, ...],
    names: Mapping[int, str],
    crs: str | None,
    params: PublishParams,
    folder: str,
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """Terrain, surface, their difference, hillshade and class map of `box` as cloud-optimised GeoTIFF in `folder`.

    They are made in stripes from north to south: memory grows with the box's width alone.
    """
    target = directory / folder
    target.mkdir(parents=True)
    windows = Window.covering(box, cell), Window.covering(box, params.class_cell)
    for window in windows:
        if math.prod(window.shape) > MAX_CELLS:
            raise InputError(
                "the survey's rasters would be too large",
                where="rasters",
                expected=f"at most {MAX_CELLS:,} cells",
                got=f"{window.ncols:,} x {window.nrows:,} cells of {window.cell:g} m from {box.bounds}",
                do="look for stray points with `fwclass info` and remove them, or choose larger terrain.cell and "
                "publish.class_cell",
            )
    system = crs_of(crs)
    return {
        "dtm_cells": _terrain_rasters(windows[0], blocks, system, params, inputs, target),
        "class_cells": _class_raster(windows[1], blocks, names, system, params, inputs, target),
    }


_TERRAIN = {
    "dtm": "terrain height [m]",
    "dsm": "height of the highest echo [m]",
    "ndsm": "highest echo above the terrain [m]",
}


def _terrain_rasters(
    window: Window, blocks: tuple[Tile, ...], crs: CRS | None, params: PublishParams, inputs: PartInputs, target: Path
) -> int:
    """Write heights and shaded relief; cells with terrain."""
    nothing = np.float32(np.nan)
    mosaic = Mosaic(inputs, "terrain", blocks, window.cell, {"dtm": nothing, "dsm": nothing})
    cells = 0
    with ExitStack() as files:
        put = {
            name: files.enter_context(
                cog(nothing.dtype, window, target / f"{name}.tif", crs, params, np.nan, tags={"what": what})
            )
            for name, what in _TERRAIN.items()
        }
        what = {"what": "shaded relief, 1 to 255"}
        shade = files.enter_context(
            cog(np.dtype(np.uint8), window, target / "hillshade.tif", crs, params, 0, tags=what)
        )
        for stripe in stripes(window, STRIPE):
            if not mosaic.touches(stripe):
                continue
            around = stripe.grown(1).common(window) or stripe  # light asks for the cells beside
            heights, inner = mosaic.laid(around), stripe.within(around)
            dtm = heights["dtm"]
            there = np.isfinite(dtm)
            tone = np.where(there, 1 + 254 * hillshade(dtm, window.cell, params), 0).astype(np.uint8)
            for name, raster in {**heights, "ndsm": heights["dsm"] - dtm}.items():
                put[name](stripe, raster[inner])
            shade(stripe, tone[inner])
            cells += int(there[inner].sum())
    return cells


def _class_raster(
    window: Window,
    blocks: tuple[Tile, ...],
    names: Mapping[int, str],
    crs: CRS | None,
    params: PublishParams,
    inputs: PartInputs,
    target: Path,
) -> int:
    """Write the class map; cells with a class."""
    mosaic = Mosaic(inputs, "class-block", blocks, window.cell, {"classes": np.uint8(0)})
    shown = colours([{"name": name, "code": code} for code, name in names.items()])
    cells = 0
    with cog(np.dtype(np.uint8), window, target / "classes.tif", crs, params, 0, shown, names=names) as put:
        for stripe in stripes(window, STRIPE):
            if mosaic.touches(stripe):
                classes = mosaic.laid(stripe)["classes"]
                put(stripe, classes)
                cells += int((classes > 0).sum())
    return cells
