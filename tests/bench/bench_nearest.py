"""The k nearest echoes with their features against k-d trees that only look for them; one thread each.

    python tests/bench/bench_nearest.py [echoes]

Ours computes eigenvalue features, heights and shares of the 20 nearest; scipy's and pgeof's searches compute nothing,
pgeof's `compute_features` adds its eigenvalue features to given neighbours. CPU seconds of all threads, medians of the
pairs' ratios.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree

from fwclass import conf
from fwclass.features.nearest import nearest_echoes
from fwclass.grid import Tile
from fwclass.schema import Scale, Table
from fwclass.stage import Chunk

K, ROUNDS = 20, 5
BASES = (
    "linearity",
    "planarity",
    "sphericity",
    "omnivariance",
    "anisotropy",
    "eigenentropy",
    "surface_variation",
    "verticality",
    "inclination",
    "roughness",
    "height_range",
    "height_std",
    "height_above_lowest",
    "first_share",
    "last_share",
    "reach",
)


def town(n: int, per_m2: float, seed: int = 0) -> Table:
    """Slopes, pitched roofs with walls, crowns; echoes in the order of scan lines."""
    rng = np.random.default_rng(seed)
    side = np.sqrt(n / per_m2)
    x, y = rng.uniform(0, side, (2, n))
    z = 2.0 + 0.02 * x + rng.normal(0, 0.02, n)
    u, v = x % 40, y % 40
    roof = (u > 8) & (u < 24) & (v > 8) & (v < 20)
    z = np.where(roof, z + 6 + 0.3 * np.abs(v - 14), z)
    crown = ((u - 33) ** 2 + (v - 30) ** 2 < 36) & (rng.random(n) < 0.8)
    z = np.where(crown, z + rng.uniform(2, 14, n), z)
    order = np.lexsort((x, y // 0.5, x // 100))
    of = np.where(crown, rng.integers(1, 4, n), 1)
    columns = {
        "x": x + 500_000,
        "y": y + 5_400_000,
        "z": z,
        "number_of_echoes": of,
        "echo_number": rng.integers(1, of + 1),
    }
    return Table({name: np.round(values[order], 3) for name, values in columns.items()})


def seconds(work: Callable[[], object]) -> float:
    began = time.process_time()
    work()
    return time.process_time() - began


def compare(table: Table, per_m2: float) -> None:
    params = conf.section("features")
    chunk = Chunk(table, np.arange(table.rows), Tile(0, 0, 1e7))
    places = np.stack([table[a] - table[a].min() for a in "xyz"], axis=1)
    tree = cKDTree(places)
    peers: dict[str, Callable[[], object]] = {"scipy cKDTree.query": lambda: tree.query(places, k=K, workers=1)}
    try:
        import pgeof

        single = places.astype(np.float32)
        near, _ = pgeof.knn_search(single, single, K)
        offsets = (np.arange(table.rows + 1) * K).astype(np.uint32)
        flat = near.flatten().astype(np.uint32)
        peers["pgeof knn_search"] = lambda: pgeof.knn_search(single, single, K)
        peers["pgeof compute_features"] = lambda: pgeof.compute_features(single, flat, offsets, 1)
    except ImportError:
        print("pgeof is not installed: left out")

    def ours() -> object:
        return nearest_echoes(chunk, Scale("k", K), BASES, params.nearest_reach)

    ours()
    pairs = {name: [(seconds(ours), seconds(work)) for _ in range(ROUNDS)] for name, work in peers.items()}
    mine = float(np.median([own for pair in pairs.values() for own, _ in pair]))
    print(f"{table.rows:,} echoes, {per_m2:g}/m2, k = {K}, {len(BASES)} features")
    rate = f"{mine / table.rows * 1e6:7.2f} us/echo  {table.rows / mine / 1e6:.2f} M/s"
    print(f"  {'fwclass, search and features':<30} {rate}")
    for name, pair in pairs.items():
        other = float(np.median([theirs for _, theirs in pair]))
        ratio = float(np.median([theirs / own for own, theirs in pair]))
        print(f"  {name:<30} {other / table.rows * 1e6:7.2f} us/echo  ratio {ratio:.2f}")


if __name__ == "__main__":
    many = int(sys.argv[1]) if len(sys.argv) > 1 else 300_000
    for density in (4.0, 20.0):
        compare(town(many, density), density)
