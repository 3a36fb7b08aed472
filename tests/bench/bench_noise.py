"""What noise costs where it is a neighbour, and where it is none (`features.noise_counts`, docs/features.md).

    python tests/bench/bench_noise.py [--share 0,0.002,0.02] [--seeds 11,12,13] [--data DIR] [--set a.b=value]

Protocol P1 over the French town. A share of the returns is moved up or down by up to 400 and 200 m, or with `near` by
up to 100 m, and has class 7, which is neither trained nor tested. `home`: the noise is in what trains too; `abroad`:
a model of the sound town answers for the noisy one. One layer; means over draws of the noise.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from bench_wires import DATA, TOWNS, Points, read, run, write

TRAIN, TEST, CLASSES, EPSG = TOWNS["town"]
NOISE = 7
HEIGHTS = {"far": (-200.0, 400.0), "near": (5.0, 100.0)}
"""m, by how much a return is moved."""


def noisy(points: Points, share: float, heights: tuple[float, float], random: np.random.Generator) -> Points:
    moved = random.random(len(points["z"])) < share
    z, code = points["z"].copy(), points["classification"].copy()
    z[moved] += random.uniform(*heights, int(moved.sum()))
    code[moved] = NOISE
    return {**points, "z": z, "classification": code}


def survey(boxes: list[list[float]], trains: bool) -> str:
    classes = "".join(f"    - {{name: {n}, code: {c[-1]}, codes: {c}}}\n" for n, c in CLASSES.items())
    return (
        "survey:\n  name: noise\n  directory: '.'\n  sources: [train.laz, test.laz]\n"
        f"  reference: {{kind: source}}\n  classes:\n{classes}  features: default\n"
        f"areas:\n  train: {[boxes[0]] if trains else []}\n  test: [{boxes[1]}]\n  gap: 0\n"
        "classify:\n  context: {cells: []}\nplausibility: {accept: true}\n"
    )


def figures(confusion: np.ndarray) -> list[float]:
    """Overall accuracy and mean IoU [%]."""
    right = confusion.diagonal()
    iou = right / (confusion.sum(axis=0) + confusion.sum(axis=1) - right)
    return [100 * float(right.sum() / confusion.sum()), 100 * float(iou.mean())]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--share", default="0,0.002,0.02")
    parser.add_argument("--seeds", default="11,12,13")
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--set", action="append", default=[])
    asked = parser.parse_args()
    parts = {"train": read(asked.data, TRAIN), "test": read(asked.data, TEST)}
    boxes = [[float(f(p[n])) for f in (np.min, np.max) for n in "xy"] for p in parts.values()]
    print("share, heights, where, noise counts: overall, mean IoU [%] (spread of the draws)", flush=True)
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary)
        for share in map(float, asked.share.split(",")):
            for where in ("far", "near") if share else ("far",):
                rows: dict[tuple[str, str], list[list[float]]] = {}
                for seed in list(map(int, asked.seeds.split(",")))[: None if share else 1]:
                    random, directory = np.random.default_rng(seed), root / f"{share}-{where}-{seed}"
                    directory.mkdir()
                    for name, points in parts.items():
                        write(directory / f"{name}.laz", noisy(points, share, HEIGHTS[where], random), EPSG)
                    for counts in ("true", "false"):
                        setting = [f"features.noise_counts={counts}", *asked.set]
                        (directory / "survey.yaml").write_text(survey(boxes, True))
                        rows.setdefault(("home", counts), []).append(figures(run(directory, counts, setting)))
                        model = root / "0.0-far-11" / counts / "model"
                        if share and model.is_dir():
                            (directory / "survey.yaml").write_text(survey(boxes, False))
                            setting += [f"survey.model={model}"]
                            rows.setdefault(("abroad", counts), []).append(
                                figures(run(directory, f"a{counts}", setting))
                            )
                for (place, counts), some in rows.items():
                    mean, spread = np.mean(some, axis=0), np.std([r[0] for r in some])
                    print(
                        f"{share:g} {where} {place} {counts}:",
                        *(f"{v:.2f}" for v in mean),
                        f"(±{spread:.2f})",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
