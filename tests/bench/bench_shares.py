"""What the shorter workflows take of a whole run: ``--workflow ground``, ``quality``, contours, vectors.

    python tests/bench/bench_shares.py RUN
    python tests/bench/bench_shares.py --survey city-1200m --out DIR

RUN is a finished run of the whole (`--workflow classification`), made once: shares are of the processor time of its
parts, the simulation's left out, by which stages the others have. Two shares of each workflow: of all its stages, and
of those behind the tiles, as echoes in tiles are what every run begins with.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from bench_run import by_stage

from fwclass.graph.contours import CONTOUR_BLOCKS, DELIVER_CONTOURS
from fwclass.graph.stages import OF_VECTORS, TO_TILES
from fwclass.workflows import WORKFLOWS

GOALS = {"ground": 0.40, "quality": 0.15, "contours": 0.10, "vectors": 0.10}
"""Most of the whole run's processor time, of what comes behind the tiles."""


def cpu(run: Path) -> dict[str, float]:
    """Processor seconds by stage, without the simulation's."""
    return {n: s["user"] + s["system"] for n, s in by_stage(run).items() if n != "simulate"}


def shares(run: Path) -> dict[str, tuple[float, float]]:
    """Of each: the share of all its stages, and of those behind the tiles."""
    spent = cpu(run)
    whole, before = sum(spent.values()), {s.name for s in TO_TILES}
    names = {name: {s.name for s in WORKFLOWS[name].stages} for name in ("ground", "quality")}
    names["contours"] = {CONTOUR_BLOCKS.name, DELIVER_CONTOURS.name}
    names["vectors"] = {s.name for s in OF_VECTORS}
    own = {"ground": {"classify"}}  # the forest's answers are not the ground's classes
    told = {}
    for name, stages in names.items():
        some = {n: spent.get(n, 0.0) for n in stages - own.get(name, set())}
        told[name] = (sum(some.values()) / whole, sum(v for n, v in some.items() if n not in before) / whole)
    return told


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("run", type=Path, nargs="?")
    asked.add_argument("--survey", default="city-1200m")
    asked.add_argument("--out", type=Path)
    words = asked.parse_args()
    run = words.run
    if run is None:
        if words.out is None:
            asked.error("name a finished run, or --out where one is to be made")
        run = words.out
        line = [sys.executable, "-m", "fwclass", "run", words.survey, "--out", str(run), "--set", "vectors.write=true"]
        subprocess.run(line, check=True)
    missed = []
    for name, (every, behind) in shares(run).items():
        if every:
            print(
                f"{name:10} {100 * every:5.1f} % of the run, {100 * behind:5.1f} % behind the tiles "
                f"(goal {GOALS[name]:.0%})"
            )
            missed += [name] if behind > GOALS[name] else []
    if missed:
        raise SystemExit(f"more than their goal: {', '.join(missed)}")


if __name__ == "__main__":
    main()
