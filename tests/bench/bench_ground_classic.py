"""Noise removal and the slope, PMF and moving surface filters on a survey of 1.2 km: million points per CPU second.

    python tests/bench/bench_ground_classic.py [--points 5900000] [--width 1200]

CPU time of one thread, so that a busy machine gives the same figures; compilation is not counted.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import yaml

from fwclass.ground.filters import FILTERS
from fwclass.ground.methods.noise import noise
from fwclass.ground.params import GroundParams

METHODS = ("slope", "pmf", "moving-surface")
PLOT = 40.0
"""Edge of a building plot [m]."""


def town(n: int, width: float, seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Hills with houses on 40 % of the plots and a tree on each of the others: x, y, z and which points are terrain."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, width, (2, n))
    z = 300 + 0.08 * x - 0.05 * y + 6 * np.sin(x / 90) * np.cos(y / 70) + rng.normal(0, 0.03, n)
    col, row = (x // PLOT).astype(int), (y // PLOT).astype(int)
    u, v = x - (col + 0.5) * PLOT, y - (row + 0.5) * PLOT
    plots = (int(width // PLOT) + 1,) * 2
    built = rng.random(plots)[col, row] < 0.4
    half_u, half_v = (rng.uniform(5, 14, plots)[col, row] for _ in range(2))
    house = built & (abs(u) < half_u) & (abs(v) < half_v)
    roof = 310 + (0.08 * (col + 0.5) - 0.05 * (row + 0.5)) * PLOT + rng.uniform(3, 15, plots)[col, row]
    tree = ~built & (np.hypot(u, v) < 7) & (rng.random(n) < 0.6)
    z = np.where(house, roof, np.where(tree, z + rng.uniform(0.5, 18, n), z))
    return 512_000 + np.round(x, 3), 5_403_000 + np.round(y, 3), np.round(z, 3), ~house & ~tree


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=5_900_000)
    parser.add_argument("--width", type=float, default=1200.0)
    asked = parser.parse_args()
    base = yaml.safe_load((Path(__file__).resolve().parents[2] / "conf" / "base.yaml").read_text())["ground"]
    x, y, z, terrain = town(asked.points, asked.width)
    few = slice(0, 20_000)
    works = {"noise": lambda *p: noise(*p, np.ones(len(p[0]), bool), GroundParams(**base).noise)}
    for method in METHODS:
        own = GroundParams(**{**base, "method": method}).of(method)
        works[method] = lambda *p, own=own, method=method: FILTERS[method](*p, own)
    print(f"{'':<16}{'M points/s':>11}{'s':>8}   flagged of terrain, of others [%]")
    for name, work in works.items():
        work(x[few], y[few], z[few])
        start = time.thread_time()
        found = work(x, y, z)
        seconds = time.thread_time() - start
        shares = 100 * found[terrain].mean(), 100 * found[~terrain].mean()
        print(f"{name:<16}{len(x) / seconds / 1e6:>11.2f}{seconds:>8.2f}   {shares[0]:.3f}, {shares[1]:.3f}")


if __name__ == "__main__":
    main()
