"""Speed and memory of the features of spheres and cylinders, one thread, beside jakteristics and pgeof.

`python tests/bench/bench_features.py [--large] [--data FOLDER]`: points per CPU-second, medians of three runs in turn.
The cloud is airborne-like (`cloud`): strips, sloping ground, gabled roofs, crowns with up to three echoes.

16 features at r = 1 m: ours are those of `SIXTEEN`; jakteristics computes five of its own, pgeof eleven of the
neighbours that it searches itself. Nine radii: the 14 features of xiong2018 in one walk, jakteristics nine times with
five. Size: one constant-density cloud that grows in extent, in tiles of 250 m with a halo, as a survey is worked on.
Memory: peak of what is allocated over what was there before, less the columns, a point, and what the process grows by.
Real tiles (`--data`): whole sets, as `fwclass features` computes them.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import importlib.util
import time
import tracemalloc
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import yaml

from fwclass.conf.sets import feature_set
from fwclass.features.names import is_feature
from fwclass.features.params import FeaturesParams
from fwclass.features.spheres import spheres
from fwclass.features.stage import features
from fwclass.grid import TileGrid
from fwclass.schema import Scale, Table
from fwclass.stage import Chunk

ROOT = Path(__file__).resolve().parents[2]
PARAMS = FeaturesParams(**yaml.safe_load((ROOT / "conf" / "base.yaml").read_text())["features"])
SIXTEEN = (
    "count",
    "height_range",
    "height_std",
    "height_skewness",
    "height_kurtosis",
    "height_above_mean",
    "height_above_lowest",
    "eigenvalue_1",
    "eigenvalue_2",
    "eigenvalue_3",
    "plane_std",
    "inclination",
    "echo_ratio",
    "egi",
    "ebi",
    "evi",
)
FOURTEEN = (
    "height_range",
    "height_std",
    "height_skewness",
    "height_kurtosis",
    "roughness",
    "plane_range",
    "plane_std",
    "inclination",
    "eigenvalue_1",
    "eigenvalue_2",
    "egi",
    "ebi",
    "evi",
    "intensity_mean",
)
NINE = (40, 50, 60, 70, 80, 90, 100, 120, 150)
THEIRS = ["PCA1", "PCA2", "linearity", "planarity", "sphericity"]


def cloud(side: float, per_m2: float, seed: int = 1) -> Table:
    """Echoes over `side` × `side` metres, about `per_m2` of them a square metre."""
    rng = np.random.default_rng(seed)
    n = int(side * side * per_m2 / 1.25)
    x, y = rng.uniform(0.0, side, (2, n))
    ground = 300.0 + 0.08 * x - 0.05 * y + 6.0 * np.sin(x / 90.0) * np.cos(y / 70.0)
    u, v = x % 34.0 - 17.0, y % 34.0 - 17.0
    roof = (np.abs(u) < 8.0) & (np.abs(v) < 6.0) & ((x // 34.0 + y // 34.0) % 2 == 0)
    crown = (np.hypot(u - 12.0, v - 12.0) < 4.0) | (np.hypot(u + 12.0, v - 11.0) < 3.0)
    z = np.where(roof, ground + 6.0 + 0.7 * (6.0 - np.abs(v)), ground) + rng.normal(0.0, 0.03, n)
    order = np.lexsort((x, np.floor(y)))  # scan lines
    of = np.where(crown, rng.integers(1, 4, n), 1)[order]
    x, y, z, crown = x[order], y[order], z[order], crown[order]
    row = np.repeat(np.arange(n), of)
    number = np.arange(len(row)) - np.repeat(np.cumsum(of) - of, of) + 1
    depth = np.where(crown[row], rng.uniform(2.0, 12.0, len(row)), 0.0)
    depth = np.where((number == of[row]) & (of[row] > 1), 0.0, depth)
    return Table(
        {
            "x": (500_000.0 + x[row]).round(3),
            "y": (5_400_000.0 + y[row]).round(3),
            "z": (z[row] + depth).round(3),
            "echo_number": number,
            "number_of_echoes": of[row],
            "intensity": rng.integers(1, 2000, len(row)),
        }
    )


def chunk_of(table: Table) -> Chunk:
    return Chunk(table, np.arange(table.rows), TileGrid(1000.0).tile("0_0"))


def seconds(work) -> float:  # type: ignore[no-untyped-def]
    start = time.process_time()
    work()
    return time.process_time() - start


def ours(table: Table, asked: dict[Scale, tuple[str, ...]]) -> float:
    return seconds(lambda: spheres(chunk_of(table), asked, PARAMS))


def jakteristics(table: Table, radii: tuple[float, ...]) -> float:
    from jakteristics import compute_features

    xyz = np.stack([table[v] - table[v].min() for v in "xyz"], axis=1)
    return seconds(lambda: [compute_features(xyz, search_radius=r, num_threads=1, feature_names=THEIRS) for r in radii])


def pgeof(table: Table, radius: float) -> float:
    """Search with one tree, then its features of those neighbours."""
    import pgeof as peer

    xyz = np.stack([table[v] - table[v].min() for v in "xyz"], axis=1).astype(np.float32)

    def work() -> None:
        found, _ = peer.radius_search(xyz, xyz, radius, 200)
        held = found >= 0
        offsets = np.concatenate([[0], np.cumsum(held.sum(1))]).astype(np.uint32)
        peer.compute_features(xyz, found[held].astype(np.uint32), offsets, k_min=1)

    return seconds(work)


def compare(name: str, table: Table, asked: dict[Scale, tuple[str, ...]], peers: dict[str, object]) -> None:
    """Print our rate, the peers' and the median ratio of runs in turn."""
    ours(table.take(np.arange(min(table.rows, 2000))), asked)
    runs: dict[str, list[float]] = {"ours": [], **{peer: [] for peer in peers}}
    for _ in range(3):
        runs["ours"].append(ours(table, asked))
        for peer, work in peers.items():
            runs[peer].append(work())  # type: ignore[operator]
    for peer, taken in runs.items():
        ratio = np.median(np.array(taken) / np.array(runs["ours"]))
        print(f"{name:28s} {peer:14s} {table.rows / np.median(taken) / 1e6:8.3f} M/CPU-s   {ratio:7.1f} x", flush=True)


