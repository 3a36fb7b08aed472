"""Whether one scheduler keeps many workers busy: parts that only wait, as long as those of a run took, on a cluster
whose workers are threads of this process.

    python tests/bench/bench_workers.py [--run DIR] [--workers 50] [--tiles 4000] [--stages 4]

The plan has `--stages` parts for each tile, each after its tile's one before; with ``--run`` they take what the tile
stages of that run took, else the 93 ms that the city's parts take on average, between a fifth of it and twice as much.
Printed is the share of the workers' time that is waiting, which is their work here, and the driver's processor time.
Receipts are written as ever: 2 ms of a processor each, here of the one process. Run it when nothing else runs.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
import time
from functools import partial
from pathlib import Path

import psutil
from distributed import LocalCluster
from nothing import waiting

from fwclass.run.cluster import Cluster
from fwclass.run.part import Task
from fwclass.run.progress import Display
from fwclass.run.runner import Runner
from fwclass.run.tasks import Tasks
from fwclass.store.run_store import Store

MEAN = 0.093
"""Seconds of a part of `city-1200m` (docs/performance.md)."""

TILE_STAGES = ("tile", "ground", "height", "features", "label", "classify", "confusion", "publish-tile")


def durations(run: Path | None) -> list[float]:
    """Seconds that parts take, in the order in which they come."""
    if run is None:
        return [MEAN * (0.2 + 0.16 * k) for k in (0, 10, 3, 7, 1, 8, 5, 2, 9, 4, 6)]
    store = Store(run)
    return [receipt.seconds for stage in TILE_STAGES for receipt in store.receipts(stage)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path)
    parser.add_argument("--workers", type=int, default=50)
    parser.add_argument("--tiles", type=int, default=4_000)
    parser.add_argument("--stages", type=int, default=4)
    asked = parser.parse_args()
    seconds = durations(asked.run)
    total = asked.stages * sum(itertools.islice(itertools.cycle(seconds), asked.tiles))

    def plan() -> Tasks:
        def part(stage: int, tile: int) -> Task:
            needs = ((f"s{stage - 1}", f"{tile:06d}"),) if stage else ()
            work = partial(waiting, seconds[tile % len(seconds)])
            return Task(f"s{stage}", f"{tile:06d}", 1, {}, work, needs)

        return Tasks.joined(Tasks.of(f"s{k}", range(asked.tiles), partial(part, k)) for k in range(asked.stages))

    with (
        tempfile.TemporaryDirectory() as scratch,
        LocalCluster(n_workers=asked.workers, threads_per_worker=1, processes=False, dashboard_address=None) as threads,
        Cluster(threads.scheduler_address, 0, 1.0, 2000) as cluster,
        Display() as display,
    ):
        runner = Runner(Path(scratch), cluster, display)
        began, before = time.perf_counter(), psutil.Process().cpu_times()
        runner.do(plan())
        wall, after = time.perf_counter() - began, psutil.Process().cpu_times()
        assert not runner.failures
    cpu = after.user + after.system - before.user - before.system
    parts = asked.tiles * asked.stages
    print(f"{parts} parts of {1e3 * total / parts:.0f} ms on {asked.workers} workers: {wall:.1f} s")
    print(f"busy {100 * total / (asked.workers * wall):.1f} % of the workers' time")
    print(
        f"processor, receipts and workers with it: {1e3 * cpu / parts:.2f} ms a part, {100 * cpu / wall:.0f} % of one"
    )


if __name__ == "__main__":
    main()
