"""Speed of the cloth simulation filter on a synthetic 1.2 km survey, beside the PyPI package.

    python tests/bench/bench_csf.py [--edge 1200] [--runs 3] [--seams]

Points per CPU-second of both at the package's default parameters, by turns, in one process; medians and their ratio.
With `--seams` also the flags that differ between blocks of 256 m with 64 m of halo and one block for everything.
The package is the PyPI project `cloth-simulation-filter`; where it is missing only our own figure is told.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import statistics
import sys
import time
from collections.abc import Callable, Iterator

import numpy as np

os.environ.setdefault("OMP_NUM_THREADS", "1")

from fwclass.ground.blocks import blocks_of
from fwclass.ground.methods.csf import csf
from fwclass.ground.params import CsfParams

try:
    import CSF
except ImportError:
    CSF = None

DENSITY = 4.1
"""Points per m2: 5.9 million on 1.2 km."""

PARAMS = CsfParams(
    cloth_resolution=1.0, class_threshold=0.5, rigidness=3, iterations=500, time_step=0.65, slope_smooth=True
)


def town(edge: float, density: float = DENSITY, seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """x, y, z [m] in whole millimetres of hills, houses and trees, and which points are ground."""
    rng = np.random.default_rng(seed)
    n = int(edge * edge * density)
    x, y = rng.uniform(0, edge, n), rng.uniform(0, edge, n)
    z = 25.0 * np.sin(x / 170.0) * np.cos(y / 210.0) + 4.0 * np.sin(x / 41.0 + y / 53.0) + rng.normal(0, 0.03, n)
    ground = np.ones(n, bool)
    _houses(rng, edge, x, y, z, ground)
    _trees(rng, edge, x, y, z, ground)
    return np.round(x + 512_000.0, 3), np.round(y + 5_403_000.0, 3), np.round(z + 300.0, 3), ground


def _houses(rng, edge, x, y, z, ground) -> None:
    """One house on a lot of 40 m at most, 8 to 24 m long, turned, with a flat roof 4 to 12 m high."""
    lots = int(edge // 40)
    built = rng.random((lots + 1, lots + 1)) < 0.6
    a, b = rng.uniform(4, 12, built.shape), rng.uniform(4, 9, built.shape)
    turn, height = rng.uniform(0, np.pi, built.shape), rng.uniform(4, 12, built.shape)
    i, j = (x // 40).astype(int), (y // 40).astype(int)
    u, v = x - 40 * i - 20, y - 40 * j - 20
    c, s = np.cos(turn[i, j]), np.sin(turn[i, j])
    roof = built[i, j] & (np.abs(c * u + s * v) < a[i, j]) & (np.abs(c * v - s * u) < b[i, j])
    z[roof] += height[i, j][roof]
    ground &= ~roof


def _trees(rng, edge, x, y, z, ground) -> None:
    """Crowns of 2 to 5 m radius in every other cell of 15 m; two thirds of their echoes are above the ground."""
    cells = int(edge // 15) + 1
    radius, height = rng.uniform(2, 5, (cells, cells)), rng.uniform(5, 20, (cells, cells))
    there = rng.random((cells, cells)) < 0.5
    i, j = (x // 15).astype(int), (y // 15).astype(int)
    far = np.hypot(x - 15 * i - 7.5, y - 15 * j - 7.5)
    crown = there[i, j] & (far < radius[i, j]) & ground & (rng.random(len(x)) < 2 / 3)
    z[crown] += (height[i, j] * rng.uniform(0.3, 1.0, len(x)))[crown]
    ground &= ~crown


@contextlib.contextmanager
def silenced() -> Iterator[None]:
    """Nothing that compiled code writes reaches the terminal."""
    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def package(x: np.ndarray, y: np.ndarray, z: np.ndarray, params: CsfParams) -> np.ndarray:
    """Flags of the PyPI package at the same parameters."""
    with silenced():
        run = CSF.CSF()
        run.params.bSloopSmooth = params.slope_smooth
        run.params.cloth_resolution = params.cloth_resolution
        run.params.rigidness = params.rigidness
        run.params.time_step = params.time_step
        run.params.class_threshold = params.class_threshold
        run.params.interations = params.iterations
        run.setPointCloud(np.c_[x, y, z])
        ground, other = CSF.VecInt(), CSF.VecInt()
        run.do_filtering(ground, other, False)
    flags = np.zeros(len(x), bool)
    flags[np.array(ground, int)] = True
    return flags


def timed(function: Callable[..., np.ndarray], *cloud: np.ndarray) -> tuple[float, np.ndarray]:
    """CPU-seconds of all threads, and the flags."""
    start = time.process_time()
    flags = function(*cloud, PARAMS)
    return time.process_time() - start, flags


def seams(x: np.ndarray, y: np.ndarray, z: np.ndarray, whole: np.ndarray) -> float:
    """Share of flags that differ between blocks of 256 m with 64 m of halo and one block."""
    flags = np.zeros(len(x), bool)
    for _, rows, own in blocks_of(x, y, 256.0, 64.0):
        flags[rows[own]] = csf(x[rows], y[rows], z[rows], PARAMS)[own]
    return float((flags != whole).mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--edge", type=float, default=1200.0)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--seams", action="store_true")
    chosen = parser.parse_args()
    *cloud, truth = town(chosen.edge)
    csf(*(c[:1000] for c in cloud), PARAMS)
    ours, theirs = [], []
    for _ in range(chosen.runs):
        seconds, flags = timed(csf, *cloud)
        ours.append(len(truth) / seconds)
        if CSF is not None:
            seconds, others = timed(package, *cloud)
            theirs.append(len(truth) / seconds)
    print(f"{len(truth):,} points, medians of {chosen.runs} runs, points per CPU-second")
    print(f"fwclass  {statistics.median(ours):>12,.0f}  total error {100 * (flags != truth).mean():.3f} %")
    if CSF is None:
        print("cloth-simulation-filter: not installed")
    else:
        ratio = statistics.median(ours) / statistics.median(theirs)
        print(f"package  {statistics.median(theirs):>12,.0f}  total error {100 * (others != truth).mean():.3f} %")
        print(f"ratio {ratio:.2f}, same flags {100 * (flags == others).mean():.3f} %")
    if chosen.seams:
        print(f"flags that differ between blocks and one block: {100 * seams(*cloud, flags):.4f} %")


if __name__ == "__main__":
    main()
