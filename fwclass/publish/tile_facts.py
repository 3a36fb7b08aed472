"""What is told of a tile beside its echoes: box, counts by class, figures of the columns that a map is coloured by."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.formats.extra_bytes import published_columns
from fwclass.grid import millimetres
from fwclass.publish.copc import copc_columns
from fwclass.schema import Table

MEASURED = ("z", "height_above_ground", "confidence")
"""Columns whose figures are told."""

WORTH = 100
"""Echoes of a tile that is worth a look; one of three strays is not."""

PER_METRE = 1000
"""Places are counted in whole millimetres."""

_FIELDS = (
    ("Z", 8, "floating"),
    ("Intensity", 2, "unsigned"),
    ("ReturnNumber", 1, "unsigned"),
    ("NumberOfReturns", 1, "unsigned"),
    ("Classification", 1, "unsigned"),
    ("PointSourceId", 2, "unsigned"),
    ("GpsTime", 8, "floating"),
)
_NAMES = {"z": "Z"}


def tile_facts(table: Table) -> dict[str, Any]:
    """Facts of a tile with at least one echo, plain data.

    Returns a dict with ``points``; ``sure`` (echoes that have a confidence, and its sum, by code as text); ``bounds``
    (xmin, ymin, zmin, xmax, ymax, zmax [m]); ``classes`` (echoes by code as text); ``several`` (those of pulses with
    several, by code as text); ``confidence`` (its mean, None where no echo has one); ``times`` (first and last GPS time
    [s], None without any); ``figures`` (by name in the file: count, least, greatest, mean, standard deviation; without
    NaN).
    """
    axes = [millimetres(table[a]) for a in "xyz"]
    time = table["gps_time"][np.isfinite(table["gps_time"])] if "gps_time" in table else np.zeros(0)
    figures = {_field(name): _figures(table, name) for name in MEASURED if name in table}
    return {
        "points": table.rows,
        "bounds": [int(a.min()) / PER_METRE for a in axes] + [int(a.max()) / PER_METRE for a in axes],
        "classes": counts_by_code(table["classification"]),
        "several": counts_by_code(table["classification"][table["number_of_echoes"] > 1]),
        "sure": _sure(table),
        "confidence": (figures.get("confidence") or {}).get("mean"),
        "times": [float(time.min()), float(time.max())] if len(time) else None,
        "figures": {name: figure for name, figure in figures.items() if figure is not None},
    }


def counts_by_code(classes: NDArray[np.uint8]) -> dict[str, int]:
    """How many of `classes`, (echoes,), have which code, by its text."""
    codes, counts = np.unique(classes, return_counts=True)
    return {str(c): int(n) for c, n in zip(codes.tolist(), counts.tolist(), strict=True)}


def _sure(table: Table) -> dict[str, tuple[int, float]]:
    if "confidence" not in table:
        return {}
    sure = table["confidence"].astype(np.float64)
    codes, sure = table["classification"][known := np.isfinite(sure)], sure[known]
    count, total = np.bincount(codes, minlength=256), np.bincount(codes, weights=sure, minlength=256)
    return {str(code): (int(count[code]), float(total[code])) for code in np.flatnonzero(count).tolist()}


def _field(name: str) -> str:
    return _NAMES.get(name) or published_columns([name])[0].las


def _figures(table: Table, name: str) -> dict[str, float] | None:
    values = table[name].astype(np.float64)
    values = values[np.isfinite(values)]
    if not len(values):
        return None
    return {
        "count": len(values),
        "minimum": float(values.min()),
        "maximum": float(values.max()),
        "mean": float(values.mean()),
        "stddev": float(values.std()),
    }


def point_schema(columns: tuple[str, ...]) -> list[dict[str, Any]]:
    """Dimensions of a delivered tile with `columns`, as PDAL names and types them."""
    extras = published_columns(copc_columns(columns))
    kinds = {"u": "unsigned", "i": "signed", "f": "floating", "b": "unsigned"}
    more = []
    for col in extras:
        kind = np.dtype(col.las_dtype or col.dtype)
        more.append((col.las, 8, "floating") if col.las_scale != 1 else (col.las, kind.itemsize, kinds[kind.kind]))
    return [{"name": name, "size": size, "type": kind} for name, size, kind in (*_FIELDS, *more)]


def least_sure_first(tiles: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Keys of tiles by their mean confidence, those of fewer than `WORTH` echoes and those without any behind."""

    def place(key: str) -> tuple[bool, bool, float, str]:
        sure = tiles[key]["confidence"]
        return sure is None, tiles[key]["points"] < WORTH, sure or 0.0, key

    return sorted(tiles, key=place)


def sum_tiles(tiles: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Box, points and counts by class of several tiles."""
    bounds = np.array([t["bounds"] for t in tiles.values()])
    classes: dict[str, int] = {}
    for tile in tiles.values():
        for code, count in tile["classes"].items():
            classes[code] = classes.get(code, 0) + count
    return {
        "points": sum(t["points"] for t in tiles.values()),
        "bounds": [*bounds[:, :3].min(axis=0).tolist(), *bounds[:, 3:].max(axis=0).tolist()],
        "classes": dict(sorted(classes.items(), key=lambda item: int(item[0]))),
    }
