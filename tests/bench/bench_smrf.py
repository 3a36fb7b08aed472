"""Speed of SMRF on a made survey, beside a plain scipy implementation of the paper, in one run on one core.

`python tests/bench/bench_smrf.py [width in metres, default 1200]`: points per CPU-second, medians of three runs in
turn, and their ratio; ours with Pingel's steps only (as the peer) and with the configured ones.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import yaml
from scipy import ndimage
from scipy.interpolate import NearestNDInterpolator, RegularGridInterpolator

from fwclass.ground.methods.smrf import smrf
from fwclass.ground.params import GroundParams

ROOT = Path(__file__).resolve().parents[2]
RUNS = 3
PEER_WIDTH = 300.0
"""[m] The peer gets a smaller piece: its time per point does not grow with the survey's size."""


def survey(width, density=4.1, seed=1):
    """Hills, a house in every square of 40 m and trees."""
    rng = np.random.default_rng(seed)
    n = int(density * width**2)
    u, v = rng.uniform(0, width, n).round(3), rng.uniform(0, width, n).round(3)
    z = 6.0 * np.sin(u / 150.0) * np.cos(v / 110.0) + rng.normal(0, 0.04, n)
    plots = int(width // 40) + 1
    edge, height = rng.uniform(4, 13, (2, plots, plots)), rng.uniform(3, 15, (plots, plots))
    i, j = (u // 40).astype(int), (v // 40).astype(int)
    roof = (abs(u % 40 - 20) < edge[0, i, j]) & (abs(v % 40 - 20) < edge[1, i, j])
    z[roof] += height[i, j][roof]
    tree = ~roof & (rng.random(n) < 0.25) & ((u // 7 + v // 7) % 5 < 1)
    z[tree] += rng.uniform(0.5, 10, tree.sum())
    return 512000.0 + u, 5403000.0 + v, z.round(3)


def disk(radius):
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    return x * x + y * y <= radius * radius


def nearest(surface):
    known = np.isfinite(surface)
    if known.all():
        return surface
    fill = NearestNDInterpolator(np.argwhere(known), surface[known])
    out = surface.copy()
    out[~known] = fill(np.argwhere(~known))
    return out


def plain(x, y, z, p):
    """The paper with what scipy has; holes get the nearest value."""
    c, r = ((v // p.cell).astype(int) - int(v.min() // p.cell) for v in (x, y))
    low = np.full((r.max() + 1, c.max() + 1), np.inf)
    np.minimum.at(low, (r, c), z)
    low[np.isinf(low)] = np.nan
    surface = nearest(low)
    found = -surface - ndimage.grey_opening(-surface, footprint=disk(1)) > p.low_slope * p.cell
    last = surface
    for radius in range(1, round(p.window / p.cell) + 1):
        this = ndimage.grey_opening(last, footprint=disk(radius))
        found |= last - this > p.slope * p.cell * radius
        last = this
    heights = nearest(np.where(found, np.nan, low))
    slope = np.hypot(*np.gradient(heights, p.cell))
    centres = [np.arange(n) + 0.5 for n in low.shape]
    place = np.c_[y / p.cell - y.min() // p.cell, x / p.cell - x.min() // p.cell]
    height, steep = (
        RegularGridInterpolator(centres, v, bounds_error=False, fill_value=None)(place) for v in (heights, slope)
    )
    return np.abs(z - height) <= p.threshold + p.scalar * steep


def seconds(function, *args):
    start = time.process_time()
    function(*args)
    return time.process_time() - start


def main(width):
    ground = GroundParams(**yaml.safe_load((ROOT / "conf" / "base.yaml").read_text())["ground"])
    full = ground.smrf.sized(ground.max_building_size)
    paper = full.model_copy(update={"low_first": False, "survey_edge": False, "restore_rounds": 0})
    cloud, piece = survey(width), survey(min(width, PEER_WIDTH))
    smrf(*piece, full), smrf(*piece, paper)  # compile
    rates: dict[str, list[float]] = {"paper's steps": [], "all steps": [], "plain scipy": []}
    for _ in range(RUNS):
        rates["paper's steps"].append(len(cloud[0]) / seconds(smrf, *cloud, paper))
        rates["all steps"].append(len(cloud[0]) / seconds(smrf, *cloud, full))
        rates["plain scipy"].append(len(piece[0]) / seconds(plain, *piece, paper))
    peer = np.median(rates["plain scipy"])
    print(f"{len(cloud[0]):,} points; the peer {len(piece[0]):,}")
    for name, measured in rates.items():
        rate = np.median(measured)
        print(f"{name:14} {rate / 1e6:6.2f} M points per CPU-second, {rate / peer:6.1f} x plain scipy")


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 1200.0)
