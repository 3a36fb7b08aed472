"""Whether one scheduler keeps many workers busy: parts that only wait, as long as those of a run took. As on a cluster
the driver and its scheduler are one process, the workers others: here threads of one, `--processes` of them.

    python tests/bench/bench_workers.py [--run DIR] [--workers 50] [--tiles 4000] [--stages 4] [--slower 1]

The plan has `--stages` parts for each tile, each after its tile's one before; with ``--run`` they take what the tile
stages of that run took, else the 93 ms that the city's parts take on average, between a fifth of it and twice as much.
Printed are the share of the workers' time that is waiting, which is their work here, and the processor time of driver
and workers. What a worker does about a part (inputs, receipt, commit) is as ever; fifty of them share the processors
that this machine has, so on two cores what is printed is a lower bound. With ``--bare`` workers do none of that: on
their own processors it is within the time that parts took, and what is left to see is whether driver and scheduler hand
out parts as fast as fifty workers end them. Run it when nothing else runs.
"""

from __future__ import annotations

import argparse
import asyncio
import itertools
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import dask
import psutil
from distributed import LocalCluster, Worker
from nothing import waiting

from fwclass.run import cluster
from fwclass.run.part import Outcome, Task
from fwclass.run.progress import Display
from fwclass.run.runner import Runner
from fwclass.run.tasks import Tasks
from fwclass.store.run_location import RunLocation
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


def wait(location: RunLocation, task: Task, upstream: Sequence[Outcome] = (), split: int = 1) -> Outcome:
    """Instead of `execute`: as long as the part takes, with nothing read and no receipt written."""
    (seconds,) = task.work.args
    time.sleep(seconds)
    return Outcome(*task.name, "computed", seconds)


async def work(address: str, count: int, bare: bool) -> None:
    """`count` workers of one thread each in this process, until they are stopped."""
    if bare:
        cluster.execute = wait
    dask.config.set(cluster._QUIET)  # as those that a run starts
    workers = [Worker(address, nthreads=1, memory_limit=None, dashboard=False) for _ in range(count)]
    await asyncio.gather(*workers)
    await asyncio.gather(*(w.finished() for w in workers))


@contextmanager
def workers_of(address: str, count: int, processes: int, bare: bool) -> Iterator[list[psutil.Process]]:
    """Processes that hold `count` workers together."""
    shares = [count // processes + (k < count % processes) for k in range(processes)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    words = [sys.executable, __file__, "--work", address, *(["--bare"] if bare else [])]
    started = [subprocess.Popen([*words, "--workers", str(n)], env=environment) for n in shares]
    try:
        yield [psutil.Process(p.pid) for p in started]
    finally:
        for process in started:
            process.kill()
            process.wait()


def seconds_of(processes: list[psutil.Process]) -> float:
    """Of processors, until now."""
    return sum(sum(p.cpu_times()[:2]) for p in processes)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path)
    parser.add_argument("--workers", type=int, default=50)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--tiles", type=int, default=4_000)
    parser.add_argument("--stages", type=int, default=4)
    parser.add_argument("--slower", type=float, default=1.0, help="parts take so many times as long")
    parser.add_argument("--bare", action="store_true", help="workers read and write nothing")
    parser.add_argument("--work", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.work:
        asyncio.run(work(asked.work, asked.workers, asked.bare))
        return
    seconds = [asked.slower * one for one in durations(asked.run)]
    total = asked.stages * sum(itertools.islice(itertools.cycle(seconds), asked.tiles))

    def plan() -> Tasks:
        def part(stage: int, tile: int) -> Task:
            needs = ((f"s{stage - 1}", f"{tile:06d}"),) if stage else ()
            work = partial(waiting, seconds[tile % len(seconds)])
            return Task(f"s{stage}", f"{tile:06d}", 1, {}, work, needs)

        return Tasks.joined(Tasks.of(f"s{k}", range(asked.tiles), partial(part, k)) for k in range(asked.stages))

    with (
        tempfile.TemporaryDirectory() as scratch,
        LocalCluster(n_workers=0, processes=False, dashboard_address=None, host="127.0.0.1", protocol="tcp") as local,
        workers_of(local.scheduler_address, asked.workers, asked.processes, asked.bare) as others,
    ):
        while len(local.scheduler.workers) < asked.workers:
            time.sleep(0.1)
        with cluster.Cluster(local.scheduler_address, 0, 1.0, 2000) as hands, Display() as display:
            runner = Runner(Path(scratch), hands, display)
            mine = [psutil.Process()]
            began, driver, theirs = time.perf_counter(), seconds_of(mine), seconds_of(others)
            runner.do(plan())
            wall = time.perf_counter() - began
            driver, theirs = seconds_of(mine) - driver, seconds_of(others) - theirs
            assert not runner.failures
    parts = asked.tiles * asked.stages
    print(f"{parts} parts of {1e3 * total / parts:.0f} ms on {asked.workers} workers: {wall:.1f} s")
    print(f"busy {100 * total / (asked.workers * wall):.1f} % of the workers' time")
    print(
        f"driver and scheduler {1e3 * driver / parts:.2f} ms of a processor a part, {100 * driver / wall:.0f} % of one"
    )
    print(f"workers {1e3 * theirs / parts:.2f} ms a part, {100 * theirs / wall:.0f} %")


if __name__ == "__main__":
    main()
