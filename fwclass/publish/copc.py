"""Echoes as COPC: a LAZ file that any reader opens, and that a viewer reads in pieces, coarse ones first."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
from numpy.typing import NDArray

from fwclass.cost import counted
from fwclass.formats.copc import Cube, write_copc
from fwclass.formats.extra_bytes import extra_bytes, pack_columns, published_columns
from fwclass.formats.laz_writer import record
from fwclass.publish.files import written_whole
from fwclass.publish.laz import (
    NEEDED,
    PER_METRE,
    POINT6,
    header_block,
    header_records,
    local_millimetres,
    point_records,
)
from fwclass.publish.octree import GRID_BITS, Octree, octree
from fwclass.publish.params import PublishParams
from fwclass.schema import Table, require, split_name

PARQUET_ALONE = frozenset(
    (
        *("time", "energy", "amplitude_sigma", "width_sigma", "range_sigma", "deviation", "baseline", "noise_level"),
        *("misfit", "cross_section", "backscatter", "zc", "echo_ratio", "inclination"),
    )
)
"""Columns with a name as an extra byte that would be floating-point here, and nobody colours a map by."""


def copc_columns(names: Iterable[str]) -> tuple[str, ...]:
    """Those of `names` that become extra bytes; a user's own columns are among them."""
    return tuple(c.name for c in published_columns(names) if _base(c.name) not in PARQUET_ALONE)


def _base(name: str) -> str:
    return name if name.startswith("probability_") else split_name(name)[0]


CODES, LONGEST = 256, 15
"""Entries of the record of class names, and the bytes of a name (LAS 1.4 R15, classification lookup)."""
_UNNAMED = tuple(bytes([code]) + b"\0" * LONGEST for code in range(CODES))


@counted("writing")
def write_tile_copc(
    table: Table,
    path: Path,
    crs: pyproj.CRS | None,
    params: PublishParams,
    names: Mapping[int, str],
    *,
    standard_time: bool = False,
) -> dict[str, Any]:
    """Write echoes as COPC 1.0; the same echoes give the same bytes, in whatever order they come.

    Point format, coordinates and extra bytes are those of `laz.write_tile_laz`, of `copc_columns` alone. Which
    level an echo is in follows from a hash of its strip, pulse and number.

    `table`: at least `laz.NEEDED`. `crs`: None leaves the file without one. `names`: of classes by code, for the file's
    record of class names; longer ones than 15 bytes are cut.

    Returns a dict with ``path, points, nodes, extra_bytes, beyond, clipped, without_time, bytes``, as `write_tile_laz`.

    `InputError`: a column is missing, or coordinates do not fit the format's 32 bits.
    """
    require(table, NEEDED, path)
    extras = extra_bytes(published_columns(copc_columns(table)), table)
    offset, units = local_millimetres(table, path)
    points, counts = point_records(table, units)
    tree = octree(np.stack(units, axis=1), table, params.copc_leaf)
    rows = points.view(np.uint8).reshape(len(points), POINT6.itemsize)
    rows = np.concatenate([rows, pack_columns(extras, table)], axis=1) if extras else rows
    records = [*header_records(extras, crs), class_lookup(names)]
    block = header_block(extras, points, offset, standard_time)
    with written_whole(path) as beside, beside.open("w+b") as file:
        cube = _cube(tree, offset, points["gps_time"])
        size = write_copc(file, block, records, rows, tree.order, tree.keys, tree.counts, cube)
    return {
        "path": str(path),
        "points": table.rows,
        "nodes": len(tree.keys),
        "extra_bytes": [e.las for e in extras],
        "beyond": {e.las: e.beyond for e in extras if e.beyond},
        "bytes": size,
        **counts,
    }


def _cube(tree: Octree, offset: NDArray[np.int64], times: NDArray[np.float64]) -> Cube:
    half = (1 << tree.bits) / 2 / PER_METRE
    x, y, z = ((2 * (tree.low + offset) - 1 + (1 << tree.bits)) / (2 * PER_METRE)).tolist()
    first, last = (float(times.min()), float(times.max())) if len(times) else (0.0, 0.0)
    return Cube((x, y, z), half, 2 * half / (1 << GRID_BITS), (first, last))


def _plain(name: str) -> bytes:
    """A class's name without accents, as the record has ASCII; as it is where nothing of it would be left."""
    folded = unicodedata.normalize("NFKD", name.replace("ß", "ss")).encode("ascii", "ignore")
    return folded if folded.strip() or not name else name.encode()


def class_lookup(names: Mapping[int, str]) -> bytes:
    """The record that names the classes of a file."""
    entries = list(_UNNAMED)
    for code in names.keys() & set(range(CODES)):
        name = _plain(names[code])[:LONGEST].decode(errors="ignore").encode()
        entries[code] = bytes([code]) + name.ljust(LONGEST, b"\0")
    return record("LASF_Spec", 0, "classification lookup", b"".join(entries))
