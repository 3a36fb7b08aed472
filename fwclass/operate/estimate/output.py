"""Where a forecast is written: ``plan/`` in the run directory, with tiles, halos and blocks as polygons."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import ConfigError
from fwclass.formats.gdal import write_shapes
from fwclass.formats.wkb import box_wkb
from fwclass.graph.ground_auto import halo_of
from fwclass.grid import Box
from fwclass.operate.estimate.forecast import Forecast, as_json
from fwclass.operate.estimate.picture import plan_picture
from fwclass.operate.estimate.spread import Spread, spread_of
from fwclass.paths import below
from fwclass.store.atomic import move_into_place, write_json
from fwclass.temporary import temporary_directory
from fwclass.units import MIB

NAMES = ("tiles.gpkg", "plan.png", "plan.json")


def check_free(root: Path, overwrite: bool) -> None:
    """`ConfigError` where an earlier forecast lies and may not be replaced."""
    there = [root / "plan" / n for n in NAMES if (root / "plan" / n).exists()]
    if there and not overwrite:
        raise ConfigError(
            "there is a plan already",
            where=there[0].parent,
            got=", ".join(p.name for p in there),
            do="--overwrite, or another --out",
        )


def write_plan(forecast: Forecast, root: Path) -> tuple[Path, ...]:
    """Write the polygons, the picture and the numbers; each appears whole. Return their paths."""
    target = below(root, f"plan/{NAMES[0]}").parent
    paths = tuple(target / n for n in NAMES)
    target.mkdir(parents=True, exist_ok=True)
    with temporary_directory("plan", target) as directory:
        write_gpkg(forecast, directory / NAMES[0])
        (directory / NAMES[1]).write_bytes(plan_picture(forecast))
        write_json(directory / NAMES[2], as_json(forecast, paths))
        for path in paths:
            move_into_place(directory / path.name, path)
    return paths


def write_gpkg(forecast: Forecast, path: Path) -> None:
    """Layers ``tiles``, ``halos`` (the same, grown by what their stages read around them) and ``blocks``.

    ``echoes`` are those that evenly spread files give, ``memory_mib`` what a worker needs for the tile's features in
    the fullest case.
    """
    tiles, config = forecast.tiles, forecast.config
    at = np.nonzero(tiles.occupied)
    held = config.plan.stages["features"].held if "features" in config.plan.stages else 0.0
    around = tiles.grown(forecast.halo)[at]
    fields = {
        "tile": keys(tiles, at),
        "echoes": np.rint(tiles.counts[at]).astype(np.int64),
        "echoes_with_halo": np.rint(around).astype(np.int64),
        "memory_mib": np.round(config.plan.base_mib + around * forecast.crowding * held / MIB, 1),
    }
    write_shapes(path, "tiles", squares(tiles, at, 0.0), fields, forecast.facts.crs)
    halo = {"tile": fields["tile"], "halo_m": np.full(len(around), forecast.halo)}
    write_shapes(path, "halos", squares(tiles, at, forecast.halo), halo, forecast.facts.crs)
    blocks = spread_of(forecast.counts.pieces(forecast.facts), config.ground.block)
    at, reach = np.nonzero(blocks.occupied), halo_of(forecast.begun)
    fields = {
        "block": keys(blocks, at),
        "echoes": np.rint(blocks.counts[at]).astype(np.int64),
        "echoes_with_halo": np.rint(blocks.grown(reach)[at]).astype(np.int64),
        "halo_m": np.full(len(at[0]), reach),
    }
    write_shapes(path, "blocks", squares(blocks, at, 0.0), fields, forecast.facts.crs)


def keys(spread: Spread, at: tuple[NDArray, ...]) -> NDArray:
    """Names of squares as the store has them."""
    cols, rows = spread.cols[at[0]].tolist(), spread.rows[at[1]].tolist()
    return np.array([f"{c}_{r}" for c, r in zip(cols, rows, strict=True)], object)


def squares(spread: Spread, at: tuple[NDArray, ...], by: float) -> list[bytes]:
    """Polygons of squares, grown by `by` [m], as well-known binary."""
    cols, rows = spread.cols[at[0]], spread.rows[at[1]]
    low = (cols * spread.size - by, rows * spread.size - by)
    high = ((cols + 1) * spread.size + by, (rows + 1) * spread.size + by)
    return box_wkb([Box(*bounds) for bounds in np.stack([*low, *high], axis=1).tolist()])
