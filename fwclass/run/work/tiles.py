"""Work of the parts between tiling and training: terrain blocks, ground, labels, features."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.features.stage import FeaturesParams, features
from fwclass.grid import Tile, Window
from fwclass.ground.stage import GroundParams, ground, surface
from fwclass.label.stage import LabelParams, from_cloud, from_source
from fwclass.run.desk import TABLE, Desk
from fwclass.schema import Table
from fwclass.stage import Chunk
from fwclass.store.arrays import write_arrays
from fwclass.store.tables import write_table

RASTERS = "rasters.zarr"
MARGIN = 2
"""Cells around a tile that bilinear interpolation may touch."""

_CLOUD = ("x", "y", "z", "gps_time", "source_class")


def window_of(attributes: Mapping[str, Any]) -> Window:
    """The window that a raster part was written for."""
    return Window(float(attributes["cell"]), *(int(attributes[n]) for n in ("col", "row", "ncols", "nrows")))


def write_rasters(directory: Path, arrays: Mapping[str, NDArray], window: Window) -> None:
    """Rasters of a part with the window they cover."""
    about = {
        "cell": window.cell,
        "col": window.col,
        "row": window.row,
        "ncols": window.ncols,
        "nrows": window.nrows,
    }
    write_arrays(directory / RASTERS, arrays, about)


def mosaic(
    desk: Desk,
    stage: str,
    parts: tuple[str, ...],
    window: Window,
    names: tuple[str, ...],
    empty: Mapping[str, Any],
) -> dict[str, NDArray]:
    """Rasters of several parts laid into one window; `empty` gives the value where no part has cells."""
    out: dict[str, NDArray] = {}
    for part in parts:
        arrays, attributes = desk.arrays(stage, part, RASTERS)
        own = window_of(attributes)
        shared = window.common(own)
        for name in names:
            if name not in out:
                out[name] = np.full(window.shape, empty[name], arrays[name].dtype)
            if shared is not None:
                out[name][shared.within(window)] = arrays[name][shared.within(own)]
    return out or {n: np.full(window.shape, empty[n], np.float32) for n in names}


def terrain(
    block: Tile, tile_size: float, present: tuple[str, ...], params: GroundParams, desk: Desk, directory: Path
) -> dict[str, Any]:
    """Terrain rasters of one block of the fixed global grid."""
    box = block.box.grown(params.block_halo)
    points = desk.inside(box, tile_size, dict.fromkeys("xyz", "tile"), present)
    core = Window.covering(block.box, params.cell)
    rasters = surface(points["x"], points["y"], points["z"], core, params)
    write_rasters(directory, rasters, core)
    return {"measured": int((rasters["support"] == 0).sum()), "beyond": int((rasters["support"] == 2).sum())}


def grounded(tile: Tile, blocks: tuple[str, ...], params: GroundParams, desk: Desk, directory: Path) -> dict[str, Any]:
    """Ground flag and height above ground of a tile's echoes."""
    window = Window.covering(tile.box, params.cell, margin=MARGIN)
    rasters = mosaic(desk, "surface", blocks, window, ("dtm", "slope"), {"dtm": np.nan, "slope": np.nan})
    chunk = desk.chunk(tile, 0.0, dict.fromkeys("xyz", "tile"), (tile.key,))
    table = ground(chunk, rasters, window, params)
    write_table(directory / TABLE, table)
    return {
        "ground": int(table["ground"].sum()),
        "without_terrain": int(np.isnan(table["height_above_ground"]).sum()),
    }


def featured(
    tile: Tile, halo: float, columns: Mapping[str, str], present: tuple[str, ...], params: FeaturesParams,
    desk: Desk, directory: Path,
) -> dict[str, Any]:  # fmt: skip
    """Neighbourhood features of a tile's echoes."""
    write_table(directory / TABLE, features(desk.chunk(tile, halo, columns, present), params))
    return {}


def labelled_by_source(tile: Tile, params: LabelParams, desk: Desk, directory: Path) -> dict[str, Any]:
    """Reference classes from the source's own classification."""
    chunk = desk.chunk(tile, 0.0, {"source_class": "tile"}, (tile.key,))
    return _write_labels(from_source(chunk, params), directory)


def labelled_by_cloud(
    tile: Tile, clouds: tuple[str, ...], params: LabelParams, desk: Desk, directory: Path
) -> dict[str, Any]:
    """Reference classes from the nearest point of another cloud."""
    chunk: Chunk = desk.chunk(tile, 0.0, dict.fromkeys(("x", "y", "z", "gps_time"), "tile"), (tile.key,))
    box = tile.box.grown(params.max_distance)
    cloud = desk.inside(box, tile.size, dict.fromkeys(_CLOUD, "reference"), clouds, base="reference")
    order = np.lexsort(tuple(cloud[n] for n in ("source_class", "gps_time", "z", "y", "x")))
    return _write_labels(from_cloud(chunk, cloud.take(order), params), directory)


def _write_labels(table: Table, directory: Path) -> dict[str, Any]:
    write_table(directory / TABLE, table)
    codes, counts = np.unique(table["reference"], return_counts=True)
    return {"codes": {str(c): int(n) for c, n in zip(codes.tolist(), counts.tolist(), strict=True)}}
