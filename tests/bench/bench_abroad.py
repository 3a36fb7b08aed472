"""Models that leave home: trained on one survey and judged on another, or trained on all others.

    python tests/bench/bench_abroad.py [--data DIR] [--sets default,portable] [--seeds 1,2]

Five public surveys of 0.3 to 60 echoes/m2 from two countries; ground, buildings, and what is neither (AHN3 has one
class for plants and objects). The features are those of `fwclass features`, the ground its filter's; nothing of a
survey that is judged is known to its model. The share of echoes with a confidence below `classify.unsure`, which needs
no label, stands beside the figures. Data are not part of this repository; without them it says so.
"""

from __future__ import annotations

import argparse
import itertools
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from fwclass import conf
from fwclass.assess.confusion import figures
from fwclass.classify.stage import classify
from fwclass.classify.unsure import by_percent, unsure_facts
from fwclass.conf.sets import feature_set
from fwclass.model import ClassDef, sample_matrix
from fwclass.schema import Table
from fwclass.train.params import TrainParams
from fwclass.train.sample import draw, join
from fwclass.train.stage import grow_trees, train

DATA = Path(__file__).resolve().parents[2] / ".." / "shared" / "data"
CLASSES = (
    ClassDef(name="ground", code=2, codes=(2,)),
    ClassDef(name="other", code=5, codes=(1, 3, 4, 5)),
    ClassDef(name="building", code=6, codes=(6,)),
)
SURVEYS = {
    "urban": ("ign_hd/urban_*.laz", "EPSG:2154"),
    "km": ("ign_hd/km_0299_6802.laz", "EPSG:2154"),
    "bat": ("ign_hd/bat.laz", "EPSG:2154"),
    "crop": ("ign_hd/crop_1.laz", "EPSG:2154"),
    "delft": ("other/delft_ahn3_1.laz", "EPSG:28992"),
}
ROWS = 20_000
"""Of a class, from all the surveys that a model learns from together."""

EVERY = 4
"""Every n-th echo is judged."""


@dataclass
class Survey:
    """Features of a survey's echoes, and the codes of their reference."""

    features: Table
    reference: NDArray[np.uint8]

    @classmethod
    def of(cls, files: list[Path], crs: str, place: Path) -> Survey:
        tables = []
        for k, path in enumerate(files):
            out = place / f"{path.stem}_{k}.parquet"
            words = ["features", path, out, "--set", "default", "--method", "smrf", "--crs", crs]
            line = [sys.executable, "-c", "from fwclass.cli import main; main()", *map(str, words)]
            subprocess.run(line, check=True, capture_output=True)
            names = (*feature_set("default").features, "source_class")
            tables.append(
                Table(
                    {
                        n: c.to_numpy()
                        for n, c in zip(names, pq.read_table(out, columns=list(names)).columns, strict=True)
                    }
                )
            )
        table = Table.concat(tables)
        return cls(table, table["source_class"].astype(np.uint8))


def learn(surveys: list[Survey], names: tuple[str, ...], params: TrainParams) -> object:
    """A forest of rows of all `surveys`, as many of each."""
    each, samples, first = ROWS // len(surveys), [], 0
    for survey in surveys:
        rows = survey.features.rows
        key = np.arange(first, first + rows, dtype=np.uint64)
        inside = np.ones(rows, bool)
        samples.append(draw(survey.features.select(names), survey.reference, key, inside, CLASSES, each, params.seed))
        first += rows
    sample = join(samples, ROWS)
    return train(sample, grow_trees(sample, CLASSES, 0, params.trees, params), params, CLASSES)


def judged(model: object, survey: Survey) -> NDArray[np.float64]:
    """Overall accuracy, kappa and mean IoU, and the share of echoes of which the model is unsure [%]."""
    known = np.isin(survey.reference, [code for c in CLASSES for code in c.codes])
    rows = np.flatnonzero(known)[::EVERY]
    table = classify(sample_matrix(survey.features.take(rows), model.features), model)
    answers = table["classification"]
    unsure = unsure_facts(by_percent(table["confidence"]), conf.section("classify", ()), given={})
    matrix = np.zeros((len(CLASSES), len(CLASSES)), np.int64)
    of = {code: k for k, c in enumerate(CLASSES) for code in c.codes}
    truth = np.array([of[int(code)] for code in survey.reference[rows]])
    np.add.at(matrix, (truth, np.searchsorted([c.code for c in CLASSES], answers)), 1)
    told = figures(matrix, [c.name for c in CLASSES])
    return 100 * np.array([told["overall_accuracy"], told["kappa"], told["mean_iou"], unsure["share"]])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--sets", default="default,portable")
    parser.add_argument("--seeds", default="1,2")
    asked = parser.parse_args()
    if not asked.data.is_dir():
        sys.exit(f"no data in {asked.data}")
    with tempfile.TemporaryDirectory() as place:
        surveys = {
            name: Survey.of(sorted(asked.data.glob(files)), crs, Path(place)) for name, (files, crs) in SURVEYS.items()
        }
    for name in asked.sets.split(","):
        features, pairs, others = feature_set(name).features, [], []
        for seed in map(int, asked.seeds.split(",")):
            params = conf.section("train", (f"train.seed={seed}",))
            for home in surveys:
                model = learn([surveys[home]], features, params)
                pairs.append([judged(model, s) if n != home else np.full(4, np.nan) for n, s in surveys.items()])
            models = [learn([s for n, s in surveys.items() if n != out], features, params) for out in surveys]
            others.append([judged(m, s) for m, s in zip(models, surveys.values(), strict=True)])
        table = np.array(pairs).reshape(-1, len(surveys), len(surveys), 4).mean(axis=0)
        print(f"\n{name}, {len(features)} features: overall / kappa / mean IoU / unsure [%]")
        print(f"{'trained on':<12}" + "".join(f"{n:>26}" for n in surveys))
        for home, row in itertools.chain(zip(surveys, table, strict=True), [("all others", np.mean(others, axis=0))]):
            cells = ("/".join(f"{v:5.1f}" for v in figure) if np.isfinite(figure[0]) else "" for figure in row)
            print(f"{home:<12}" + "".join(f"{cell:>26}" for cell in cells))
        mean, all_others = np.nanmean(table, axis=(0, 1)), np.mean(others, axis=(0, 1))
        print("mean of pairs " + " / ".join(f"{v:.2f}" for v in mean), end="; ")
        print("of all others " + " / ".join(f"{v:.2f}" for v in all_others), flush=True)


if __name__ == "__main__":
    main()
