"""A spatially uniform sample of the echoes, the same however the survey is cut."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import millimetres, whole_millimetres
from fwclass.hashing import hash_keys
from fwclass.schema import Table, canonical_key, require
from fwclass.stage import Chunk, Computation
from fwclass.thin.follow import follow
from fwclass.thin.params import ThinParams

READS = ("x", "y", "z", "strip", "pulse", "echo_number")
_BITS = 10
"""The edge of a cell is cut into 2^10 steps for the order of the echoes in it."""

_MASKS = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def uniform(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], key: NDArray[np.uint64], params: ThinParams
) -> NDArray[np.bool_]:
    """Rows that are kept: of every cell of the global grid every (1 / rate)-th echo along a Z-order curve.

    Echoes of a cell are ordered along the curve through x, y and z [m], at one place by `key`; from a start that is
    random for every cell every (1 / rate)-th is kept. So every cell has the asked rate, to one echo, and at rates up
    to 0.5 no two echoes are kept that follow each other on the curve, as neighbours in space mostly do. Decided by
    whole cells: rows of a cell that is not all there may be decided otherwise.
    """
    if params.rate >= 1.0:
        return np.ones(len(x), bool)
    mm = whole_millimetres(params.cell, "thin.cell")
    mx, my, mz = millimetres(x), millimetres(y), millimetres(z)
    col, row = mx // mm, my // mm
    place = _interleave(_steps(mx - col * mm, mm), _steps(my - row * mm, mm), _steps(mz, mm) + (1 << 20))
    order = np.lexsort((key, place, row, col))
    first = np.ones(len(order), bool)
    first[1:] = (col[order][1:] != col[order][:-1]) | (row[order][1:] != row[order][:-1])
    begin = np.maximum.accumulate(np.where(first, np.arange(len(order)), 0))
    rank = np.arange(len(order)) - begin
    cell = (col[order].astype(np.uint64) << np.uint64(32)) ^ (row[order].astype(np.uint64) & np.uint64(0xFFFFFFFF))
    start = (hash_keys(params.seed, cell) >> np.uint64(11)).astype(np.float64) * 2.0**-53
    chosen = np.floor((rank + 1) * params.rate + start) > np.floor(rank * params.rate + start)
    kept = np.zeros(len(order), bool)
    kept[order] = chosen
    return kept


def _steps(mm: NDArray[np.int64], edge: int) -> NDArray[np.int64]:
    """Millimetres in steps of edge / 2^10."""
    return (mm << _BITS) // edge


def _interleave(*axes: NDArray[np.int64]) -> NDArray[np.uint64]:
    """Bits of three numbers below 2^21 in turn (Morton 1966)."""
    out = np.zeros(len(axes[0]), np.uint64)
    for k, axis in enumerate(axes):
        v = np.clip(axis, 0, (1 << 21) - 1).astype(np.uint64)
        for shift, mask in _MASKS:
            v = (v | (v << np.uint64(shift))) & np.uint64(mask)
        out |= v << np.uint64(k)
    return out


def covering(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    key: NDArray[np.uint64],
    kept: NDArray[np.bool_],
    reach: float,
) -> NDArray[np.bool_]:
    """`kept`, and what it takes that every row has a kept one within `reach` [m].

    Of the rows that have none, the one with the lowest `key` of every cube of a global grid; its diagonal is `reach`.
    """
    far = np.flatnonzero(~kept)
    nearest = follow((x[far], y[far], z[far]), (x[kept], y[kept], z[kept]), reach)
    far = far[nearest < 0]
    mm = max(1, round(1000 * _cube(reach)))
    cubes = np.stack([millimetres(v[far]) // mm for v in (x, y, z)])
    order = np.lexsort((key[far], *cubes))
    cubes = cubes[:, order]
    first = np.ones(len(far), bool)
    first[1:] = (cubes[:, 1:] != cubes[:, :-1]).any(axis=0)
    covered = kept.copy()
    covered[far[order[first]]] = True
    return covered


def _cube(reach: float) -> float:
    """Edge of a cube [m], in whole millimetres, whose diagonal is no longer than `reach`."""
    return math.floor(1000 * reach / math.sqrt(3.0)) / 1000


def thin(chunk: Chunk, params: ThinParams) -> Table:
    """``sampled``: features are computed for this echo, and the classifier is asked about it.

    A `uniform` sample, and as many more as it takes that every echo has one within ``params.reach``.
    Source: Xiong 2018, 3.1.
    """
    table = chunk.table
    require(table, READS, chunk.tile.key)
    key, place = canonical_key(table), (table["x"], table["y"], table["z"])
    return Table({"sampled": covering(*place, key, uniform(*place, key, params), params.reach)[chunk.core]})


def _halo(params: ThinParams) -> float:
    return params.cell + params.reach + _cube(params.reach)


THIN = Computation(name="thin", version=1, reads=READS, writes=("sampled",), halo=_halo)
