"""What operations cost: receipts and Dask in a run, a run with nothing to do, status, and the window of tasks.

    python tests/bench/bench_operations.py [--run DIR [--first]] [--survey city-1200m] [--set KEY=VALUE …]

Without ``--run`` the survey is simulated and run on two workers first. The second part sends parts that do nothing
through the same runner, once in the plain loop and once on two workers: what is left is the cost of a part. Run it when
nothing else runs.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import psutil
from nothing import nothing

from fwclass.run.cluster import Cluster
from fwclass.run.local import Loop
from fwclass.run.part import Task
from fwclass.run.progress import Display
from fwclass.run.runner import Runner
from fwclass.run.tasks import Tasks
from fwclass.store.atomic import read_json
from fwclass.store.run_store import Store

REPEATS = 5
EMPTY = 2_000
ROW = "{:<44}{:>12}"


def command(*words: str) -> tuple[float, float]:
    """Wall and CPU seconds of one `fwclass` command."""
    began, before = time.perf_counter(), psutil.Process().cpu_times()
    line = [sys.executable, "-c", "from fwclass.cli import main; main()", *words]
    subprocess.run(line, check=True, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    after = psutil.Process().cpu_times()
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return time.perf_counter() - began, cpu


def empty(key: int) -> Task:
    return Task("nothing", f"{key:05d}", 1, {}, nothing)


def walked(executor, root: Path) -> float:
    with Display() as display:
        runner = Runner(root, executor, display)
        began = time.perf_counter()
        runner.do(Tasks.of("nothing", range(EMPTY), empty))
        assert not runner.failures
        return time.perf_counter() - began


def told(survey: str, root: Path, settings: list[str], wall: float | None) -> None:
    """`wall`: what the whole run took after its start [s], None for one that was made in pieces."""
    words = [w for s in settings for w in ("--set", s)]
    stages = Counter()
    keeping = 0.0
    store = Store(root)
    for stage in sorted(p.name for p in store.directory.iterdir() if p.is_dir()):
        for receipt in store.receipts(stage):
            if receipt.stage != "simulate":
                stages[stage] += receipt.seconds
                keeping += receipt.keeping
    parts = sum(1 for p in store.directory.glob("*/*/receipt.json"))
    total = sum(stages.values())
    print(ROW.format("parts", parts))
    print(ROW.format("seconds of parts, on two workers", f"{total:.0f}"))
    print(ROW.format("  of them receipts (flush, digest, rename)", f"{100 * keeping / total:.1f} %"))
    if wall is not None:
        print(ROW.format("share of two workers' time that is a part's", f"{100 * total / (2 * wall):.1f} %"))
    again = ("run", survey, "--out", str(root), "--workers", "0", *words)
    for name, line in (("run with nothing to do", again), ("status", ("status", str(root)))):
        took = [command(*line) for _ in range(REPEATS)]
        print(ROW.format(f"{name}, wall", f"{statistics.median(w for w, _ in took):.2f} s"))
        print(ROW.format(f"{name}, CPU", f"{statistics.median(c for _, c in took):.2f} s"))
    with tempfile.TemporaryDirectory() as scratch:
        alone = walked(Loop(), Path(scratch) / "loop")
        with Cluster(None, 2, 2.0, 2000) as cluster:
            spread = walked(cluster, Path(scratch) / "cluster")
    each = 1e3 * spread / EMPTY
    wall = wall or total / 2
    print(ROW.format("an empty part in the loop", f"{1e3 * alone / EMPTY:.1f} ms"))
    print(ROW.format("an empty part on two workers", f"{each:.1f} ms"))
    print(ROW.format("as many empty parts, of the run's time", f"{100 * each * parts / 1e3 / wall:.1f} %"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path, help="a run directory that is there")
    parser.add_argument("--first", action="store_true", help="its last run made all of it, on two workers")
    parser.add_argument("--survey", default="city-1200m")
    parser.add_argument("--set", action="append", default=[], dest="settings")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        root = chosen.run or Path(scratch) / "run"
        if not chosen.run:
            words = [w for s in chosen.settings for w in ("--set", s)]
            wall, _ = command("run", chosen.survey, "--out", str(root), "--workers", "2", *words)
            print(ROW.format("whole run, wall", f"{wall:.0f} s"))
            print(ROW.format("  of it after the start", f"{read_json(root / 'report.json')['seconds']:.0f} s"))
        first = read_json(root / "report.json") if not chosen.run or chosen.first else None
        told(chosen.survey, root, chosen.settings, first["seconds"] if first else None)


if __name__ == "__main__":
    main()
