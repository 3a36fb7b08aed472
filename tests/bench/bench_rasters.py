"""What the rasters of a whole survey cost: processor time a cell and memory, by the survey's size.

    python tests/bench/bench_rasters.py [KILOMETRES …]

A square survey at 1 m, of blocks of noise (the worst case for compression), each size in a process of its own. Beside
it what one float32 array of the survey takes, of which a program that holds rasters whole needs several.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from fwclass import conf
from fwclass.graph.raster_outputs import deliver_rasters
from fwclass.graph.stage_work import StageInputs
from fwclass.grid import Box, TileGrid, Window
from fwclass.memory import peak_mib

GRID = TileGrid(256.0)
ROW = "{:>8}{:>14}{:>14}{:>12}{:>14}{:>12}"


class Noise:
    """Inputs whose parts are drawn when they are read."""

    def arrays(self, stage, part, name):
        block = GRID.tile(part)
        window = Window.covering(block.box, 1.0)
        rng = np.random.default_rng((block.ix, block.iy))
        if stage == "terrain":
            dtm = (100 + np.cumsum(rng.normal(0, 0.1, window.shape), axis=0)).astype(np.float32)
            arrays = {"dtm": dtm, "dsm": dtm + 10 * rng.random(window.shape, np.float32)}
        else:
            classes = rng.choice(np.array([0, 2, 5, 6], np.uint8), window.shape)
            sure = rng.integers(0, 101, window.shape).astype(np.uint8)
            arrays = {"classes": classes, "confidence": sure, "echoes": (classes > 0).astype(np.uint32)}
        return arrays, {n: getattr(window, n) for n in ("cell", "col", "row", "ncols", "nrows")}


def one(kilometres: float) -> None:
    """Make them, and tell."""
    edge = 1000.0 * kilometres
    box = Box(512_000.0, 5_403_200.0, 512_000.0 + edge, 5_403_200.0 + edge)
    names = {"2": "ground", "5": "vegetation", "6": "building"}
    with tempfile.TemporaryDirectory() as folder:
        before, began = peak_mib(), time.process_time()
        told = deliver_rasters(
            StageInputs(Noise(), Path(folder), "all", tuple(("terrain", b.key) for b in GRID.touching(box))),
            conf.section("publish"),
            "EPSG:25832",
            names,
            1.0,
            GRID.size,
            box.bounds,
        )
        took = time.process_time() - began
        size = sum(p.stat().st_size for p in Path(folder).rglob("*.tif"))
    cells = told["dtm_cells"]
    print(
        ROW.format(
            f"{kilometres:g}",
            f"{cells:,}",
            f"{1e6 * took / cells:.2f}",
            f"{peak_mib() - before:.0f}",
            f"{4 * cells / 2**20:.0f}",
            f"{size / cells:.1f}",
        )
    )


def main() -> None:
    sizes = [float(word) for word in sys.argv[1:]] or [1.0, 4.0, 10.0]
    if len(sizes) == 1:
        one(sizes[0])
        return
    print(ROW.format("km", "cells", "us a cell", "MiB more", "MiB an array", "B a cell"))
    for size in sizes:
        subprocess.run([sys.executable, __file__, str(size)], check=True)


if __name__ == "__main__":
    main()
