"""Rasters beside a file of points: terrain, surface, relief."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass import conf
from fwclass.grid import Window
from fwclass.ground.filters import Flags
from fwclass.ground.terrain.blocks import terrain_by_blocks
from fwclass.ground.terrain.terrain import Terrain
from fwclass.publish.cog import write_cog
from fwclass.publish.params import PublishParams
from fwclass.publish.shade import hillshade
from fwclass.read.cloud import PointCloud

NO_LIGHT = 0
"""Value of a cell of the relief without terrain; the others have 1 to 255."""


def write_rasters(
    cloud: PointCloud,
    flags: Flags,
    shown: NDArray[np.bool_],
    targets: dict[str, Path],
    settings: tuple[str, ...],
    publish: PublishParams,
) -> dict[str, Any]:
    """Write the GeoTIFFs of `targets` (``dtm``, ``dsm``, ``hillshade``), in the file's units; what was written.

    Only `shown` points count. Terrain and surface are NaN where there is none.
    """
    rows = np.flatnonzero(shown)
    params = conf.section("terrain", settings)
    made, window = terrain_by_blocks(
        cloud.x[rows], cloud.y[rows], cloud.z[rows], flags.ground[rows], flags.noise[rows], params
    )
    out = {}
    for name, path in targets.items():
        raster, nodata = _raster(name, made, window, cloud.units.z, publish)
        out[name] = write_cog(raster, window, path, cloud.crs, publish, nodata, unit=cloud.units.xy)
    return out


def _raster(name: str, made: Terrain, window: Window, unit: float, publish: PublishParams) -> tuple[NDArray, float]:
    """One raster and its value for no data."""
    if name != "hillshade":
        return (getattr(made, name) / np.float32(unit)).astype(np.float32), float("nan")
    light = np.rint(1.0 + 254.0 * hillshade(made.dtm, window.cell, publish)).astype(np.uint8)
    return np.where(np.isfinite(made.dtm), light, np.uint8(NO_LIGHT)), NO_LIGHT
