"""Training and prediction beside scikit-learn, both on one thread: ``python tests/bench/bench_forest.py``."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import yaml
from sklearn.ensemble import RandomForestClassifier

from fwclass.classify.stage import votes
from fwclass.model import FORMAT, assemble
from fwclass.train.stage import TrainParams, grow_tree

ROOT = Path(__file__).resolve().parents[2]


def problem(n, seed):
    """Three overlapping classes and six features, one of them a small whole number."""
    r = np.random.default_rng(seed)
    y = r.integers(0, 3, n).astype(np.uint8)
    centre = np.array([[0, 0, 0, 0, 0, 0], [2.2, 1, 0.5, 1, 0.5, 0.3], [1, 2, -1, 0.5, 1.2, 0.4]])
    X = (r.normal(size=(n, 6)) + centre[y]).astype(np.float32)
    X[:, 3] = np.rint(X[:, 3])
    return X, y


def timed(work):
    """CPU seconds of this process, and what the work gave."""
    start = time.process_time()
    made = work()
    return time.process_time() - start, made


def ours(X, y, params):
    trees = [grow_tree(X, y, 3, t, params) for t in range(params.trees)]
    classes = [{"name": str(c), "code": c} for c in range(3)]
    return assemble(trees, {"format": FORMAT, "features": list("abcdef"), "classes": classes})


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--rows", type=int, default=60_000)
    asked.add_argument("--predict", type=int, default=200_000)
    rows = asked.parse_args()
    params = TrainParams(**yaml.safe_load((ROOT / "conf" / "base.yaml").read_text())["train"])
    X, y = problem(rows.rows, 1)
    fresh, truth = problem(rows.predict, 2)
    votes(fresh[:100], ours(X[:500], y[:500], params))  # compile
    grown, forest = timed(lambda: ours(X, y, params))
    cast, counted = timed(lambda: votes(fresh, forest))
    peer = RandomForestClassifier(
        params.trees, criterion="entropy", max_features=params.per_split(6), random_state=1, n_jobs=1
    )
    fitted, _ = timed(lambda: peer.fit(X, y))
    asked_peer, answer = timed(lambda: peer.predict(fresh))
    mine, theirs = (counted.argmax(axis=1) == truth).mean(), (answer == truth).mean()
    per_tree = len(forest.feature) / forest.trees
    peer_nodes = np.mean([e.tree_.node_count for e in peer.estimators_])
    print(f"{rows.rows} rows, 6 features, 3 classes, {params.trees} trees; CPU seconds of one thread")
    print(f"{'':24}{'fwclass':>10}{'sklearn':>10}{'ratio':>8}")
    print(f"{'training [s]':24}{grown:10.2f}{fitted:10.2f}{fitted / grown:8.1f}")
    print(
        f"{'prediction [M rows/s]':24}{len(fresh) / cast / 1e6:10.3f}{len(fresh) / asked_peer / 1e6:10.3f}"
        f"{asked_peer / cast:8.1f}"
    )
    print(f"{'accuracy [%]':24}{100 * mine:10.2f}{100 * theirs:10.2f}{100 * (mine - theirs):+8.2f}")
    print(f"{'nodes per tree':24}{per_tree:10.0f}{peer_nodes:10.0f}")


if __name__ == "__main__":
    main()
