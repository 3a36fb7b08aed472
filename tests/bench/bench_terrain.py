"""Terrain of a made town: speed, error against the truth, seams between blocks, and what thinning does.

    python tests/bench/bench_terrain.py [--size 768] [--density 4] [--clouds FILE.laz ...]

Seconds are processor time of one thread. With `--clouds` ground echoes (class 2) are held out of real clouds and
predicted from the others, thinned by different cells.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import laspy
import numpy as np
import yaml
from scipy.interpolate import LinearNDInterpolator

from fwclass.grid import TileGrid, Window
from fwclass.ground.raster.bilinear import bilinear
from fwclass.ground.raster.fill import fill_gaps
from fwclass.ground.raster.lattice import lowest, window_over
from fwclass.ground.terrain.blocks import terrain_by_blocks
from fwclass.ground.terrain.facets import facet_heights, facets_of
from fwclass.ground.terrain.params import TerrainParams
from fwclass.ground.terrain.terrain import terrain
from fwclass.ground.terrain.thinning import thin_points
from fwclass.ground.tin.tin import tin_of

X0, Y0 = 512000.0, 5403136.0
BASE = Path(__file__).resolve().parents[2] / "conf" / "base.yaml"


def hills(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    u, v = x - X0, y - Y0
    return 200 + 12 * np.sin(u / 90) * np.cos(v / 70) + 3 * np.sin(u / 23 + 1) * np.sin(v / 31) + 0.03 * u


def town(size: float, density: float, noise: float, halls: int) -> tuple[np.ndarray, ...]:
    """x, y, z, ground, true height above ground; a third of the area is houses, trees and halls of up to 90 m."""
    rng = np.random.default_rng(0)
    n = int(density * size * size)
    x, y = (low + rng.integers(0, int(size * 1000), n) / 1000 for low in (X0, Y0))
    order = np.lexsort((x, np.floor(y)))  # by lines, as a scanner has it
    x, y = x[order], y[order]
    floor = hills(x, y)
    top, ground = floor.copy(), np.ones(n, bool)
    houses = int(size * size / 1200)
    edges = np.r_[rng.uniform(50, 90, (halls, 2)), rng.uniform(8, 20, (houses, 2))]
    for (mid_x, mid_y), (wide, deep) in zip(rng.uniform(0, size, (halls + houses, 2)), edges, strict=True):
        roof = (np.abs(x - X0 - mid_x) < wide / 2) & (np.abs(y - Y0 - mid_y) < deep / 2)
        top[roof], ground[roof] = hills(X0 + mid_x, Y0 + mid_y) + 8.0, False
    tree = ground & (rng.random(n) < 0.15)
    top[tree] += rng.uniform(0.5, 15, tree.sum())
    return x, y, (top + rng.normal(0, noise, n)).round(3), ground & ~tree, top - floor


def seconds(work, times: int = 3) -> float:
    best = np.inf
    for _ in range(times):
        start = time.process_time()
        work()
        best = min(best, time.process_time() - start)
    return best


def rmse(error: np.ndarray) -> float:
    return 100 * float(np.sqrt(np.nanmean(error**2)))


def speed(cloud: tuple[np.ndarray, ...], params: TerrainParams) -> None:
    x, y, z, ground, _ = cloud
    none = np.zeros(len(x), bool)
    block = next(t for t in TileGrid(params.block).touching(Window(1.0, int(X0) + 256, int(Y0) + 320, 1, 1).box))
    near = block.box.grown(params.block_halo).contains(x, y)
    core, own = Window.covering(block.box, params.cell), block.box.contains(x[near], y[near])
    given = (x[near], y[near], z[near], ground[near], none[near], own, core)
    for kind in ("tin", "raster", "nearest"):
        took = seconds(lambda kind=kind: terrain(*given, params.model_copy(update={"height": kind})))
        own_speed, speed = own.sum() / took / 1e6, near.sum() / took / 1e6
        print(f"block and halo, {kind:<8}{took:7.3f} s  {speed:6.2f} M points/s read, {own_speed:.2f} M/s owned")
    took = seconds(lambda: terrain_by_blocks(x, y, z, ground, none, params), 1)
    print(f"whole cloud by blocks   {took:7.3f} s  {len(x) / took / 1e6:6.2f} M points/s")
    few = given[3] & (np.arange(near.sum()) % 4 == 0)
    took = seconds(lambda: LinearNDInterpolator(np.c_[given[0], given[1]][few], given[2][few])(given[0], given[1]), 1)
    print(f"scipy, heights only, a quarter of the ground {took:7.3f} s  {near.sum() / took / 1e6:6.2f} M points/s")


def accuracy(cloud: tuple[np.ndarray, ...], params: TerrainParams) -> None:
    x, y, z, ground, true = cloud
    none = np.zeros(len(x), bool)
    for kind in ("tin", "raster", "nearest"):
        made, window = terrain_by_blocks(x, y, z, ground, none, params.model_copy(update={"height": kind}))
        errors = rmse((made.height - true)[ground]), rmse((made.height - true)[~ground])
        print(f"height by {kind:<9} rmse {errors[0]:6.2f} cm at ground echoes, {errors[1]:6.2f} cm at others")
    membrane = z - bilinear(fill_gaps(lowest(x[ground], y[ground], z[ground], window)), window, x, y)
    errors = rmse((membrane - true)[ground]), rmse((membrane - true)[~ground])
    print(f"membrane over lowest rmse {errors[0]:6.2f} cm at ground echoes, {errors[1]:6.2f} cm at others")
    blocks, window = terrain_by_blocks(x, y, z, ground, none, params)
    whole = terrain(x, y, z, ground, none, ~none, window, params)
    apart = np.abs(blocks.dtm - whole.dtm)
    share = 100 * np.mean(apart > 0.01)
    print(f"seams: {share:.4f} % of cells differ by more than 1 cm, at most {np.nanmax(apart):.3f} m")
    for thin in (0.2, 0.5, 1.0, 2.0):
        part = terrain(x, y, z, ground, none, none, window, params.model_copy(update={"thin": thin}))
        rows, cols = np.mgrid[: window.nrows, : window.ncols] + 0.5
        there = part.support == 0
        error = part.dtm - hills(window.box.xmin + cols * window.cell, window.box.ymin + rows * window.cell)
        print(f"thinned by {thin:4.2f} m: terrain rmse {rmse(error[there]):5.2f} cm in cells with ground")


def held_out(path: str, params: TerrainParams) -> None:
    cloud = laspy.read(path)
    two = np.asarray(cloud.classification) == 2
    x, y, z = (np.asarray(v)[two].round(3) for v in (cloud.x, cloud.y, cloud.z))
    out = np.random.default_rng(1).random(len(x)) < 0.1
    window = window_over(x, y, 1.0, "cell")
    for thin in (0.1, 0.25, 0.5, 1.0, 2.0):
        tin = tin_of(*thin_points(x[~out], y[~out], z[~out], window, thin))
        error = facet_heights(facets_of(tin, params.largest_circle), window, x[out], y[out]) - z[out]
        median = 100 * float(np.nanmedian(np.abs(error)))
        print(f"{Path(path).name}: thinned by {thin:4.2f} m rmse {rmse(error):6.2f} cm, median {median:.2f} cm")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--size", type=float, default=768.0)
    parser.add_argument("--density", type=float, default=4.0)
    parser.add_argument("--noise", type=float, default=0.03)
    parser.add_argument("--halls", type=int, default=6)
    parser.add_argument("--clouds", nargs="*", default=[])
    given = parser.parse_args()
    params = TerrainParams(**yaml.safe_load(BASE.read_text(encoding="utf-8"))["terrain"])
    cloud = town(given.size, given.density, given.noise, given.halls)
    speed(cloud, params)
    accuracy(cloud, params)
    for path in given.clouds:
        held_out(path, params)


if __name__ == "__main__":
    main()
