"""The RBF machine beside scikit-learn's `SVC.predict`, scikit-learn-intelex and its own double precision, one thread.

    python tests/bench/bench_kernel_machine.py [--rows N]

CPU time, the least of five runs; classes that differ are counted. Intelex is left out where it is not installed.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from sklearn.svm import SVC
from threadpoolctl import threadpool_limits

from fwclass import conf
from fwclass.classify.machines import double_decisions, votes_and_shares
from fwclass.classify.shares import answer
from fwclass.classify.support_blocks import support_blocks
from fwclass.graph.machine_search import folds_of_squares
from fwclass.model import FORMAT, ClassDef, KernelMachine
from fwclass.train.baselines.fit import rbf_svm
from fwclass.train.baselines.stage import train_other
from fwclass.train.sample import Sample
from fwclass.train.trim import trim_rows

CASES = ((4, 4, 4_000, 10.0, 0.5), (4, 6, 7_000, 10.0, 0.25), (2, 4, 5_000, 100.0, 0.5), (4, 4, 3_500, 1000.0, 1.0))
"""Classes, features, training rows, C, gamma: some 1 600 to 1 900 support vectors."""


def problem(n: int, features: int, rows: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Overlapping classes about fixed centres."""
    r, centre = np.random.default_rng(seed), np.random.default_rng(0).normal(size=(n, features)) * 1.5
    y = r.integers(0, n, rows)
    return (r.normal(size=(rows, features)) + centre[y]).astype(np.float32), y.astype(np.uint8)


def least(work: Callable[[], Any], rows: int, repeats: int = 5) -> float:
    """Microseconds of CPU a row."""
    spent = []
    for _ in range(repeats):
        begun = time.process_time()
        work()
        spent.append(time.process_time() - begun)
    return min(spent) / rows * 1e6


def intelex(X: np.ndarray, y: np.ndarray, c: float, gamma: float) -> Any:
    try:
        from sklearnex.svm import SVC as Other
    except ImportError:
        return None
    return Other(C=c, gamma=gamma).fit(X, y)


def case(n: int, features: int, learn: int, c: float, gamma: float, rows: int) -> str:
    (X, y), (T, _) = problem(n, features, learn, 1), problem(n, features, rows, 2)
    wide, fresh = X.astype(np.float64), T.astype(np.float64)
    plain = {"fill": [0.0] * features, "shift": [0.0] * features, "scale": [1.0] * features}
    classes = [{"name": str(k), "code": k, "codes": [k]} for k in range(n)]
    card = {"format": FORMAT, "features": [f"f{k}" for k in range(features)], "classes": classes, "preparation": plain}
    with threadpool_limits(1):
        model = KernelMachine(**rbf_svm(wide, y, c, gamma, None), card=card)
        peer, other = SVC(C=c, gamma=gamma).fit(wide, y), intelex(wide, y, c, gamma)
        winner = answer(T, model)[0]
        ours = least(lambda: answer(T, model), rows)
        double = least(lambda: votes_and_shares(double_decisions(fresh, model), n), rows, 2)
        theirs = least(lambda: peer.predict(fresh), rows, 2)
        beside = least(lambda: other.predict(fresh), rows) if other else None
        differ = int((peer.predict(fresh) != winner).sum())
    blocks = support_blocks(model)
    assert blocks is not None
    decisions, bound = blocks(fresh, model.bias)
    again = float((np.abs(decisions) <= bound).any(axis=1).mean())
    third = f", intelex {beside:.1f} ({beside / ours:.1f} x)" if beside else ""
    return (
        f"{n} classes, {features} features, C {c:g}, gamma {gamma:g}, {len(model.vectors)} support vectors: "
        f"{ours:.2f} us a row; scikit-learn {theirs:.1f} ({theirs / ours:.1f} x), "
        f"double precision {double:.1f} ({double / ours:.1f} x){third}; "
        f"{again:.2%} answered twice, {differ} of {rows} classes differ"
    )


