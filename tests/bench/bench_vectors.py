"""Footprints and trees against what the simulator built: `python tests/bench/bench_vectors.py DIR [--seeds 4,7]`.

Of each seed a town of 300 m is simulated, classified, and delivered with vectors; and once more with the true echoes
and their classes. Prints what was found and the vectors' share of the run's processor time.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from vectorscore import scored_run

OF_VECTORS = ("pulse-density", "vector-cell", "buildings", "tree-tops", "publish-vectors")
TRUE = """survey:
  name: truth
  directory: SURVEY
  sources: ["reference/*.las"]
  reference: {kind: source}
  features: [zc]
  classes:
    - {name: ground, code: 2}
    - {name: low vegetation, code: 3}
    - {name: medium vegetation, code: 4}
    - {name: high vegetation, code: 5}
    - {name: building, code: 6}
    - {name: artificial, code: 64}
areas: {train: [[512000.0, 5403000.0, 512150.0, 5403300.0]]}
ground: {max_building_size: 50.0}
classify: {keep: [2, 3, 4, 5, 6, 64]}
train: {trees: 2}
"""


def run(*words: object) -> None:
    subprocess.run(
        [sys.executable, "-m", "fwclass", "run", *map(str, words), "--set", "vectors.write=true"], check=True
    )


def share_of_time(directory: Path) -> float:
    """Of the seconds that all parts took but the simulation's."""
    seconds = {s["name"]: s["seconds"] for s in json.loads((directory / "report.json").read_text())["stages"]}
    return sum(seconds.get(n, 0.0) for n in OF_VECTORS) / sum(v for n, v in seconds.items() if n != "simulate")


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("directory", type=Path)
    words.add_argument("--seeds", default="4,7,11")
    words.add_argument("--density", default="3.3", help="pulses per square metre")
    asked = words.parse_args()
    for seed in asked.seeds.split(","):
        place = asked.directory / f"{seed}_{asked.density}"
        settings = ("--set", f"simulate.seed={seed}", "--set", f"simulate.pulse_density={asked.density}")
        run("demo", "--out", place / "classified", *settings)
        survey = (place / "classified" / "survey").resolve()
        (place / "truth.yaml").write_text(TRUE.replace("SURVEY", str(survey)))
        run(place / "truth.yaml", "--out", place / "true")
        for name in ("classified", "true"):
            for what, figures in zip(
                ("buildings", "trees"), scored_run(place / name, survey / "truth.gpkg"), strict=True
            ):
                shown = "  ".join(f"{k} {v:.3f}" if isinstance(v, float) else f"{k} {v}" for k, v in figures.items())
                print(f"seed {seed}  {name:10}  {what:9}  {shown}", flush=True)
        print(f"seed {seed}  share of the run's time {share_of_time(place / 'classified'):.3f}", flush=True)


if __name__ == "__main__":
    main()
