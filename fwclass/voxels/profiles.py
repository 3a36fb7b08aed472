"""Vertical profiles: the waveforms of a cell together, by height above ground, and what they say of the plants.

Figures are those of large-footprint lidar: the height below which a share of the energy lies (relative heights, Dubayah
and others 2020), and the cover, from the energies of plants and ground (Ni-Meister, Jupp and Dubayah 2001).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Window
from fwclass.schema import Table
from fwclass.voxels.params import ProfileParams

Floats = NDArray[np.float64]

SHARES = (25, 50, 75, 90, 95, 98, 100)
"""Per cent of the energy of which the heights are told."""

ARRAYS = {
    "profile": ("1/m", "share of the energy in a metre of height"),
    "relative_height": ("m", "height above ground below which a share of the energy lies"),
    "cover": ("1", "share of the ground that plants hide from above"),
    "ground_share": ("1", "share of the energy that comes from near the terrain"),
    "pulses": ("1", "pulses whose waveforms are taken together"),
    "energy": ("DN ns", "energy of all samples"),
}
"""Arrays of the profiles: unit and meaning."""


def profiles_of(samples: Table, above: Floats, window: Window, params: ProfileParams) -> dict[str, NDArray]:
    """The profiles of the cells of a window.

    Parameters
    ----------
    samples : x, y, strip, pulse, share and returned_energy of waveforms freed of the pulse.
    above : height of every sample above the terrain [m]; NaN: it does not count.
    window : the cells, row 0 in the south.

    Returns
    -------
    `ARRAYS`: ``profile`` (bins, rows, columns), ``relative_height`` (shares, rows, columns), others (rows, columns).
    Every pulse counts alike, whatever its energy. A cell of fewer than `params.least` pulses has NaN, and 0 pulses.
    """
    ny, nx = window.shape
    col, row = (np.floor(samples[a] / window.cell).astype(np.int64) for a in "xy")
    col, row = col - window.col, row - window.row
    level = np.floor((np.nan_to_num(above, nan=np.inf) - params.lowest) / params.bin)
    level = np.where(np.isfinite(level), level, -1.0)
    good = (col >= 0) & (col < nx) & (row >= 0) & (row < ny) & (level >= 0.0) & (level < params.bins)
    cell, level = (row * nx + col)[good], level[good].astype(np.int64)
    share, energy = samples["share"][good].astype(np.float64), samples["returned_energy"][good].astype(np.float64)
    size = ny * nx
    flat = np.bincount(cell * params.bins + level, weights=share, minlength=size * params.bins)
    sums = np.asarray(flat, np.float64).reshape(size, params.bins)
    name = (samples["strip"].astype(np.int64) << 32) | samples["pulse"].astype(np.int64)
    _, first = np.unique(np.stack([cell, name[good]], axis=1), axis=0, return_index=True)
    pulses = np.bincount(cell[first], minlength=size)
    few = pulses < params.least
    heights, cover, ground = figures(sums, params)
    whole = sums.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        density = sums / whole[:, None] / params.bin
    arrays = {
        "profile": density.T,
        "relative_height": heights.T,
        "cover": cover,
        "ground_share": ground,
        "energy": np.bincount(cell, weights=energy, minlength=size),
    }
    grids: dict[str, NDArray] = {
        n: np.where(few, np.nan, v).astype(np.float32).reshape(*v.shape[:-1], ny, nx) for n, v in arrays.items()
    }
    grids["pulses"] = np.where(few, 0, pulses).astype(np.uint32).reshape(ny, nx)
    return {n: grids[n] for n in ARRAYS}


def figures(sums: Floats, params: ProfileParams) -> tuple[Floats, Floats, Floats]:
    """Relative heights (n, shares) [m], cover and ground's share (n,) of profiles (n, bins); NaN without energy."""
    edges = params.lowest + params.bin * np.arange(params.bins + 1)
    whole = sums.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        below = np.concatenate([np.zeros((len(sums), 1)), np.cumsum(sums, axis=1)], axis=1) / whole[:, None]
        heights = np.full((len(sums), len(SHARES)), np.nan)
        for k in np.flatnonzero(whole > 0.0):
            for m, share in enumerate(SHARES):
                at = int(np.searchsorted(below[k], min(share / 100.0, below[k, -1]) - 1e-12))
                low, high = below[k, at - 1], below[k, at]
                part = (share / 100.0 - low) / (high - low) if high > low else 1.0
                heights[k, m] = edges[at - 1] + min(part, 1.0) * params.bin
        middle = 0.5 * (edges[1:] + edges[:-1])
        ground = sums[:, np.abs(middle) <= params.ground].sum(axis=1) + sums[:, middle < -params.ground].sum(axis=1)
        plants = (whole - ground) / params.ratio
        return heights, plants / (plants + ground), ground / whole