def of_trimmed(n: int, features: int, learn: int, c: float, gamma: float, rows: int) -> str:
    """The machine of trimmed rows beside scikit-learn's of all."""
    (X, y), (T, truth) = problem(n, features, learn, 1), problem(n, features, rows, 2)
    wide, fresh = X.astype(np.float64), T.astype(np.float64)
    plain = {"fill": [0.0] * features, "shift": [0.0] * features, "scale": [1.0] * features}
    classes = [{"name": str(k), "code": k, "codes": [k]} for k in range(n)]
    card = {"format": FORMAT, "features": [f"f{k}" for k in range(features)], "classes": classes, "preparation": plain}
    with threadpool_limits(1):
        began = time.process_time()
        kept, _ = trim_rows(wide, y, "nearest")
        model = KernelMachine(**rbf_svm(wide[kept], y[kept], c, gamma, None), card=card)
        fitted = time.process_time() - began
        began = time.process_time()
        peer = SVC(C=c, gamma=gamma).fit(wide, y)
        fitted_peer = time.process_time() - began
        right = float((answer(T, model)[0] == truth).mean()), float((peer.predict(fresh) == truth).mean())
        ours, theirs = least(lambda: answer(T, model), rows), least(lambda: peer.predict(fresh), rows, 2)
    return (
        f"{learn} rows of {features} features, trimmed: {len(model.vectors)} support vectors, {ours:.2f} us a row, "
        f"right {right[0]:.2%}, trained in {fitted:.2f} s; scikit-learn's of all rows {int(peer.n_support_.sum())}, "
        f"{theirs:.1f} us ({theirs / ours:.1f} x), right {right[1]:.2%}, {fitted_peer:.2f} s"
    )


def of_many(rows: int = 100_000, features: int = 6) -> str:
    X, y = problem(4, features, rows, 3)
    began = time.process_time()
    kept, _ = trim_rows(X.astype(np.float64), y, "nearest")
    return f"trimming {rows} rows of {features} features: {time.process_time() - began:.2f} s, {kept.mean():.1%} stay"


def of_search(rows: int = 16_000, features: int = 6, folds: int = 5) -> str:
    """12 pairs of C and gamma in `folds` of squares, then a machine of 12 000 rows, trimmed and not."""
    X, y = problem(4, features, rows, 4)
    r = np.random.default_rng(5)
    place, key = r.integers(0, 400_000, (rows, 2)), np.arange(rows, dtype=np.uint64)
    counts = np.bincount(y, minlength=4).astype(np.int64)
    names = tuple(f"f{k}" for k in range(features))
    sample = Sample(names, X, y, key, r.permutation(rows).astype(np.uint64), counts, place=place)
    classes = tuple(ClassDef(str(k), k + 2, (k + 2,)) for k in range(4))
    config = conf.load("demo")
    params, told = config.train.model_copy(update={"method": "rbf-svm"}), []
    for trim in ("none", "nearest"):
        svm = config.compare.rbf_svm.model_copy(update={"folds": folds, "trim": trim})
        compare = config.compare.model_copy(update={"rbf_svm": svm})
        began = time.process_time()
        model = train_other(sample, params, compare, classes, "rbf-svm", folds_of_squares(50.0, 5.0))
        told.append(f"{time.process_time() - began:.1f} s ({trim}, {len(model.vectors)} support vectors)")
    tried = len(svm.c) * len(svm.gamma)
    return f"search of {tried} pairs in {folds} folds of {svm.search_rows} rows, and {svm.max_rows} rows: " + ", ".join(
        told
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=20_000)
    rows = parser.parse_args().rows
    for one in CASES:
        print(case(*one, rows))
    print(of_trimmed(4, 4, 12_000, 10.0, 0.5, rows))
    print(of_many())
    print(of_search())


if __name__ == "__main__":
    main()
