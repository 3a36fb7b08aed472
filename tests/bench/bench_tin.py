"""Triangulation, interpolation and TIN filters beside startinpy and scipy: ``python tests/bench/bench_tin.py``.

All on one thread, CPU seconds, medians; peers in the same run. What is not installed is said so.
"""

from __future__ import annotations

import argparse
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import yaml
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay

from fwclass.grid import Window
from fwclass.ground.filters import ground_points
from fwclass.ground.params import GroundParams
from fwclass.ground.tin.delaunay import spatial_order
from fwclass.ground.tin.tin import tin_heights, tin_of, tin_raster

ROOT = Path(__file__).resolve().parents[2]
SURVEY = 1200.0
DENSITY = 4.1


def town(size, seed=1, density=DENSITY):
    """Points of a hilly town: (x, y, z, is ground); houses on a grid of blocks, trees, cars, ranges with noise."""
    r = np.random.default_rng(seed)
    n = round(size * size * density)
    x, y = r.uniform(0, size, (2, n))
    ground = 12 * np.sin(x / 90) * np.cos(y / 70) + 3 * np.sin(x / 17 + y / 23) + r.normal(0, 0.03, n)
    col, row = np.floor(x / 30), np.floor(y / 24)
    side = np.random.default_rng(seed + 1).uniform(8, 26, (2, 4096))
    kind = (col * 31 + row * 17).astype(int) % 4096
    inside = (x - 30 * col < side[0, kind]) & (y - 24 * row < side[1, kind] * 0.75) & (kind % 5 > 0)
    base = 12 * np.sin((30 * col + 9) / 90) * np.cos((24 * row + 7) / 70) + 3 * np.sin(col + row)
    z = np.where(inside, np.maximum(base, ground - 1) + 5 + kind % 7, ground)
    green = ~inside & (r.uniform(size=n) < 0.15)
    z[green] += r.gamma(1.2, 3.0, green.sum())
    clear = ~inside & ~green
    return *(np.round(v, 3) for v in (x + 512_000, y + 5_403_000, z)), clear


def timed(work, repeats):
    """Median CPU seconds of this process, and what the work gave."""
    seconds = []
    for _ in range(repeats):
        start = time.process_time()
        made = work()
        seconds.append(time.process_time() - start)
    return float(np.median(seconds)), made


def line(name, seconds, count, ours=None):
    ratio = "" if ours is None else f"   ours is {seconds / ours:5.1f} x as fast"
    print(f"{name:36} {seconds:8.2f} s  {count / seconds / 1e6:7.3f} M/s{ratio}", flush=True)


def triangulation(n, repeats):
    """`n` random points, in metres for the peers too; sorted along Morton's curve for startinpy, as it should be."""
    r = np.random.default_rng(3)
    x, y = np.round(r.uniform(0, np.sqrt(n / DENSITY), (2, n)), 3)
    z, (qx, qy) = np.sin(x / 30), r.uniform(1, np.sqrt(n / DENSITY) - 1, (2, n))
    ours, tin = timed(lambda: tin_of(x, y, z), repeats)
    asked, _ = timed(lambda: tin_heights(tin, qx, qy), repeats)
    line(f"triangulate {n:,} (with sorting)", ours, n)
    line("interpolate as many", asked, n)
    window = Window(1.0, 0, 0, int(x.max()), int(y.max()))
    seconds, raster = timed(lambda: tin_raster(tin, window), repeats)
    line("raster of 1 m", seconds, raster.size)
    if find_spec("startinpy"):
        import startinpy

        def insert(rows):
            dt = startinpy.DT()
            dt.insert(np.c_[x, y, z][rows], insertionstrategy="AsIs")
            return dt

        order = spatial_order(*np.rint(np.array([x, y]) * 1000).astype(np.int64))
        seconds, dt = timed(lambda: insert(order), repeats)
        line("startinpy, sorted before", seconds, n, ours)
        rows = spatial_order(*np.rint(np.array([qx, qy]) * 1000).astype(np.int64))
        q = np.c_[qx, qy][rows]
        seconds, _ = timed(lambda: dt.interpolate({"method": "TIN"}, q, strict=False), repeats)
        line("startinpy, interpolate, sorted before", seconds, n, asked)
    else:
        print("startinpy: not installed")
    few = min(n, 100_000)
    seconds, made = timed(lambda: Delaunay(np.c_[x, y][:few]), 1)
    line(f"scipy Delaunay of {few:,}", seconds, few, ours * few / n)
    linear = LinearNDInterpolator(made, z[:few])
    near = spatial_order(*np.rint(np.array([qx[:few], qy[:few]]) * 1000).astype(np.int64))
    seconds, _ = timed(lambda: linear(qx[:few][near], qy[:few][near]), 1)
    line(f"scipy interpolates {few:,}, sorted before", seconds, few, asked * few / n)


def filters(size):
    """PTD and IPTD of a whole survey at once."""
    params = GroundParams(**yaml.safe_load((ROOT / "conf" / "base.yaml").read_text())["ground"])
    x, y, z, clear = town(size)
    last = np.ones(len(x), bool)
    for method in ("ptd", "iptd"):
        asked = params.model_copy(update={"method": method})
        few = slice(0, None, len(x) // 1000)
        ground_points(x[few], y[few], z[few], last[few], asked)
        seconds, flags = timed(lambda asked=asked: ground_points(x, y, z, last, asked), 1)
        line(f"{method} of {len(x):,} with noise removal", seconds, len(x))
        lost, taken = 100 * (~flags.ground[clear]).mean(), 100 * flags.ground[~clear].mean()
        print(f"{'':36} type I {lost:.2f} %, type II {taken:.2f} %")


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--points", type=int, default=1_000_000)
    asked.add_argument("--size", type=float, default=SURVEY, help="edge of the survey that is filtered [m]")
    asked.add_argument("--repeats", type=int, default=3)
    given = asked.parse_args()
    tin_heights(tin_of(*np.random.default_rng(0).uniform(0, 9, (3, 99))), np.arange(9.0), np.arange(9.0))
    triangulation(given.points, given.repeats)
    filters(given.size)


if __name__ == "__main__":
    main()
