"""What the shorter workflows take of a whole run: ``--workflow ground``, ``quality``, contours, footprints, trees.

    python tests/bench/bench_shares.py WHOLE [--ground RUN] [--quality RUN]
    python tests/bench/bench_shares.py --survey city-1200m --out DIR

WHOLE is a finished run of the whole (`--workflow classification`), the others runs of the shorter workflows, each in a
directory of its own: what `quality` leaves aside no whole run shows. Shares are of the processor time of the parts, the
simulation's left out. Two shares of each: of all stages, and of those behind the tiles, as echoes in tiles are what
every run begins with. With `--out` the runs are made, below it, of strips that are simulated once.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from bench_run import by_stage

from fwclass.graph.contours import CONTOUR_BLOCKS, DELIVER_CONTOURS
from fwclass.graph.ground import FILTER_GROUND, GATHER_GROUND, GATHER_HEIGHT, MAKE_TERRAIN
from fwclass.graph.stages import OF_VECTORS, TO_TILES
from fwclass.graph.vectors import FIND_TREES

GOALS = {"ground": 0.40, "quality": 0.15, "contours and footprints": 0.10}
"""Most of the whole run's processor time: `quality` of all, the others of what comes behind the tiles; trees have
none."""

OF_ALL = ("quality",)

FLOOR = {s.name for s in (*TO_TILES, FILTER_GROUND, GATHER_GROUND, MAKE_TERRAIN, GATHER_HEIGHT)}
"""What no terrain is made without; the rest of `ground` is checks, quality and what is delivered."""


def cpu(run: Path) -> dict[str, float]:
    """Processor seconds by stage, without the simulation's."""
    return {n: s["user"] + s["system"] for n, s in by_stage(run).items() if n != "simulate"}


def shares(whole: Path, others: dict[str, Path]) -> dict[str, tuple[float, float]]:
    """Of each: the share of all its stages, and of those behind the tiles."""
    spent = cpu(whole)
    parts = {
        "contours": {n: spent.get(n, 0.0) for n in (CONTOUR_BLOCKS.name, DELIVER_CONTOURS.name)},
        "trees": {FIND_TREES.name: spent.get(FIND_TREES.name, 0.0)},
        **{name: cpu(run) for name, run in others.items()},
    }
    if "ground" in parts:
        parts["of it up to the terrain"] = {n: v for n, v in parts["ground"].items() if n in FLOOR}
    footprints = {s.name: spent.get(s.name, 0.0) for s in OF_VECTORS if s is not FIND_TREES}  # trees' delivery too
    parts["contours and footprints"] = parts["contours"] | footprints
    of_vectors = {s.name for s in OF_VECTORS}  # which only some runs write
    every = sum(v for n, v in spent.items() if n not in of_vectors)
    before = {s.name for s in TO_TILES}
    told = {}
    for name, some in parts.items():
        whole_time = every + sum(v for n, v in some.items() if n in of_vectors)
        behind = sum(v for n, v in some.items() if n not in before)
        told[name] = (sum(some.values()) / whole_time, behind / whole_time)
    return told


def make(survey: str, out: Path) -> tuple[Path, dict[str, Path]]:
    """Simulate, run the whole and both shorter workflows; where the runs are."""

    def run(*words: object) -> None:
        subprocess.run([sys.executable, "-m", "fwclass", *map(str, words)], check=True)

    run("simulate", survey, "--out", out / "strips")
    strips = ("--set", f"survey.directory={(out / 'strips').resolve()}")
    run("run", survey, *strips, "--out", out / "whole", "--set", "vectors.write=true")
    for name in ("ground", "quality"):
        run("run", survey, *strips, "--workflow", name, "--out", out / name)
    return out / "whole", {name: out / name for name in ("ground", "quality")}


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("whole", type=Path, nargs="?")
    asked.add_argument("--ground", type=Path)
    asked.add_argument("--quality", type=Path)
    asked.add_argument("--survey", default="city-1200m")
    asked.add_argument("--out", type=Path)
    words = asked.parse_args()
    whole, others = words.whole, {n: r for n in ("ground", "quality") if (r := getattr(words, n)) is not None}
    if whole is None:
        if words.out is None:
            asked.error("name a finished run, or --out where the runs are to be made")
        whole, others = make(words.survey, words.out)
    missed = []
    for name, (every, behind) in shares(whole, others).items():
        if every:
            judged = every if name in OF_ALL else behind
            goal = GOALS.get(name, 1.0)
            which = f" (goal {goal:.0%} {'of the run' if name in OF_ALL else 'behind the tiles'})" if goal < 1.0 else ""
            print(f"{name:24} {100 * every:5.1f} % of the run, {100 * behind:5.1f} % behind the tiles{which}")
            missed += [name] if judged > goal else []
    if missed:
        raise SystemExit(f"more than their goal: {', '.join(missed)}")


if __name__ == "__main__":
    main()
