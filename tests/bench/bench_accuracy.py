"""Accuracy on IGN LiDAR HD by the protocols P1, P1cv and P4, beside what other programs reach.

    python tests/bench/bench_accuracy.py [p1] [p1cv] [p4] [--data DIR] [--out DIR] [--seeds 1,2,3] [--set a.b=value]

Training and test clouds are loaded, filtered and featurised apart: the model is trained by a run over the training
files only, and judged by another over the test files only: no neighbourhood reaches from one into the other.
P1 trains on the columns 77050 and 77055 of the urban tiles and tests on 77060; P1cv leaves each column out once and
adds up the confusions; P4 trains on one square kilometre and tests on the next. Classes that are not scored (0, 65, 66)
stay in the clouds. A second layer decides where it pays (docs/context.md); `--set classify.context.cells=[]`: never.
`p1train` leaves out one training tile of P1 at a time: for choosing features and parameters, which
the test tiles must not. Data are not part of this repository (public, IGN); without them it says so.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from fwclass import conf
from fwclass.assess.confusion import describe, figures
from fwclass.assess.intervals import difference, intervals
from fwclass.conf import Config
from fwclass.graph.stages import CLASSIFYING, JUDGING, LEARNING
from fwclass.run.local import Loop
from fwclass.run.progress import Display
from fwclass.run.runner import Runner, ancestors, require_all
from fwclass.store.arrays import read_arrays
from fwclass.study.training import training
from fwclass.walk.steps import plan_with_features, tasks_of, tasks_until_labels, until_tiles

DATA = Path(__file__).resolve().parents[2] / ".." / "shared" / "data" / "ign_hd"
COLUMNS = ("77050", "77055", "77060")
ROWS = ("627755", "627760")

PEERS = {
    "p1": (("CSF + jakteristics + scikit-learn forest", 87.7, 82.0, 66.8), ("CGAL classification", 90.1, 85.6, 71.0)),
    "p4": (("CSF + jakteristics + scikit-learn forest", 93.1, 72.3, 53.7), ("CGAL classification", 93.2, 72.4, 53.5)),
}
"""Overall accuracy, kappa and mean IoU [%], measured once by the same protocols."""

Split = tuple[str, tuple[str, ...], tuple[str, ...]]
"""Survey, training files, test files."""


def urban(columns: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"urban_{c}_{r}.laz" for c in columns for r in ROWS)


def splits(protocol: str) -> list[Split]:
    if protocol == "p1":
        return [("p1", urban(COLUMNS[:2]), urban(COLUMNS[2:]))]
    if protocol == "p1cv":
        return [("p1", urban(tuple(c for c in COLUMNS if c != out)), urban((out,))) for out in COLUMNS]
    if protocol == "p1train":
        tiles = urban(COLUMNS[:2])
        return [("p1", tuple(t for t in tiles if t != out), (out,)) for out in tiles]
    return [("p4", ("km_0299_6802.laz",), ("km_0300_6802.laz",))]


def judged(split: Split, seed: int, root: Path, data: Path, settings: tuple[str, ...]) -> tuple[dict[str, Any], Any]:
    """Figures of the test files, and their counts by block; a directory per split, so that seeds share the features."""
    survey, train, test = split
    everywhere = "[[-1.0e+7, -1.0e+7, 1.0e+7, 1.0e+7]]"
    common = (f"survey.directory={data}", *settings, f"train.seed={seed}", "areas.test=[]", "features.also=[]")
    with Display() as display:
        runner = Runner(root / "train", Loop(), display)
        learn = (f"survey.sources=[{', '.join(train)}]", f"areas.train={everywhere}")
        training(conf.load(survey, (*common, *learn)), runner, assess=False)
        model, receipt = runner.store.path("train", "model", "model"), runner.store.receipt("train", "model")
        if receipt and "tried" in receipt.meta:
            print(f"{split[0]}, {len(train)} training files, seed {seed}: {receipt.meta['tried']}")
        apply = (f"survey.sources=[{', '.join(test)}]", f"survey.model={model}", "areas.train=[]")
        return assessed(conf.load(survey, (*common, *apply)), Runner(root / "test", Loop(), display))


def assessed(config: Config, runner: Runner) -> tuple[dict[str, Any], Any]:
    """What `fwclass run` with a model does up to the assessment; nothing is published."""
    plan = until_tiles(plan_with_features(config), runner)
    tasks = tasks_until_labels(plan) + tasks_of(plan, (*LEARNING, *CLASSIFYING, *JUDGING))
    require_all(runner, ancestors(tasks, [("assess", "all")]))
    receipt = runner.store.receipt("assess", "all")
    if receipt is None:
        sys.exit("nothing was assessed")
    counts, _ = read_arrays(runner.store.arrays_path("assess", "all", "counts"))
    return dict(receipt.meta["accuracy"]), counts["blocks"]


def scored(protocol: str, seed: int, root: Path, data: Path, settings: tuple[str, ...]) -> tuple[dict[str, Any], Any]:
    """Figures over all splits of a protocol, and their blocks."""
    parts, blocks = zip(
        *(judged(s, seed, root / f"{protocol}-{k}", data, settings) for k, s in enumerate(splits(protocol))),
        strict=True,
    )
    names = parts[0]["classes"]
    every = np.concatenate(blocks)
    whole = every.sum(axis=0)
    return figures(whole[:, :-1], names, whole[:, -1]), every


def percents(made: dict[str, Any]) -> tuple[float, float, float]:
    overall, kappa, iou = (100 * made[n] for n in ("overall_accuracy", "kappa", "mean_iou"))
    return overall, kappa, iou


def line(name: str, values: tuple[float, ...]) -> str:
    return f"{name:<44}" + "".join(f"{v:>9.2f}" for v in values)


def tell(protocol: str, by_seed: dict[int, tuple[dict[str, Any], Any]]) -> None:
    print(f"\n{protocol}\n{'':<44}{'overall':>9}{'kappa':>9}{'mean IoU':>9}")
    for seed, (made, _) in by_seed.items():
        print(line(f"fwclass, seed {seed}", percents(made)))
    mean = np.mean([percents(made) for made, _ in by_seed.values()], axis=0)
    print(line("fwclass, mean", tuple(mean)))
    for name, *values in PEERS.get(protocol, ()):
        print(line(name, tuple(values)))
        print(line("  ours minus theirs", tuple(mean - values)))
    made, blocks = next(iter(by_seed.values()))
    print(f"\n{describe(made)}")
    ends = intervals(blocks)
    if ends:
        told = ", ".join(
            f"{n} {100 * ends[n][0]:.1f} to {100 * ends[n][1]:.1f}" for n in ("overall_accuracy", "mean_iou")
        )
        print(f"95 % intervals from {ends['blocks']} blocks: {told}")
    for a, b in itertools.pairwise(by_seed):
        gain = difference(by_seed[a][1], by_seed[b][1])
        if gain:
            low, high = (100 * v for v in gain["overall_accuracy"]["interval"])
            print(f"seed {b} minus seed {a}, overall: {low:+.2f} to {high:+.2f} points")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("protocols", nargs="*", default=["p1", "p1cv", "p4"])
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--seeds", default="1,2,3")
    parser.add_argument("--set", dest="settings", action="append", default=[])
    chosen = parser.parse_args()
    unknown = set(chosen.protocols) - {"p1", "p1cv", "p1train", "p4"}
    if unknown:
        parser.error(f"no such protocol: {', '.join(sorted(unknown))}")
    if not (chosen.data / "km_0299_6802.laz").exists():
        sys.exit(f"no data in {chosen.data}: nothing measured")
    with tempfile.TemporaryDirectory() as scratch:
        root = (chosen.out or Path(scratch)).resolve()
        for protocol in chosen.protocols:
            seeds = [int(s) for s in chosen.seeds.split(",")]
            made = {s: scored(protocol, s, root, chosen.data.resolve(), tuple(chosen.settings)) for s in seeds}
            tell(protocol, made)


if __name__ == "__main__":
    main()