def peers_of(table: Table, radii: tuple[float, ...]) -> dict[str, object]:
    made: dict[str, object] = {}
    if importlib.util.find_spec("jakteristics"):
        made["jakteristics"] = lambda: jakteristics(table, radii)
    if importlib.util.find_spec("pgeof") and len(radii) == 1:
        made["pgeof"] = lambda: pgeof(table, radii[0])
    for peer in ("jakteristics", "pgeof"):
        if not importlib.util.find_spec(peer):
            print(f"{peer} is not installed and left out")
    return made


def resident(what: str) -> int:
    """Bytes of this process that ``/proc/self/status`` calls `what`."""
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(what))
    return int(line.split()[1]) * 1024


def memory(table: Table, asked: dict[Scale, tuple[str, ...]]) -> None:
    ours(table.take(np.arange(2000)), asked)
    Path("/proc/self/clear_refs").write_text("5")  # the peak starts anew
    held = resident("VmRSS")
    made = spheres(chunk_of(table), asked, PARAMS)
    grown = resident("VmHWM") - held
    columns = sum(v.nbytes for v in made.values())
    del made
    tracemalloc.start()
    made = spheres(chunk_of(table), asked, PARAMS)  # noqa: F841
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    print(
        f"memory besides columns, {table.rows / 1e6:.2f} M points: {(peak - columns) / table.rows:.0f} bytes a point, "
        f"the process grows by {(grown - columns) / table.rows:.0f}",
        flush=True,
    )


