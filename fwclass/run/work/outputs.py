"""Work of the parts that deliver: classified tiles and strips, GeoParquet, rasters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from fwclass.errors import InputError, StoreError
from fwclass.grid import Box, Tile, Window
from fwclass.publish.cog import class_raster, write_cog
from fwclass.publish.geoparquet import write_geoparquet
from fwclass.publish.laz import write_tile_laz
from fwclass.publish.palette import colours
from fwclass.publish.params import PublishParams
from fwclass.publish.shade import hillshade
from fwclass.publish.strips import write_strip_laz
from fwclass.run.desk import Desk
from fwclass.run.work.sources import link_table
from fwclass.run.work.tiles import mosaic, write_rasters
from fwclass.schema import Table
from fwclass.store.outside import Place

_ECHO_BITS = 8
MAX_CELLS = 1 << 29
"""Cells of a survey-wide raster; one array of them has 2 GiB."""


def crs_of(text: str | None) -> CRS | None:
    return CRS.from_user_input(text) if text else None


def delivered_tile(
    tile: Tile,
    columns: Mapping[str, str],
    crs: str | None,
    standard_time: bool,
    params: PublishParams,
    desk: Desk,
    directory: Path,
) -> dict[str, Any]:
    """A tile as LAZ and as GeoParquet."""
    table = desk.rows(tile.key, columns)
    for name in ("laz/tiles", "parquet"):
        (directory / name).mkdir(parents=True)
    path = directory / "laz" / "tiles" / f"{tile.key}.laz"
    write_tile_laz(table, path, crs_of(crs), params, standard_time=standard_time)
    write_geoparquet(table, directory / "parquet" / f"{tile.key}.parquet", crs_of(crs), params)
    return {"rows": table.rows}


def delivered_strip(
    source: Place, strip: int, chunks: tuple[str, ...], tiles: tuple[str, ...], codes: Mapping[int, int],
    params: PublishParams, desk: Desk, directory: Path,
) -> dict[str, Any]:  # fmt: skip
    """A source strip in its own order with every point's class: that of its nearest echo of the same pulse.

    `codes` maps class codes to those that the strip's point format can hold.
    """
    keys, classes = _classes_of_strip(strip, tiles, desk)
    links = Table.concat([link_table(desk, c) for c in chunks])
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
    facts = write_strip_laz(desk.local(source), output, legal[classes[place]], None, params)
    return {"points": links.rows, "notes": [str(n) for n in facts.get("notes", ())]}


def _keys(table: Table) -> NDArray[np.uint64]:
    return (table["pulse"].astype(np.uint64) << np.uint64(_ECHO_BITS)) | table["echo_number"].astype(np.uint64)


def _classes_of_strip(strip: int, tiles: tuple[str, ...], desk: Desk) -> tuple[NDArray[np.uint64], NDArray[np.uint8]]:
    """(key, class) of every echo of a strip, by key."""
    columns = {**dict.fromkeys(("strip", "pulse", "echo_number"), "tile"), "classification": "classify"}
    tables = []
    for tile in tiles:
        table = desk.rows(tile, columns)
        tables.append(table.take(table["strip"] == strip))
    if not tables:
        return np.empty(0, np.uint64), np.empty(0, np.uint8)
    table = Table.concat(tables)
    keys = _keys(table)
    order = np.argsort(keys)
    return keys[order], table["classification"][order]


def class_block(
    block: Tile,
    tile_size: float,
    present: tuple[str, ...],
    params: PublishParams,
    desk: Desk,
    directory: Path,
) -> dict[str, Any]:
    """Class of the highest echo of every cell of one block of the fixed grid."""
    window = Window.covering(block.box, params.class_cell)
    columns = {"z": "tile", "classification": "classify"}
    points = desk.inside(window.box, tile_size, columns, present)
    raster = class_raster(points["x"], points["y"], points["z"], points["classification"], window)
    write_rasters(directory, {"classes": raster}, window)
    return {"cells": int((raster > 0).sum())}


def delivered_rasters(
    box: Box, cell: float, blocks: tuple[str, ...], class_blocks: tuple[str, ...], names: Mapping[int, str],
    crs: str | None, params: PublishParams, desk: Desk, directory: Path,
) -> dict[str, Any]:  # fmt: skip
    """Terrain, surface, their difference, hillshade and class map of the whole survey as cloud-optimised GeoTIFF."""
    target = directory / "rasters"
    target.mkdir(parents=True)
    terrain = Window.covering(box, cell)
    if max(math.prod(terrain.shape), math.prod(Window.covering(box, params.class_cell).shape)) > MAX_CELLS:
        raise InputError(
            "the survey's rasters would be too large",
            where="rasters",
            expected=f"at most {MAX_CELLS:,} cells",
            got=f"{terrain.shape[1]:,} x {terrain.shape[0]:,} cells of {cell:g} m from {box.bounds}",
            do="look for stray points with `fwclass info` and remove them, or choose larger terrain.cell and "
            "publish.class_cell",
        )
    empty = {"dtm": np.nan, "dsm": np.nan}
    heights = mosaic(desk, "terrain", blocks, terrain, ("dtm", "dsm"), empty)
    dtm = heights["dtm"]
    system = crs_of(crs)
    told = {
        "dtm": (dtm, "terrain height [m]"),
        "dsm": (heights["dsm"], "height of the highest echo [m]"),
        "ndsm": (heights["dsm"] - dtm, "highest echo above the terrain [m]"),
    }
    for name, (raster, what) in told.items():
        path = target / f"{name}.tif"
        write_cog(raster, terrain, path, system, params, nodata=float("nan"), tags={"what": what})
    tone = np.where(np.isfinite(dtm), 1 + 254 * hillshade(dtm, cell, params), 0).astype(np.uint8)
    write_cog(
        tone,
        terrain,
        target / "hillshade.tif",
        system,
        params,
        nodata=0,
        tags={"what": "shaded relief, 1 to 255"},
    )
    window = Window.covering(box, params.class_cell)
    listed = [{"name": name, "code": code} for code, name in names.items()]
    classes = mosaic(desk, "class-block", class_blocks, window, ("classes",), {"classes": 0})["classes"]
    write_cog(
        classes,
        window,
        target / "classes.tif",
        system,
        params,
        nodata=0,
        colormap=colours(listed),
        names=dict(names),
    )
    return {"dtm_cells": int(np.isfinite(dtm).sum()), "class_cells": int((classes > 0).sum())}
