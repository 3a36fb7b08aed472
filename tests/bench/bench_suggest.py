"""How many labelled places a model needs: those that `fwclass suggest` names beside random ones and the least sure.

    python tests/bench/bench_suggest.py [--data DIR] [--surveys urban,delft,km] [--draws 3]

A model of other surveys classifies one half of a survey. Places there are chosen, all echoes in them take their true
class, and a forest learns from them and from the other surveys' rows as a run with `survey.base_model` does; it is
judged on the other half, 5 m apart, and the halves then change places. Random places are drawn several times. Data are
not part of this repository; without them it says so.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from bench_abroad import CLASSES, DATA, SURVEYS
from numpy.typing import NDArray

from fwclass import conf
from fwclass.assess.confusion import figures
from fwclass.classify.stage import classify
from fwclass.conf.sets import feature_set
from fwclass.grid import millimetres
from fwclass.label.places import PlaceCounts
from fwclass.model import sample_matrix
from fwclass.schema import Table
from fwclass.train.sample import Sample, draw, join, thin
from fwclass.train.stage import grow_trees, train

NAMES = feature_set("portable").features
COUNTS = (2, 5, 10, 20)
GAP = 5.0
MOST = 30_000
"""Echoes that are judged."""


class Cloud:
    """Features, places and reference of a survey's echoes."""

    def __init__(self, files: list[Path], crs: str, place: Path) -> None:
        tables = []
        for k, path in enumerate(files):
            out = place / f"{path.stem}_{k}.parquet"
            words = ["features", path, out, "--set", "portable", "--method", "smrf", "--crs", crs]
            line = [sys.executable, "-c", "from fwclass.cli import main; main()", *map(str, words)]
            subprocess.run(line, check=True, capture_output=True)
            read = pq.read_table(out, columns=[*NAMES, "x", "y", "z", "source_class"])
            tables.append({n: read.column(n).to_numpy() for n in read.column_names})
        self.columns = {n: np.concatenate([t[n] for t in tables]) for n in tables[0]}
        self.reference = self.columns["source_class"].astype(np.uint8)

    def rows(self, inside: NDArray[np.bool_], first: int, seed: int, most: int = 20_000) -> Sample:
        table = Table({n: self.columns[n] for n in NAMES})
        key = np.arange(first, first + len(inside), dtype=np.uint64)
        return draw(table, self.reference, key, inside, CLASSES, most, seed)


def learn(sample: Sample, seed: int) -> object:
    params = conf.section("train", (f"train.seed={seed}",))
    return train(sample, grow_trees(sample, CLASSES, 0, params.trees, params), params, CLASSES)


def with_base(own: Sample, base: Sample, least: int) -> Sample:
    """As `graph.base_rows` has it: of every class as many rows of the base as there are own ones, `least` at least."""
    parts = [own]
    for k, count in enumerate(own.counts.tolist()):
        parts.append(thin(base.take(base.y == k), max(count, least)))
    return join(parts, 10**9)


def judged(model: object, cloud: Cloud, rows: NDArray[np.int64]) -> NDArray[np.float64]:
    """Overall accuracy and mean IoU [%]."""
    table = Table({n: cloud.columns[n][rows] for n in NAMES})
    answers = classify(sample_matrix(table, model.features), model)["classification"]
    of = {code: k for k, c in enumerate(CLASSES) for code in c.codes}
    matrix = np.zeros((len(CLASSES), len(CLASSES)), np.int64)
    truth = np.array([of[int(code)] for code in cloud.reference[rows]])
    np.add.at(matrix, (truth, np.searchsorted([c.code for c in CLASSES], answers)), 1)
    told = figures(matrix, [c.name for c in CLASSES])
    return 100 * np.array([told["overall_accuracy"], told["mean_iou"]])


def known(cloud: Cloud) -> NDArray[np.int64]:
    """Echoes whose code counts as a class."""
    return np.flatnonzero(np.isin(cloud.reference, [code for c in CLASSES for code in c.codes]))


def half(cloud: Cloud, base: Sample, west: bool, draws: int) -> dict[str, NDArray[np.float64]]:
    """Figures (counts of places, 2) by way of choosing; `none` without any."""
    x, y, z = (cloud.columns[n] for n in ("x", "y", "z"))
    middle = np.floor((x.min() + x.max()) / 20) * 10
    pool = (x < middle) if west else (x >= middle)
    test = known(cloud)
    test = test[~pool[test] & (np.abs(x[test] - middle) > GAP)]
    test = test[:: max(1, len(test) // MOST)]
    model, seed = learn(base, 1), 1
    table = Table({n: cloud.columns[n][pool] for n in NAMES})
    answer = classify(sample_matrix(table, model.features), model)
    params = conf.section("suggest", ("suggest.places=100000",))
    counts = PlaceCounts(params.size)
    counts.add(*(millimetres(v[pool]) for v in (x, y, z)), answer["classification"], answer["entropy"])
    counts = counts.widened(params.echoes)
    every = [p for p in counts.places() if p.echoes >= params.least * counts.middling]
    ways = {
        "suggested": [counts.suggest(params, lambda p: False)],
        "least sure": [sorted(every, key=lambda p: -p.entropy)],
        "random": [[every[i] for i in np.random.default_rng(s).permutation(len(every))] for s in range(draws)],
    }
    told = {"none": np.repeat(judged(model, cloud, test)[None], len(COUNTS), 0)}
    for way, orders in ways.items():
        results = np.zeros((len(orders), len(COUNTS), 2))
        for a, order in enumerate(orders):
            inside = np.zeros(len(x), bool)
            for b, (start, end) in enumerate(zip((0, *COUNTS), COUNTS, strict=False)):
                for place in order[start:end]:
                    inside |= pool & place.box.contains(x, y)
                own = cloud.rows(inside, 1 << 40, seed)
                results[a, b] = judged(learn(with_base(own, base, 2000), seed + a), cloud, test)
        told[way] = results.mean(axis=0)
    print(f"  places of {counts.size:g} m, {counts.middling:.0f} echoes each", flush=True)
    return told


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--surveys", default="urban,delft,km")
    parser.add_argument("--draws", type=int, default=3)
    asked = parser.parse_args()
    if not asked.data.is_dir():
        sys.exit(f"no data in {asked.data}")
    with tempfile.TemporaryDirectory() as place:
        clouds = {n: Cloud(sorted(asked.data.glob(f)), crs, Path(place)) for n, (f, crs) in SURVEYS.items()}
    for name in asked.surveys.split(","):
        others, first = [], 1
        for other, cloud in clouds.items():
            if other != name:
                others.append(cloud.rows(np.ones(len(cloud.reference), bool), first, 1, 6000))
                first += len(cloud.reference)
        base = join(others, 10**9)
        print(f"{name}: overall accuracy and mean IoU [%] with so many places", flush=True)
        halves = [half(clouds[name], base, west, asked.draws) for west in (True, False)]
        print("".join(f"{n:>16}" for n in ("", *COUNTS)))
        for way in halves[0]:
            mean = (halves[0][way] + halves[1][way]) / 2
            print(f"{way:>16}" + "".join(f"{f'{a:.1f} / {b:.1f}':>16}" for a, b in mean), flush=True)


if __name__ == "__main__":
    main()