def tiles(table: Table, edge: float, halo: float) -> Iterator[Chunk]:
    """Squares of `edge` [m] with a halo; `table` is in order of y, to the metre."""
    x, y = table["x"] - 500_000.0, table["y"] - 5_400_000.0
    for south in np.arange(0.0, y[-1] + 1.0, edge):
        rows = np.arange(*np.searchsorted(np.floor(y), [np.floor(south - halo), np.ceil(south + edge + halo) + 1.0]))
        for west in np.arange(0.0, x.max() + 1e-3, edge):
            u, v = x[rows] - west, y[rows] - south
            near = rows[(u >= -halo) & (u < edge + halo) & (v >= -halo) & (v < edge + halo)]
            u, v = x[near] - west, y[near] - south
            core = np.flatnonzero((u >= 0.0) & (u < edge) & (v >= 0.0) & (v < edge))
            if len(core):
                yield Chunk(table.take(near), core, TileGrid(edge).tile("0_0"))


def size(millions: float, asked: dict[Scale, tuple[str, ...]]) -> None:
    """Cost a point of a cloud of about so many points, in tiles with halo."""
    table = cloud(np.sqrt(millions * 1e5), 10.0)
    taken, done = 0.0, 0
    for chunk in tiles(table, 250.0, 1.0):
        taken += seconds(lambda chunk=chunk: spheres(chunk, asked, PARAMS))
        done += len(chunk.core)
    assert done == table.rows, "every echo is in the core of one tile"
    print(f"{table.rows / 1e6:5.1f} M points in tiles: {taken / done * 1e9:.0f} ns a point", flush=True)


def main() -> None:
    reader = argparse.ArgumentParser(description=__doc__)
    reader.add_argument("--large", action="store_true", help="grow to 50 M points")
    reader.add_argument("--data", type=Path, help="folder with LAZ tiles")
    options = reader.parse_args()
    single, nine = {Scale("r", 100): SIXTEEN}, {Scale("r", size): FOURTEEN for size in NINE}
    wide = {
        Scale("c", size): ("height_std", "height_above_p05", "height_above_p50", "density") for size in (200, 500, 1000)
    }
    if options.data:
        real(options.data)
    for per_m2 in (4.0, 8.0, 28.0):
        table = cloud(np.sqrt(50_000 / per_m2), per_m2)
        compare(f"16 at 1 m, {per_m2:g}/m2", table, single, peers_of(table, (1.0,)))
        compare(f"nine radii, {per_m2:g}/m2", table, nine, peers_of(table, tuple(size / 100 for size in NINE)))
        compare(f"cylinders 2, 5, 10 m, {per_m2:g}/m2", table, wide, {})
    memory(cloud(200.0, 10.0), nine)
    for millions in (1, 1, 5, 20, 50) if options.large else (1, 1, 5, 20):
        size(millions, single)


def real(folder: Path) -> None:
    """Whole sets on the LAZ tiles of `folder` as one chunk, the features of neighbourhoods alone."""
    import laspy

    clouds = [laspy.read(path) for path in sorted(folder.glob("urban*.laz"))]
    names = {"x": "x", "y": "y", "z": "z", "echo_number": "return_number", "number_of_echoes": "number_of_returns"}
    columns = {ours: np.concatenate([np.asarray(c[theirs]) for c in clouds]) for ours, theirs in names.items()}
    intensity = np.concatenate([np.asarray(c.intensity) for c in clouds])
    rank = {"strip": np.zeros(len(intensity), int), "pulse": np.arange(len(intensity))}
    table = Table(columns | rank | {"intensity": intensity, "amplitude": intensity.astype(float)})
    for name in ("fan2013", "xiong2018", "default"):
        asked = [feature for feature in feature_set(name).features if is_feature(feature)]
        features(chunk_of(table.take(np.arange(2000))), asked, PARAMS)
        taken = [seconds(lambda asked=asked: features(chunk_of(table), asked, PARAMS)) for _ in range(3)]
        print(f"{name:12s} {len(asked):4d} features: {np.median(taken) / table.rows * 1e6:6.2f} us an echo", flush=True)
        spent = {}
        for kind in sorted({feature.rsplit("_", 1)[-1] for feature in asked if name == "default"}):
            part = [feature for feature in asked if feature.endswith(f"_{kind}")]
            spent[kind] = seconds(lambda part=part: features(chunk_of(table), part, PARAMS)) / table.rows * 1e6
        print(
            "  alone, with normals: " + ", ".join(f"{k} {v:.2f}" for k, v in spent.items()) if spent else "", flush=True
        )


if __name__ == "__main__":
    main()
