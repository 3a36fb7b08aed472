"""Rasters beside a file of points: terrain, surface, their difference, relief."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.graph.ground import MAKE_TERRAIN, terrain_of_block
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.grid import Box, Window
from fwclass.ground.filters import Flags
from fwclass.ground.raster.lattice import window_over
from fwclass.ground.terrain.params import TerrainParams
from fwclass.publish.cog import write_cog
from fwclass.publish.params import PublishParams
from fwclass.publish.shade import hillshade, slope
from fwclass.read.cloud import PointCloud
from fwclass.schema import Table
from fwclass.single_file.ground.stray import describe_stray, stray_points
from fwclass.single_file.tiles import FileConfig, FileTiles
from fwclass.units import QUANTUM

NO_LIGHT = 0
"""Value of a cell of the relief without terrain; the others have 1 to 255."""

FREE_CELLS = 1 << 20
"""So many cells the tiles of a raster may always have: 1 km x 1 km at 1 m."""

CELLS_PER_POINT = 1 << 12
"""Beyond `FREE_CELLS`, so many for every point: twelve times as sparse as 0.3/m2 in cells of 0.1 m."""


def check_extent(cloud: PointCloud, shown: NDArray[np.bool_], cell: float, tile: int = 1) -> None:
    """`InputError` if rasters of `cell` [m] over the shown points would be absurdly large; it tells of stray points.

    A raster that is written costs whole tiles of `tile` x `tile` cells: one of 2 x 100 000 cells has 196 of 512 x 512.
    """
    rows = np.flatnonzero(shown)
    if not len(rows):
        return
    try:
        window = window_over(cloud.x[rows], cloud.y[rows], cell, "terrain.cell")
        whole = f", in whole tiles of {tile} x {tile}" if tile > 1 else ""
        most = max(FREE_CELLS, CELLS_PER_POINT * len(rows))
        if math.prod(-(-n // tile) * tile for n in window.shape) > most:
            raise InputError(
                "the raster would be empty but for a few cells",
                expected=f"at most {most:,} cells for {len(rows):,} points{whole}",
                got=f"{window.ncols:,} x {window.nrows:,} cells of {cell:g} m",
            )
    except InputError as fault:
        stray = describe_stray(cloud, stray_points(cloud, shown))
        larger = "take larger cells: --set terrain.cell=…"
        raise InputError(
            "the terrain's raster would be too large",
            where=cloud.path,
            expected=fault.expected,
            got=fault.got,
            do=f"{stray}: remove what is astray, or {larger}" if stray else f"{larger}, or cut the file into parts",
        ) from fault


Rasters = tuple[Mapping[str, NDArray[np.float32]], Window]
"""``dtm, dsm, roughness`` [m], float32 (rows, columns), NaN where there is none, and the cells that they cover."""


def ground_table(
    cloud: PointCloud, rows: NDArray[np.int64], ground: NDArray[np.bool_], noise: NDArray[np.bool_]
) -> Table:
    """What terrain is made of: the places of points number `rows`, and their flags of all points."""
    places = {axis: getattr(cloud, axis)[rows] for axis in "xyz"}
    return Table({**places, "ground": ground[rows], "noise": noise[rows]})


def terrain_of(cloud: PointCloud, flags: Flags, shown: NDArray[np.bool_], settings: tuple[str, ...]) -> Rasters:
    """Terrain and surface of the `shown` points, over the cells that hold them; those exactly on the upper edge of a
    cell open none beyond it."""
    points = ground_table(cloud, np.flatnonzero(shown), flags.ground, flags.noise)
    config = FileConfig(settings)
    x, y = points["x"], points["y"]
    box = Box(x.min(), y.min(), x.max() + QUANTUM, y.max() + QUANTUM)
    window = Window.of_points(box, config.terrain.cell)
    whole = {name: np.full(window.shape, np.nan, np.float32) for name in ("dtm", "dsm", "roughness")}

    def lay(here: StageInputs, params: TerrainParams) -> Result:
        heights, facts, rasters = terrain_of_block(here, params)
        own = Window.covering(here.tile.box, params.cell)
        if (common := window.common(own)) is not None:
            for name, raster in whole.items():
                raster[common.within(window)] = rasters[name][common.within(own)]
        return heights, facts

    stage = replace(MAKE_TERRAIN, function=lay)
    tiles = FileTiles(points, config, (stage,))
    for block in stage.all_parts(tiles.plan):
        if block.box.touches(window.box):
            tiles.make(stage, block.key)
    return whole, window


def write_rasters(
    cloud: PointCloud, terrain_and_window: Rasters, targets: dict[str, Path], publish: PublishParams
) -> dict[str, Any]:
    """Write the GeoTIFFs of `targets` (``dtm, dsm, ndsm, hillshade, slope, roughness``), in the file's units.

    Terrain, surface, their difference, slope and roughness are NaN where there is none.
    """
    terrain, window = terrain_and_window
    out = {}
    for name, path in targets.items():
        raster, nodata = _raster(name, terrain, window, cloud.units.z, publish)
        out[name] = write_cog(raster, window, path, cloud.crs, publish, nodata, unit=cloud.units.xy)
    return out


def _raster(
    name: str, terrain: Mapping[str, NDArray[np.float32]], window: Window, unit: float, publish: PublishParams
) -> tuple[NDArray, float]:
    """One raster and its value for no data."""
    if name == "slope":
        return slope(np.pad(terrain["dtm"], 1, constant_values=np.nan), window.cell), float("nan")
    if name != "hillshade":
        values = terrain["dsm"] - terrain["dtm"] if name == "ndsm" else terrain[name]
        return (values / np.float32(unit)).astype(np.float32), float("nan")
    light = np.rint(1.0 + 254.0 * hillshade(terrain["dtm"], window.cell, publish)).astype(np.uint8)
    return np.where(np.isfinite(terrain["dtm"]), light, np.uint8(NO_LIGHT)), NO_LIGHT
