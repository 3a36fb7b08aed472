"""Stages that deliver: classified tiles and strips, GeoParquet, class blocks and rasters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from fwclass.errors import InputError, StoreError
from fwclass.graph.classify import classes_written
from fwclass.graph.ground import terrain_blocks
from fwclass.graph.layout import FileDigests, Strip
from fwclass.graph.radiometry import MEASURE_RADIOMETRY
from fwclass.graph.rasters import Mosaic, stripes, write_rasters
from fwclass.graph.sites import WHOLE, Site, sites
from fwclass.graph.sources import link_table, spans_of, strip_of
from fwclass.graph.stage import Made, Names, Plan, Stage, StageInputs
from fwclass.graph.tiling import tiles_of_strips
from fwclass.grid import Box, Tile, TileGrid, Window
from fwclass.ground.stage import TERRAIN
from fwclass.publish.class_raster import class_raster
from fwclass.publish.cog import STRIPE, cog
from fwclass.publish.geoparquet import write_geoparquet
from fwclass.publish.laz import without_reflectance, write_tile_laz
from fwclass.publish.palette import colours
from fwclass.publish.params import PublishParams
from fwclass.publish.shade import hillshade
from fwclass.publish.strips import write_strip_laz
from fwclass.run.inputs import PartInputs
from fwclass.schema import Table
from fwclass.store.remote_file import Location

DELIVERED = (
    "x",
    "y",
    "z",
    "strip",
    "pulse",
    "echo_number",
    "number_of_echoes",
    "gps_time",
    "intensity",
    "amplitude",
    "amplitude_sigma",
    "amplitude_db",
    "width",
    "width_sigma",
    "energy",
    "range_sigma",
    "deviation",
    "fit_flags",
    "height_above_ground",
    "ground",
    "noise",
    "classification",
    "confidence",
    "entropy",
)
"""Columns of the delivered tiles, besides the forest's features and radiometry."""

NO_BYTE = frozenset({"raster_cache", "figure_pixels"})
"""Settings that change no byte of what these parts write."""

_ECHO_BITS = 8
MAX_CELLS = 1 << 35
"""Cells of a survey-wide raster: 34 000 km² at 1 m. More are stray points, which would fill a disk with nothing."""


def crs_of(text: str | None) -> CRS | None:
    return CRS.from_user_input(text) if text else None


def delivered_tile(
    here: StageInputs, params: PublishParams, columns: Names, crs: str | None, standard_time: bool, calibrated: bool
) -> Made:
    """A tile as LAZ and as GeoParquet. Without a calibration no LAZ has `reflectance`: other programs show its no-data
    number as a value."""
    table, directory = here.rows(), here.directory
    for name in ("laz/tiles", "parquet"):
        (directory / name).mkdir(parents=True)
    path = directory / "laz" / "tiles" / f"{here.part}.laz"
    shown = table if calibrated else without_reflectance(table)
    write_tile_laz(shown, path, crs_of(crs), params, standard_time=standard_time)
    write_geoparquet(table, directory / "parquet" / f"{here.part}.parquet", crs_of(crs), params)
    return {"rows": table.rows}


def delivered_strip(here: StageInputs, params: PublishParams, codes: Mapping[str, int]) -> Made:
    """A source strip in its own order with every point's class: that of its nearest echo of the same pulse.

    `codes` maps class codes to those that the strip's point format can hold.
    """
    chunks = here.parts("decompose")
    keys, classes = _classes_of_strip(strip_of(chunks[0]), here.parts("tile"), here.inputs)
    links = Table.concat([link_table(here.inputs, c) for c in chunks])
    wanted = _keys(links)
    place = np.searchsorted(keys, wanted)
    if links.rows and (len(keys) == 0 or (keys[np.minimum(place, len(keys) - 1)] != wanted).any()):
        raise StoreError(
            "a return's echo is in no tile",
            where=here.source,
            do="run again without --tiles: a strip is delivered when all its tiles are classified",
        )
    legal = np.arange(256, dtype=np.uint8)
    for code, other in codes.items():
        legal[int(code)] = other
    output = here.directory / "laz" / "strips" / f"{here.part}.laz"
    output.parent.mkdir(parents=True)
    facts = write_strip_laz(here.file(), output, legal[classes[place]], None, params)
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


def class_block(here: StageInputs, params: PublishParams) -> Made:
    """Class of the highest echo of every cell of one block of the fixed grid."""
    window = Window.covering(here.tile.box, params.class_cell)
    points = here.inputs.inside(window.box, here.tile_size, here.columns, here.present)
    raster = class_raster(points["x"], points["y"], points["z"], points["classification"], window)
    write_rasters(here.directory, {"classes": raster}, window)
    return {"cells": int((raster > 0).sum())}


