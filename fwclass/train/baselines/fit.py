"""The only file that meets scikit-learn: a classifier is fitted there and comes back as arrays of our own."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import ConfigError
from fwclass.train.baselines.params import BoostingParams, LinearSvmParams
from fwclass.train.baselines.trees import FLAT, boosted_tree, voting_tree

MISSING = np.float32(1e30)
"""Stands for NaN where a forest of scikit-learn is trained: greater than any value, so it goes right at every node, as
NaN does in ours."""

Labels = NDArray[np.uint8]


def _sklearn(module: str) -> Any:
    """A module of scikit-learn; `ConfigError` where it is not installed."""
    import importlib

    try:
        return importlib.import_module(f"sklearn.{module}")
    except ImportError as fault:
        raise ConfigError(
            "this classifier is trained by scikit-learn, which is not installed",
            where="train.method",
            got=str(fault),
            do="pip install 'fwclass[compare]', or train.method=forest; classifying needs nothing",
        ) from fault


@contextmanager
def _one_thread() -> Iterator[None]:
    """Parts are what runs in parallel, not a library inside of one."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        yield


def linear_svm(
    X: NDArray[np.float64], y: Labels, params: LinearSvmParams, weights: dict[int, float] | None
) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[str, ...]]:
    """Weights (scores, features) and bias (scores,) of `LinearMachine`, and remarks; squared hinge, primal."""
    svm = _sklearn("svm").LinearSVC(
        C=params.c, tol=params.tolerance, max_iter=params.iterations, dual=False, class_weight=weights
    )
    with _one_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        svm.fit(X, y)
    ended = int(np.max(svm.n_iter_)) < params.iterations
    notes = () if ended else (f"the linear SVM stopped after {params.iterations} iterations without an end",)
    return np.array(svm.coef_, np.float64), np.array(svm.intercept_, np.float64), notes


def rbf_svm(
    X: NDArray[np.float64], y: Labels, c: float, gamma: float, weights: dict[int, float] | None
) -> dict[str, NDArray]:
    """Fit a support vector machine with a Gaussian kernel; the arrays of `KernelMachine` by name, of its shapes.

    X is (rows, features), prepared.
    """
    with _one_thread():
        svm = _svc(c, gamma, weights).fit(X, y)
    sign = -1.0 if len(svm.classes_) == 2 else 1.0  # scikit-learn turns the one pair round
    return {
        "vectors": np.ascontiguousarray(svm.support_vectors_, np.float64),
        "dual": np.ascontiguousarray(sign * svm.dual_coef_, np.float64),
        "bias": np.array(sign * svm.intercept_, np.float64),
        "counts": np.array(svm.n_support_, np.int64),
        "gamma": np.array([gamma]),
    }


def _svc(c: float, gamma: float, weights: dict[int, float] | None) -> Any:
    return _sklearn("svm").SVC(
        C=c, kernel="rbf", gamma=gamma, decision_function_shape="ovo", class_weight=weights, cache_size=500
    )


def count_right(
    X: NDArray[np.float64],
    y: Labels,
    learns: NDArray[np.bool_],
    judged: NDArray[np.bool_],
    c: float,
    gamma: float,
    weights: dict[int, float] | None,
) -> int:
    """How many of the rows `judged` the machine of the rows `learns`, bool (rows,) both, answers right; 0 where these
    are of one class. X is float64 (rows, features), without NaN."""
    if len(np.unique(y[learns])) < 2 or not judged.any():
        return 0
    of_present = {k: w for k, w in weights.items() if (y[learns] == k).any()} if weights else None
    with _one_thread():
        svm = _svc(c, gamma, of_present).fit(X[learns], y[learns])
        return int((svm.predict(X[judged]) == y[judged]).sum())


def sklearn_forest(
    X: NDArray[np.float32], y: Labels, settings: dict[str, Any]
) -> tuple[list[tuple[NDArray, NDArray, NDArray]], int]:
    """(feature, threshold, child) of every tree as in `Forest`, and how many leaves are not pure.

    A leaf that is not pure votes for its largest class, the first on a tie; scikit-learn averages its shares instead.
    """
    forest = _sklearn("ensemble").RandomForestClassifier(**settings, n_jobs=1)
    with _one_thread():
        forest.fit(np.where(np.isnan(X), MISSING, X), y)
    classes = forest.classes_.astype(np.int64)
    trees = [voting_tree(tree.tree_, classes) for tree in forest.estimators_]
    return [m[:3] for m in trees], sum(m[3] for m in trees)


def boosting(X: NDArray[np.float32], y: Labels, params: BoostingParams, seed: int, weights: Any) -> dict[str, NDArray]:
    """Fit gradient boosting to X (rows, features); the arrays of `Boosted` by name."""
    model = _sklearn("ensemble").HistGradientBoostingClassifier(
        max_iter=params.rounds,
        learning_rate=params.learning_rate,
        max_leaf_nodes=params.leaves,
        max_depth=None,
        min_samples_leaf=params.min_samples_leaf,
        l2_regularization=params.l2,
        max_bins=params.bins,
        early_stopping=False,
        random_state=seed % (1 << 32),
        class_weight=weights,
        categorical_features=None,
    )
    with _one_thread():
        model.fit(X, y)
    trees = [boosted_tree(one.nodes) for rounds in model._predictors for one in rounds]
    flat = {name: np.concatenate([t[name] for t in trees]) for name in FLAT}
    offsets = np.zeros(len(trees) + 1, np.int64)
    np.cumsum([len(t["feature"]) for t in trees], out=offsets[1:])
    return {**flat, "offsets": offsets, "baseline": np.array(model._baseline_prediction, np.float64).ravel()}
