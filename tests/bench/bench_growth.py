"""Whether an echo costs the same in a small and in a large survey: a simulated town of growing size, whole runs.

    python tests/bench/bench_growth.py --out DIR [--sizes 500,1200,3500] [--workers 1,2]

Every town has the density, sensor and flight of `city-1200m`, strips 150 m apart, and learns from one block of 100 m
that all sizes have. For each size and number of workers: processor time of the parts and of the whole command a million
echoes, of which the command's own process (plan, scheduler, progress) had so many percent; bytes written an echo; the
most resident memory of the command's process and of a worker. A town of 3.5 km has 50 million echoes and needs some
30 GB below DIR, where simulated strips stay for the next time; runs are removed. Run it when nothing else runs.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path

import psutil
from bench_many import Memory
from bench_run import LEARNED, ROOT, by_stage, echoes_of, fwclass

APART = 150.0


def town(size: float, place: Path) -> Path:
    """The strips of a town of `size` [m]; simulated unless they are there."""
    if not place.is_dir():
        strips = max(round(size / APART), 2)
        words = ("--set", f"simulate.size={size}", "--set", f"simulate.strips={strips}")
        fwclass(ROOT, "simulate", "city-1200m", "--out", place, *words)
    return place


def grown(survey: Path, run: Path, workers: int) -> dict[str, float]:
    """One run: what it took."""
    words = ["run", "city-1200m", "--set", f"survey.directory={survey.resolve()}", "--set", LEARNED]
    line = [sys.executable, "-c", "from fwclass.cli import main; main()", *words]
    line += ["--out", str(run), "--workers", str(workers)]
    began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(line, stderr=subprocess.DEVNULL, env=environment)
    memory, own = Memory(process), 0.0
    memory.start()
    command = psutil.Process(process.pid)
    while process.poll() is None:
        try:
            times = command.cpu_times()
            own = max(own, times.user + times.system)
        except psutil.Error:
            continue
        time.sleep(0.2)
    if process.returncode:
        raise SystemExit(f"the run ended with {process.returncode}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    stages = by_stage(run).values()
    return {
        "wall": time.perf_counter() - began,
        "cpu": after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime,
        "own": own,
        "parts": sum(s["user"] + s["system"] for s in stages),
        "count": sum(s["parts"] for s in stages),
        "bytes": sum(s["bytes"] for s in stages),
        "echoes": echoes_of(run),
        "own_mib": memory.own,
        "worker_mib": memory.workers,
    }


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--out", type=Path, required=True)
    asked.add_argument("--sizes", default="500,1200,3500")
    asked.add_argument("--workers", default="2")
    words = asked.parse_args()
    print(
        f"{'size m':>7}{'workers':>8}{'echoes':>12}{'parts':>7}{'wall s':>8}{'CPU-s/M':>9}{'parts/M':>9}{'own %':>7}"
        f"{'B/echo':>8}{'own MiB':>9}{'worker MiB':>12}"
    )
    for size in map(float, words.sizes.split(",")):
        survey = town(size, words.out / f"town-{size:g}")
        for workers in map(int, words.workers.split(",")):
            run = words.out / f"run-{size:g}-{workers}"
            one = grown(survey, run, workers)
            million = one["echoes"] / 1e6
            print(
                f"{size:>7g}{workers:>8}{one['echoes']:>12,.0f}{one['count']:>7.0f}{one['wall']:>8.0f}"
                f"{one['cpu'] / million:>9.1f}{one['parts'] / million:>9.1f}{100 * one['own'] / one['cpu']:>7.1f}"
                f"{one['bytes'] / one['echoes']:>8.0f}{one['own_mib']:>9.0f}{one['worker_mib']:>12.0f}",
                flush=True,
            )
            shutil.rmtree(run)


if __name__ == "__main__":
    main()
