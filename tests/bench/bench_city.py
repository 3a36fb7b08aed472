"""The 1.2 km survey, whole: time per stage, memory of the largest worker, and what tile size and workers change.

    python tests/bench/bench_city.py [--out DIR] [--survey city-1200m]

Simulates and runs the survey on two workers, then again with tiles of 150 m and with one tile for everything, and
compares every echo. Needs some 12 GB of disk and ten minutes on two cores. Run it when nothing else runs.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from fwclass.store.atomic import read_json

COLUMNS = ["strip", "pulse", "echo_number", "classification", "confidence", "ground", "height_above_ground", "zc"]
VARIANTS = (("tile.size=150", 2), ("tile.size=10000", 1))


def fwclass(*words: str | Path) -> None:
    command = [sys.executable, "-c", "from fwclass.cli import main; main()", *map(str, words)]
    subprocess.run(command, check=True, stderr=subprocess.DEVNULL)


def run(survey: str, root: Path, workers: int, *settings: str) -> dict:
    words = [word for setting in settings for word in ("--set", setting)]
    fwclass("run", survey, "--out", root, "--workers", str(workers), *words)
    return read_json(root / "report.json")


def linked(source: Path, target: Path) -> Path:
    """A copy of a run that shares its files; parts are replaced, never changed in place."""
    ignored = shutil.ignore_patterns("lock", "staging")
    shutil.copytree(source, target, symlinks=True, copy_function=os.link, ignore=ignored)
    return target


def echoes(root: Path) -> dict[str, np.ndarray]:
    tables = [pq.read_table(p, columns=COLUMNS) for p in sorted((root / "parquet").glob("*.parquet"))]
    columns = {n: np.concatenate([t.column(n).to_numpy() for t in tables]) for n in COLUMNS}
    order = np.lexsort((columns["echo_number"], columns["pulse"], columns["strip"]))
    return {n: v[order] for n, v in columns.items()}


def tell(report: dict) -> None:
    print(f"{'stage':<18}{'parts':>6}{'seconds':>9}{'peak MiB':>10}")
    for stage in report["stages"]:
        print(f"{stage['name']:<18}{stage['parts']:>6}{stage['seconds']:>9.1f}{stage['peak_mib']:>10.0f}")
    counts, accuracy = report["counts"], report["accuracy"]
    peak = max(s["peak_mib"] for s in report["stages"])
    print(f"wall {report['seconds']:.0f} s, largest worker {peak:.0f} MiB")
    print(f"echoes decomposed {counts['echoes_decomposed']:,}, in tiles {counts['echoes_in_tiles']:,}")
    print(f"overall accuracy {accuracy['overall_accuracy']:.4f}, kappa {accuracy['kappa']:.4f}, {accuracy['area']}")
    print(f"confusion (rows reference) {accuracy['classes']} {accuracy['confusion']}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--survey", default="city-1200m")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        base = chosen.out or Path(scratch)
        first = base / "first"
        tell(run(chosen.survey, first, 2))
        reference = echoes(first)
        for setting, workers in VARIANTS:
            root = linked(first, base / setting.replace("=", "-"))
            run(chosen.survey, root, workers, setting, "run.worker_memory_gib=16")
            other = echoes(root)
            differing = {n: int((~_equal(reference[n], other[n])).sum()) for n in COLUMNS}
            print(f"{setting}, {workers} worker(s): echoes that differ in any column {differing}")


def _equal(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a == b) | ((a != a) & (b != b))


if __name__ == "__main__":
    main()
