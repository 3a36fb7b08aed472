"""Voxels: what came back from each, how many beams entered it, how many were spent before they could.

A beam is followed through the voxels (Amanatides and Woo 1987) from above its first echo to the terrain below its last
one. Up to the last echo it has light: it passes; behind it, it is occluded. Of a pulse's light the share of an echo's
energy stays in the echo's voxel, so that what enters a voxel is what earlier echoes have left, and its transmittance
one less what stays over what enters. All targets count as equally bright, and the last echo as the last of the light.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.grid import Window
from fwclass.schema import Table
from fwclass.voxels.params import VoxelParams
from fwclass.voxels.traversal import follow
from fwclass.waveforms import IMPLAUSIBLE

Floats = NDArray[np.float64]

ECHOES_READ = (
    *("x", "y", "z"),
    *("strip", "pulse", "echo_number"),
    *("energy", "beam_x", "beam_y", "beam_z"),
    *("fit_flags", "noise", "height_above_ground"),
)

ARRAYS = {
    "returned_energy": ("DN ns", "energy that was sent back, of waveforms freed of the system's pulse"),
    "hits": ("1", "echoes"),
    "passes": ("1", "pulses that enter with light left"),
    "occluded": ("1", "pulses whose last echo lies before"),
    "entering": ("1", "sum over the pulses of the share of light that is left where they enter"),
    "intercepted": ("1", "sum over the pulses of the share of light that comes back from here"),
    "path": ("m", "length of all beams with light left"),
}
"""Arrays of the voxels: unit and meaning."""


class Lattice(NamedTuple):
    """Voxels of `size` [m] from the column, row and layer (`col`, `row`, `layer`) of the global grid on."""

    size: float
    col: int
    row: int
    layer: int
    shape: tuple[int, int, int]


def voxels_of(
    echoes: Table, samples: Table, window: Window, params: VoxelParams, where: object
) -> tuple[dict[str, NDArray], Lattice] | None:
    """The voxels of a block; None where no echo is in it.

    Parameters
    ----------
    echoes : `ECHOES_READ` of the block and its halo, in the order of strip, pulse and echo number.
    samples : x, y, z and returned_energy of waveforms freed of the pulse.
    window : columns and rows of the block, of voxels' size.
    where : for errors.

    `InputError`: the block would have more than `params.most` voxels.
    """
    sound = ((echoes["fit_flags"] & IMPLAUSIBLE) == 0) & ~echoes["noise"] & (np.isfinite(echoes["z"]))
    echoes = echoes if sound.all() else echoes.take(sound)
    inside = window.box.contains(echoes["x"], echoes["y"])
    if not inside.any():
        return None
    lattice = _lattice(echoes["z"][inside], window, params, where)
    corner = lattice.size * np.array([lattice.col, lattice.row, lattice.layer], np.float64)
    place = np.stack([echoes[a] for a in "xyz"], axis=1) - corner
    counts = {n: np.zeros(lattice.shape, np.uint32) for n in ("hits", "passes", "occluded")}
    sums = {n: np.zeros(lattice.shape) for n in ("returned_energy", "entering", "intercepted", "path")}
    _put(counts["hits"], place, np.ones(echoes.rows), lattice)
    _beams(echoes, place, counts, sums, lattice, params)
    spots = np.stack([samples[a] for a in "xyz"], axis=1) - corner
    _put(sums["returned_energy"], spots, samples["returned_energy"], lattice)
    arrays = {**counts, **{n: v.astype(np.float32) for n, v in sums.items()}}
    return {n: arrays[n] for n in ARRAYS}, lattice


def _lattice(z: Floats, window: Window, params: VoxelParams, where: object) -> Lattice:
    low, high = (math.floor(v / params.size) for v in (z.min(), z.max()))
    shape = (high - low + 1, window.nrows, window.ncols)
    if math.prod(shape) > params.most:
        raise InputError(
            "a block has too many voxels",
            where=where,
            expected=f"at most {params.most:,} (voxels.most)",
            got=f"{shape[0]:,} x {shape[1]:,} x {shape[2]:,}, from {z.min():.1f} to {z.max():.1f} m",
            do="choose a larger voxels.size, or look for stray echoes",
        )
    return Lattice(params.size, window.col, window.row, low, shape)


def _put(into: NDArray, place: Floats, values: NDArray, lattice: Lattice) -> None:
    """Add values to the voxels that they lie in."""
    cell = np.floor(place / lattice.size).astype(np.int64)[:, ::-1]
    good = ((cell >= 0) & (cell < lattice.shape)).all(axis=1)
    flat = np.ravel_multi_index(tuple(cell[good].T), lattice.shape)
    into += np.bincount(flat, weights=values[good], minlength=into.size).reshape(lattice.shape).astype(into.dtype)


def _beams(
    echoes: Table,
    place: Floats,
    counts: dict[str, NDArray],
    sums: dict[str, Floats],
    lattice: Lattice,
    params: VoxelParams,
) -> None:
    """Lead the pulses of fitted echoes through the voxels."""
    beam = np.stack([echoes[f"beam_{a}"] for a in "xyz"], axis=1).astype(np.float64)
    known = np.isfinite(beam).all(axis=1) & (beam[:, 2] < -0.1)
    beam, place, table = beam[known], place[known], echoes.take(known)
    if len(beam) == 0:
        return
    name = (table["strip"].astype(np.int64) << 40) | table["pulse"].astype(np.int64)
    begin = np.flatnonzero(np.concatenate([[True], name[1:] != name[:-1]]))
    of = np.repeat(np.arange(len(begin)), np.diff(np.append(begin, len(name))))
    energy = np.nan_to_num(table["energy"].astype(np.float64), nan=0.0)
    total = np.bincount(of, weights=energy)[of]
    share = np.where(total > 0.0, energy / np.where(total > 0.0, total, 1.0), 0.0)
    _put(sums["intercepted"], place, share, lattice)
    along = ((place - place[begin][of]) * beam[begin][of]).sum(axis=1)
    order = np.lexsort((along, of))
    along, share = along[order], share[order]
    finish = np.append(begin[1:], len(name)) - 1
    first, way = along[begin], beam[begin]
    start = place[begin] + (first - params.above / -way[:, 2])[:, None] * way
    shift = params.above / -way[:, 2] - first
    shares = np.stack([along + shift[of], share], axis=1)
    last = shares[finish, 0]
    drop = np.nan_to_num(table["height_above_ground"].astype(np.float64), nan=0.0)[order][finish]
    end = start + (last + np.maximum(drop, 0.0) / -way[:, 2])[:, None] * way
    starts = np.append(begin, len(name)).astype(np.int64)
    follow(
        start,
        end,
        last,
        shares,
        starts,
        lattice.size,
        0.0,
        counts["passes"],
        counts["occluded"],
        sums["entering"],
        sums["path"],
    )
