"""Labels from polygons: 100 000 polygons and 6 M echoes, ours against shapely's tree. A plain script."""

from __future__ import annotations

import time

import numpy as np

from fwclass.formats.wkb import shapes
from fwclass.grid import Box
from fwclass.label.polygons import Polygons, owners

EDGE, TILE, ECHOES, SIDE = 1200, 100, 6_000_000, 316


def seconds(work):
    began = time.process_time()
    made = work()
    return time.process_time() - began, made


def main() -> None:
    try:
        import shapely
    except ImportError:
        print("shapely is not installed: nothing to compare with")
        return
    r = np.random.default_rng(0)
    at = np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE)), -1).reshape(-1, 2) * (EDGE / SIDE)
    discs = shapely.buffer(shapely.points(at + r.uniform(0, 2, at.shape)), 2.2, quad_segs=8)
    data = list(shapely.to_wkb(discs))
    x, y = np.round(r.uniform(0, EDGE, (2, ECHOES)), 3)
    mx, my = (np.rint(v * 1000).astype(np.int64) for v in (x, y))
    read, found = seconds(lambda: shapes(data, "bench"))
    code = np.arange(found.parts, dtype=np.int64) % 5 + 2
    made = Polygons.of(found, code.astype(np.int16), code.astype(np.int16), "bench")
    owners(mx[:1000], my[:1000], made)
    n = EDGE // TILE
    tile = np.minimum(mx // (TILE * 1000), n - 1) * n + np.minimum(my // (TILE * 1000), n - 1)
    order = np.argsort(tile, kind="stable")
    start = np.searchsorted(tile[order], np.arange(n * n + 1))

    def by_tile() -> None:
        for k in range(n * n):
            rows = order[start[k] : start[k + 1]]
            i, j = TILE * (k // n), TILE * (k % n)
            owners(mx[rows], my[rows], made.within(Box(i, j, i + TILE + 1, j + TILE + 1)))

    ours, _ = seconds(by_tile)
    some = slice(0, ECHOES // 10)
    points = shapely.points(x[some], y[some])
    peer, _ = seconds(lambda: shapely.STRtree(discs).query(points, predicate="within"))
    peer *= 10
    print(f"{found.parts} polygons, {len(found.x)} corners, {ECHOES} echoes, {n * n} tiles; CPU seconds")
    print(f"read well-known binary   {read:7.2f}")
    print(f"label, ours              {ours:7.2f}")
    print(f"label, shapely STRtree   {peer:7.2f}   (a tenth of the echoes, times ten)")
    print(f"ratio                    {peer / ours:7.1f}")


if __name__ == "__main__":
    main()
