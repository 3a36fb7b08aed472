"""Speed of the cloth simulation filter on a synthetic 1.2 km survey, beside the PyPI package, and its seams.

    python tests/bench/bench_csf.py [--edge 1200] [--runs 1] [--no-seams]

CPU-seconds of both at the package's default parameters, by turns, in one process: medians and their ratio, how many
flags agree, and how much each adds to the peak of memory. Then the flags of `csf` and `csf+smrf`, with the parameters
of conf/base.yaml, that differ between blocks of 256 m with their halo and one block for everything.
The package is the PyPI project `cloth-simulation-filter`; where it is missing only our own figures are told.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import resource
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import yaml

os.environ.setdefault("OMP_NUM_THREADS", "1")

from fwclass.ground.blocks import ground_by_blocks
from fwclass.ground.filters import ground_points
from fwclass.ground.methods import Method
from fwclass.ground.methods.csf import csf
from fwclass.ground.methods.params import CsfParams
from fwclass.ground.params import GroundParams

try:
    import CSF
except ImportError:
    CSF = None

DENSITY = 4.1
"""Points per m2: 5.9 million on 1.2 km."""

PARAMS = CsfParams(
    cloth_resolution=1.0,
    class_threshold=0.5,
    scalar=0.0,
    rigidness=3,
    iterations=500,
    time_step=0.65,
    slope_smooth=True,
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


def timed(function: Callable[..., np.ndarray], *cloud: np.ndarray) -> tuple[float, float, np.ndarray]:
    """CPU-seconds of all threads, what the peak of memory grew by [MB], and the flags."""
    peak, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    flags = function(*cloud, PARAMS)
    seconds = time.process_time() - start
    return seconds, (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak) / 1024, flags


def beside(runs: int, truth: np.ndarray, *cloud: np.ndarray) -> None:
    """Both programs by turns, and what they say."""
    csf(*(c[:1000] for c in cloud), PARAMS)
    programs = {"fwclass": csf} if CSF is None else {"fwclass": csf, "package": package}
    results = {name: [] for name in programs}
    for _ in range(runs):
        for name, program in programs.items():
            results[name].append(timed(program, *cloud))
    seconds = {name: statistics.median(r[0] for r in several) for name, several in results.items()}
    for name, several in results.items():
        _, grown, flags = several[0]
        print(
            f"{name}  {seconds[name]:7.2f} CPU-s  {len(truth) / seconds[name]:>10,.0f} points/CPU-s  "
            f"+{grown:,.0f} MB  total error {100 * (flags != truth).mean():.3f} %",
            flush=True,
        )
    if CSF is None:
        print("cloth-simulation-filter: not installed")
        return
    same = (results["fwclass"][0][2] == results["package"][0][2]).mean()
    print(f"ratio {seconds['package'] / seconds['fwclass']:.2f}, same flags {100 * same:.3f} %", flush=True)


def seams(method: Method, truth: np.ndarray, *cloud: np.ndarray) -> None:
    """Flags that differ between blocks of the fixed grid and one block, with the parameters of conf/base.yaml."""
    base = yaml.safe_load((Path(__file__).resolve().parents[2] / "conf" / "base.yaml").read_text())["ground"]
    params = GroundParams(**{**base, "method": method})
    last = np.ones(len(truth), bool)
    start = time.process_time()
    parts = ground_by_blocks(*cloud, last, params).ground
    seconds = time.process_time() - start
    whole = ground_points(*cloud, last, params).ground
    print(
        f"{method}: {100 * (parts != whole).mean():.4f} % of flags differ between blocks (halo {params.halo:.0f} m, "
        f"{seconds:.1f} CPU-s) and one block, total error {100 * (parts != truth).mean():.3f} %",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--edge", type=float, default=1200.0)
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument("--no-seams", action="store_true")
    chosen = parser.parse_args()
    *cloud, truth = town(chosen.edge)
    print(f"{len(truth):,} points")
    beside(chosen.runs, truth, *cloud)
    if not chosen.no_seams:
        seams("csf", truth, *cloud)
        seams("csf+smrf", truth, *cloud)


if __name__ == "__main__":
    main()
