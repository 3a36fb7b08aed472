"""Every kind of classifier on one sample and the same rows, beside scikit-learn's own prediction on one thread.

``python tests/bench/bench_compare.py [--run RUN]``: the sample of a run directory (its odd rows are judged), or a
synthetic problem. CPU seconds of one thread.
"""

from __future__ import annotations

import argparse
import statistics
from pathlib import Path

import numpy as np
import yaml

from fwclass.classify.shares import answer
from fwclass.model import ClassDef
from fwclass.store.arrays import read_arrays
from fwclass.store.models import load_model
from fwclass.store.run_store import Store
from fwclass.study.compare import cpu_time
from fwclass.train.baselines.params import CompareParams
from fwclass.train.baselines.prepare import fewer
from fwclass.train.baselines.stage import METHODS, fit_classifier
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample

ROOT = Path(__file__).resolve().parents[2]
BASE = yaml.safe_load((ROOT / "conf" / "base.yaml").read_text())


def synthetic(n, seed=1):
    """Four overlapping classes and six features."""
    r = np.random.default_rng(seed)
    y = r.integers(0, 4, n).astype(np.uint8)
    X = r.normal(size=(n, 6)) + np.random.default_rng(0).normal(size=(4, 6))[y]
    names = ("zc", "echo_number", "amplitude", "echo_ratio_r100", "inclination_r100", "width")
    counts = np.bincount(y, minlength=4).astype(np.int64)
    key = np.arange(n, dtype=np.uint64)
    sample = Sample(names, X.astype(np.float32), y, key, r.permutation(n).astype(np.uint64), counts)
    return sample, tuple(ClassDef(str(k), k + 1, (k + 1,)) for k in range(4))


def of_run(root):
    """The sample of a run, and its model's classes."""
    store = Store(root)
    arrays, _ = read_arrays(store.arrays_path("training", "all", "sample"))
    model = load_model(store.path("train", "model", "model"))
    return Sample.from_arrays(model.features, arrays), model.classes


def peer_time(method, learn, fresh, params, compare):
    """CPU seconds of scikit-learn's own prediction of `fresh`; None for what it has no peer of."""
    from sklearn.ensemble import HistGradientBoostingClassifier, RandomForestClassifier
    from sklearn.svm import SVC, LinearSVC
    from threadpoolctl import threadpool_limits

    known = [np.where(np.isnan(a), 0, a) for a in (learn.X, fresh)]
    spread = known[0].std(axis=0) + 1e-9
    forest = RandomForestClassifier(
        params.trees, criterion=params.criterion, max_features=params.per_split(6), n_jobs=1
    )
    svm, boost = compare.rbf_svm, compare.boosting
    peers = {
        "forest": forest,
        "sklearn-forest": forest,
        "linear-svm": LinearSVC(dual=False),
        "rbf-svm": SVC(C=svm.c[0], gamma=svm.gamma[0]),
        "boosting": HistGradientBoostingClassifier(
            max_iter=boost.rounds, max_leaf_nodes=boost.leaves, early_stopping=False, max_bins=boost.bins
        ),
    }
    rows = fewer(learn, svm.max_rows) if method == "rbf-svm" else learn
    X = np.where(np.isnan(rows.X), 0, rows.X)
    with threadpool_limits(1):
        peer = peers[method].fit(X / spread, rows.y)
        return cpu_time(lambda: peer.predict(known[1] / spread))[0]


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("--run", type=Path, help="run directory")
    words.add_argument("--rows", type=int, default=20_000)
    words.add_argument("--repeat", type=int, default=3)
    given = words.parse_args()
    whole, classes = of_run(given.run) if given.run else synthetic(2 * given.rows)
    learn, fresh = whole.take(np.arange(0, whole.rows, 2)), whole.take(np.arange(1, whole.rows, 2))
    params, compare = TrainParams(**BASE["train"]), CompareParams(**BASE["compare"])
    print(f"{learn.rows:,} rows train, {fresh.rows:,} are judged, {len(learn.features)} features; CPU seconds")
    print(f"{'':16}{'accuracy %':>11}{'training':>10}{'predict':>9}{'sklearn':>9}{'ratio':>7}")
    for method in METHODS:
        asked = params.model_copy(update={"method": method})
        answer(fresh.X[:64], fit_classifier(fewer(learn, 200), asked, compare, classes, judged=False))  # compile
        train, model = cpu_time(lambda p=asked: fit_classifier(learn, p, compare, classes, judged=False))
        ratios, ours, theirs = [], [], []
        for _ in range(given.repeat):
            seconds, (winner, _) = cpu_time(lambda model=model: answer(fresh.X, model))
            peer = peer_time(method, learn, fresh.X, params, compare)
            ours.append(seconds)
            theirs.append(peer)
            ratios.append(peer / seconds)
        told = [statistics.median(v) for v in (ours, theirs, ratios)]
        right = 100 * (winner == fresh.y).mean()
        print(f"{method:16}{right:11.2f}{train:10.2f}{told[0]:9.3f}{told[1]:9.3f}{told[2]:7.1f}")


if __name__ == "__main__":
    main()
