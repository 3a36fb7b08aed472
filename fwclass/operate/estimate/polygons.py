"""Tiles, their halos and the blocks of the ground as polygons: a GeoPackage with a layer of each."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fwclass.formats.gdal import offline
from fwclass.ground.stage import GROUND_FILTER
from fwclass.operate.estimate.estimate import MIB
from fwclass.operate.estimate.spread import Spread, spread_of
from fwclass.operate.estimate.whole import Plan

_SQUARE = np.dtype([("order", "u1"), ("kind", "<u4"), ("rings", "<u4"), ("corners", "<u4"), ("xy", "<f8", (5, 2))])
"""A polygon of one ring as well-known binary."""


def write_gpkg(plan: Plan, path: Path) -> None:
    """Layers ``tiles``, ``halos`` (the same, grown by what their stages read around them) and ``blocks``.

    ``echoes`` are those that evenly spread files give, ``memory_mib`` what a worker needs for the tile's features in
    the fullest case.
    """
    tiles, config = plan.tiles, plan.config
    at = np.nonzero(tiles.occupied)
    held = config.plan.stages["features"].held if "features" in config.plan.stages else 0.0
    around = tiles.grown(plan.halo)[at]
    fields = {
        "tile": keys(tiles, at),
        "echoes": np.rint(tiles.counts[at]).astype(np.int64),
        "echoes_with_halo": np.rint(around).astype(np.int64),
        "memory_mib": np.round(config.plan.base_mib + around * plan.crowding * held / MIB, 1),
    }
    _layer(path, "tiles", squares(tiles, at, 0.0), fields, plan.facts.crs)
    halo = {"tile": fields["tile"], "halo_m": np.full(len(around), plan.halo)}
    _layer(path, "halos", squares(tiles, at, plan.halo), halo, plan.facts.crs)
    blocks = spread_of(plan.counts.pieces(plan.facts), config.ground.block)
    at, reach = np.nonzero(blocks.occupied), GROUND_FILTER.halo(config.ground)
    fields = {
        "block": keys(blocks, at),
        "echoes": np.rint(blocks.counts[at]).astype(np.int64),
        "echoes_with_halo": np.rint(blocks.grown(reach)[at]).astype(np.int64),
        "halo_m": np.full(len(at[0]), reach),
    }
    _layer(path, "blocks", squares(blocks, at, 0.0), fields, plan.facts.crs)


def keys(spread: Spread, at: tuple[NDArray, ...]) -> NDArray:
    """Names of squares as the store has them."""
    cols, rows = spread.cols[at[0]].tolist(), spread.rows[at[1]].tolist()
    return np.array([f"{c}_{r}" for c, r in zip(cols, rows, strict=True)], object)


def squares(spread: Spread, at: tuple[NDArray, ...], by: float) -> NDArray:
    """Polygons of squares, grown by `by` [m], as well-known binary (n,)."""
    made = np.zeros(len(at[0]), _SQUARE)
    made["order"], made["kind"], made["rings"], made["corners"] = 1, 3, 1, 5
    for axis, numbers in enumerate((spread.cols, spread.rows)):
        low = numbers[at[axis]] * spread.size - by
        high = (numbers[at[axis]] + 1) * spread.size + by
        turns = (low, high, high, low, low) if axis == 0 else (low, low, high, high, low)
        for corner, values in enumerate(turns):
            made["xy"][:, corner, axis] = values
    text, width = made.tobytes(), _SQUARE.itemsize
    return np.array([text[k : k + width] for k in range(0, len(text), width)], object)


def _layer(path: Path, name: str, shapes: NDArray, fields: Mapping[str, NDArray], crs: str | None) -> None:
    place = str(path.absolute())
    with offline() as gdal:
        gdal.raw.write(
            place,
            shapes,
            list(fields.values()),
            np.array(list(fields), object),
            layer=name,
            driver="GPKG",
            geometry_type="Polygon",
            crs=crs,
        )
