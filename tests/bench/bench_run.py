"""A whole run, stage by stage: where its seconds, its processor time and its bytes go.

    python tests/bench/bench_run.py [--survey city-1200m] [--strips DIR] [--size M] [--out DIR] [--root TREE] [--loop]
    python tests/bench/bench_run.py --table RUN [--before RUN]

Simulates the survey, unless its strips are given, runs it on two workers (`--loop`: none), and prints a table by stage
from the receipts. With `--table` that of a run that is there; with `--before` the one of docs/performance.md, of both
runs. `--root` runs the program of another checkout; one from before receipts had a `cost` shows seconds alone.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LEARNED = "areas.train=[[512200.0, 5403200.0, 512300.0, 5403300.0]]"
"""The one training area of `city-1200m` that towns of other sizes have, too."""

COSTS = ("user", "system", "reading", "writing", "checking", "faults")


def fwclass(root: Path, *words: str | Path) -> dict[str, float]:
    """Run a command; its wall time and processor time with that of its workers [s]."""
    command = [sys.executable, "-c", "from fwclass.cli import main; main()", *map(str, words)]
    environment = {**os.environ, "PYTHONPATH": str(root)}
    began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, stderr=subprocess.DEVNULL, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "wall": time.perf_counter() - began,
        "user": after.ru_utime - before.ru_utime,
        "system": after.ru_stime - before.ru_stime,
    }


def by_stage(run: Path) -> dict[str, dict[str, float]]:
    """Sums over the receipts of every stage, in the order in which they were made; `peak` the largest."""
    stages: dict[str, dict[str, float]] = {}
    for path in sorted((run / "store").glob("*/*/receipt.json"), key=lambda p: p.stat().st_mtime_ns):
        receipt = json.loads(path.read_text())
        one = stages.setdefault(receipt["stage"], {})
        told = {n: receipt.get("cost", {}).get(n, 0.0) for n in COSTS}
        told |= {"parts": 1, "seconds": receipt["seconds"], "keeping": receipt["keeping"]}
        told["bytes"] = sum(o["bytes"] for o in receipt["outputs"].values())
        for name, value in told.items():
            one[name] = one.get(name, 0.0) + value
        one["peak"] = max(one.get("peak", 0.0), receipt["peak_mib"])
    if not stages:
        raise SystemExit(f"{run} is no run directory that keeps its parts (store/STAGE/PART/receipt.json)")
    return stages


def echoes_of(run: Path) -> int:
    receipts = (json.loads(p.read_text()) for p in (run / "store" / "tile").glob("*/receipt.json"))
    return sum(int(r["meta"]["rows"]) for r in receipts)


def table(run: Path) -> dict[str, float]:
    """Print a run's stages; the sums."""
    stages = by_stage(run)
    sums: dict[str, float] = {}
    print(
        f"{'stage':<16}{'parts':>6}{'seconds':>9}{'CPU':>8}{'system':>8}{'wait':>7}{'read':>7}{'write':>7}{'check':>7}"
        f"{'keep':>7}{'MB':>8}{'faults':>9}{'peak':>6}"
    )
    for name, s in [*stages.items(), ("sum", sums)]:
        cpu = s["user"] + s["system"]
        print(
            f"{name:<16}{s['parts']:>6.0f}{s['seconds']:>9.2f}{cpu:>8.2f}{s['system']:>8.2f}{s['seconds'] - cpu:>7.2f}"
            f"{s['reading']:>7.2f}{s['writing']:>7.2f}{s['checking']:>7.2f}{s['keeping']:>7.2f}{s['bytes'] / 1e6:>8.1f}"
            f"{s['faults']:>9.0f}{s['peak']:>6.0f}"
        )
        if name != "sum":
            for what, value in s.items():
                sums[what] = max(sums.get(what, 0.0), value) if what == "peak" else sums.get(what, 0.0) + value
    rows, system = echoes_of(run), sums["system"] / max(sums["user"] + sums["system"], 1e-9)
    print(
        f"{rows:,} echoes: {sums['bytes'] / rows:.0f} bytes written an echo, "
        f"{1e6 * (sums['user'] + sums['system']) / rows:.1f} CPU-s a million, {100 * system:.1f} % of it the system's"
    )
    return {**sums, "echoes": rows}


def compared(before: Path, after: Path) -> None:
    """Print both runs stage by stage, as Markdown; writing is with flushing and digests, computing is what is left."""
    names = ("CPU s", "of it system", "read s", "compute s", "write s", "MB")
    print("| stage | parts | " + " | ".join(names) + " |\n|---|---:|" + "---:|" * len(names))
    runs = [_figures(by_stage(run)) for run in (before, after)]
    for name in runs[1]:
        old, new = runs[0].get(name, {}), runs[1][name]
        cells = [f"{old[n]:.1f} → {new[n]:.1f}" if old else f"{new[n]:.1f}" for n in names]
        print(f"| {name} | {new['parts']:.0f} | " + " | ".join(cells) + " |")


def _figures(stages: dict[str, dict[str, float]]) -> dict[str, dict[str, float]]:
    """Of every stage, and of all, what the table shows."""
    shown = {}
    for name, s in stages.items():
        reading, writing = s["reading"] + s["checking"], s["writing"] + s["keeping"]
        shown[name] = {
            "parts": s["parts"],
            "CPU s": s["user"] + s["system"],
            "of it system": s["system"],
            "read s": reading,
            "compute s": s["seconds"] - reading - writing,
            "write s": writing,
            "MB": s["bytes"] / 1e6,
        }
    everything = {n: sum(one[n] for one in shown.values()) for n in next(iter(shown.values()))}
    return {**shown, "all": everything}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--survey", default="city-1200m")
    parser.add_argument("--strips", type=Path, help="a survey that `fwclass simulate` has written")
    parser.add_argument("--size", type=float, help="of the simulated survey [m]")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--root", type=Path, default=ROOT)
    parser.add_argument("--loop", action="store_true")
    parser.add_argument("--table", type=Path)
    parser.add_argument("--before", type=Path)
    chosen = parser.parse_args()
    if chosen.table is not None:
        if chosen.before is None:
            table(chosen.table)
        else:
            compared(chosen.before, chosen.table)
        return
    with tempfile.TemporaryDirectory() as scratch:
        base = chosen.out or Path(scratch)
        base.mkdir(parents=True, exist_ok=True)
        size = ["--set", f"simulate.size={chosen.size}"] if chosen.size else []
        strips = chosen.strips or base / "survey"
        if not strips.is_dir():
            fwclass(ROOT, "simulate", chosen.survey, "--out", strips, *size)
        words = ["run", chosen.survey, "--set", f"survey.directory={strips.resolve()}", "--out", base / "run"]
        if chosen.size:
            words += ["--set", LEARNED]
        took = fwclass(chosen.root, *words, "--workers", "0" if chosen.loop else "2")
        table(base / "run")
        print(
            f"whole command: {took['wall']:.0f} s, {took['user'] + took['system']:.1f} CPU-s, "
            f"{took['system']:.1f} of them the system's"
        )


if __name__ == "__main__":
    main()
