"""The cost model against runs of 1, 4 and 16 tiles: what `fwclass plan` says before, and what the run took.

    python tests/bench/bench_plan.py [--sizes 100 200 400] [--workers 2]

Every survey is simulated in tiles of 100 m, planned, run, and set beside its plan: echoes, seconds of parts, disk of
the store and delivery, memory of the largest worker. Figures above 1 say that the run took more than was planned. The
machine's own speed is in the times: the ratio of the three surveys to each other says how good the model is. The first
run compiles.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from fwclass.store.atomic import read_json
from fwclass.store.run_store import Store

HEAD = "{:>6}{:>7}{:>10}{:>22}{:>24}{:>22}{:>20}"


def settings(size: int) -> list[str]:
    half = size / 2
    train = f"areas.train=[[512000, 5403000, {512000 + half:g}, {5403000 + size}]]"
    chosen = (f"simulate.size={size}", "areas.gap=5", train, "tile.size=100", "train.samples_per_class=5000")
    return [word for one in chosen for word in ("--set", one)]


def command(*words: str) -> str:
    line = [sys.executable, "-c", "from fwclass.cli import main; main()", *words]
    return subprocess.run(line, check=True, stderr=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True).stdout


def measured(root: Path) -> tuple[int, float, int, float]:
    """Echoes, seconds of parts, bytes, and the most memory of a worker [MiB]."""
    seconds, size, memory = 0.0, 0, 0.0
    store = Store(root)
    for stage in sorted(p.name for p in store.directory.iterdir() if p.is_dir()):
        for receipt in store.receipts(stage):
            seconds += receipt.seconds
            size += sum(int(o["bytes"]) for o in receipt.outputs.values())
            memory = max(memory, receipt.peak_mib)
    return int(read_json(root / "report.json")["counts"]["echoes_in_tiles"]), seconds, size, memory


def beside(ours: float, planned: float, unit: str) -> str:
    return f"{planned:,.0f} / {ours:,.0f} {unit} {ours / planned:.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[100, 200, 400])
    parser.add_argument("--workers", default="2")
    chosen = parser.parse_args()
    print(HEAD.format("size", "tiles", "", "echoes", "seconds of parts", "disk", "memory"))
    with tempfile.TemporaryDirectory() as scratch:
        warm = Path(scratch) / "warm"
        command("run", "demo", "--out", str(warm), "--workers", chosen.workers, *settings(100))
        for size in chosen.sizes:
            root = Path(scratch) / str(size)
            plan = json.loads(command("plan", "demo", "--out", str(root), "--json", *settings(size)))
            command("run", "demo", "--out", str(root), "--workers", chosen.workers, *settings(size))
            echoes, seconds, disk, memory = measured(root)
            print(
                HEAD.format(
                    size,
                    plan["tiles"]["number"],
                    "plan / run",
                    beside(echoes, plan["echoes"], ""),
                    beside(seconds, plan["seconds"], "s"),
                    beside(disk / 1e6, plan["disk_bytes"] / 1e6, "MB"),
                    beside(memory, plan["memory_mib"], "MiB"),
                ),
                flush=True,
            )


if __name__ == "__main__":
    main()