def delivered_rasters(
    here: StageInputs,
    params: PublishParams,
    crs: str | None,
    names: Mapping[str, str],
    cell: float,
    block: float,
    bounds: tuple[float, float, float, float],
) -> Made:
    """Terrain, surface, their difference, hillshade and class map of a box as cloud-optimised GeoTIFF.

    They are made in stripes from north to south: memory grows with the box's width alone. `names` of classes by code.
    """
    target = here.directory / ("rasters" if here.part == WHOLE else f"rasters/{here.part}")
    target.mkdir(parents=True)
    box, grid = Box(*bounds), TileGrid(block)
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
    system, blocks = crs_of(crs), tuple(grid.tile(key) for key in here.parts(TERRAIN.name))
    called = {int(code): name for code, name in names.items()}
    return {
        "dtm_cells": _terrain_rasters(windows[0], blocks, system, params, here.inputs, target),
        "class_cells": _class_raster(windows[1], blocks, called, system, params, here.inputs, target),
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


@dataclass(frozen=True)
class _Strip:
    """A strip with points, the tiles that hold its echoes, and its chunks."""

    key: str
    strip: Strip
    chunks: Names
    tiles: Names


def _strips(plan: Plan) -> list[_Strip]:
    held = tiles_of_strips(plan)
    return [
        _Strip(s.path.stem, s, tuple(span.key for span in spans_of(plan, s)), held.get(s.number, ()))
        for s in plan.survey.strips
        if s.point_format >= 0 and spans_of(plan, s)  # a file of pulses only, or without any points, is no strip
    ]


def _legacy_codes(plan: Plan, part: _Strip) -> Mapping[str, Any]:
    legacy = part.strip.point_format <= 5
    classes = plan.config.survey.classes
    codes = {str(c.code): c.legacy_code for c in classes if legacy and c.legacy_code is not None}
    return {"codes": codes}


def _strip_file(plan: Plan, part: _Strip) -> tuple[Location, FileDigests]:
    return part.strip.path, part.strip.digests


def columns_of_tiles(plan: Plan) -> Names:
    """The columns that a delivered tile has."""
    measured = MEASURE_RADIOMETRY.columns(plan)
    every = (*DELIVERED, *classes_written(plan), *measured, *plan.names, *plan.config.features.also)
    return tuple(dict.fromkeys(every))


def _terrain_and_classes(plan: Plan, site: Site) -> list[tuple[str, str]]:
    return [(stage, b.key) for stage in (TERRAIN.name, "class-block") for b in site.blocks]


def _box_of_cells(plan: Plan, block: Tile) -> Box:
    return Window.covering(block.box, plan.config.publish.class_cell).box


DELIVER_TILE = Stage(
    "publish-tile",
    3,
    "tile",
    "echo",
    delivered_tile,
    arguments=lambda plan: {
        "params": plan.config.publish,
        "columns": columns_of_tiles(plan),
        "crs": plan.survey.crs,
        "standard_time": plan.survey.standard_time,
        "calibrated": plan.config.radiometry.calibrates,
    },
    silent=NO_BYTE,
    own=columns_of_tiles,
    where="deliver",
)
DELIVER_STRIP = Stage(
    "publish-strip",
    1,
    "strip",
    "point",
    delivered_strip,
    parts=_strips,
    arguments=lambda plan: {"params": plan.config.publish},
    each=_legacy_codes,
    silent=NO_BYTE,
    after=("decompose", "classify", "tile"),
    needs=lambda plan, part: [
        *(("decompose", c) for c in part.chunks),
        *((stage, t) for t in part.tiles for stage in ("classify", "tile")),
    ],
    source=_strip_file,
    where="deliver",
)
MAP_CLASSES = Stage(
    "class-block",
    1,
    "block",
    "cell",
    class_block,
    parts=lambda plan: terrain_blocks(plan.layout),
    edge=lambda plan: plan.config.terrain.block,
    arguments=lambda plan: {"params": plan.config.publish},
    silent=NO_BYTE,
    reads=("z", "classification"),
    halo=0.0,
    area=_box_of_cells,
)
DELIVER_RASTERS = Stage(
    "publish-rasters",
    3,
    "survey",
    "cell",
    delivered_rasters,
    parts=lambda plan: sites(plan.layout),
    key=lambda site: site.name,
    arguments=lambda plan: {
        "params": plan.config.publish,
        "crs": plan.survey.crs,
        "names": {str(c.code): c.name for c in plan.config.survey.classes},
        "cell": plan.config.terrain.cell,
        "block": plan.config.terrain.block,
    },
    each=lambda plan, site: {"bounds": site.box.bounds},
    silent=NO_BYTE,
    after=("terrain", "class-block"),
    needs=_terrain_and_classes,
    where="deliver",
)
