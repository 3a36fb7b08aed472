"""What thousands of tiny things cost: a run of 2 000 files of 60 points, and one of 5 184 tiles of one point each.

    python tests/bench/bench_tiny.py [--only files|tiles] [--workers N]

Points are on a slope with bushes, of classes 2 and 5, which are the reference; no waveforms.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil
import yaml

sys.path.insert(0, str(Path(__file__).parents[1]))

import lasmaker

FILES, EACH = 2_000, 60
TILES = 72
TRAIN = 0.4
"""Share of the width that is trained on."""


def points(x: np.ndarray, y: np.ndarray, path: Path, rng: np.random.Generator) -> None:
    bush = rng.random(len(x)) < 0.3
    z = 200 + 0.05 * x + bush * rng.uniform(0.5, 6, len(x))
    xyz, classes = np.c_[500_000 + x, 5_400_000 + y, z], np.where(bush, 5, 2)
    times = 1000 + rng.integers(1 << 30) + np.arange(len(x)) * 1e-3
    lasmaker.write_las(path, xyz, point_format=6, classification=classes, gps_time=times)


def files(folder: Path, rng: np.random.Generator) -> float:
    """Squares of 7.5 m side by side, 1 point/m2; the width of all [m]."""
    across = round(FILES**0.5)
    for k in range(FILES):
        at = 7.5 * np.array(divmod(k, across))
        points(*(at[:, None] + rng.uniform(0, 7.5, (2, EACH))), folder / f"{k:05d}.las", rng)
    return 7.5 * across


def tiles(folder: Path, rng: np.random.Generator) -> float:
    """One file with one point in every tile of 100 m; the width [m]."""
    i, j = np.divmod(np.arange(TILES**2), TILES)
    points(100.0 * i + 50, 100.0 * j + 50, folder / "a.las", rng)
    return 100.0 * TILES


def survey(folder: Path, width: float) -> Path:
    x, y = 500_000, 5_400_000
    conf = {
        "survey": {
            "name": "tiny",
            "directory": ".",
            "sources": ["*.las"],
            "reference": {"kind": "source"},
            "crs": "EPSG:32633",
            "features": ["zc", "height_range_c100", "density_c100"],
            "classes": [{"name": "ground", "code": 2, "codes": [2]}, {"name": "bush", "code": 5, "codes": [5]}],
        },
        "areas": {"train": [[x, y, x + TRAIN * width, y + width]]},
        "tile": {"size": 100.0},
    }
    path = folder / "tiny.yaml"
    path.write_text(yaml.safe_dump(conf))
    return path


def measured(conf: Path, workers: int) -> str:
    words = ["run", conf, "--out", conf.parent / "run", "--workers", workers]
    before, began = psutil.Process().cpu_times(), time.perf_counter()
    line = [sys.executable, "-c", "from fwclass.cli import main; main()", *map(str, words)]
    ended = subprocess.run(line, capture_output=True, text=True)
    wall, after = time.perf_counter() - began, psutil.Process().cpu_times()
    assert ended.returncode in (0, 4), ended.stderr[-2000:]  # 4: one point a tile teaches a model next to nothing
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return f"{wall:.0f} s, {cpu:.0f} s of the processor, {workers} workers"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", choices=["files", "tiles"])
    parser.add_argument("--workers", type=int, default=0)
    asked = parser.parse_args()
    for name, make in (("files", files), ("tiles", tiles)):
        if asked.only in (None, name):
            with tempfile.TemporaryDirectory() as place:
                conf = survey(Path(place), make(Path(place), np.random.default_rng(1)))
                told = f"{FILES:,} files of {EACH} points" if name == "files" else f"{TILES**2:,} tiles of one point"
                print(f"{told:<28}{measured(conf, asked.workers)}", flush=True)


if __name__ == "__main__":
    main()
