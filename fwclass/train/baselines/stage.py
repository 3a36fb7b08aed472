"""Training of classifiers of other kinds, on the forest's own sample."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from fwclass import __version__
from fwclass.hashing import seed_for
from fwclass.model import (
    FORMAT,
    Boosted,
    ClassDef,
    ClassifierMethod,
    KernelMachine,
    LinearMachine,
    Model,
    Preparation,
    assemble,
)
from fwclass.model.ranges import RANGES, ranges_of
from fwclass.train.baselines import fit
from fwclass.train.baselines.params import CompareParams
from fwclass.train.baselines.prepare import fewer, preparation
from fwclass.train.baselines.search import BY_PULSES, Places, search, search_rows
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample, review
from fwclass.train.stage import card, grow_trees, train
from fwclass.train.trim import trim_rows
from fwclass.train.weights import whole_weights

METHODS: tuple[ClassifierMethod, ...] = get_args(ClassifierMethod)
"""All of them, the forest first."""

VERSION = 2
"""Raised whenever the same sample and parameters would give another model."""


def train_other(
    sample: Sample,
    params: TrainParams,
    compare: CompareParams,
    classes: Sequence[ClassDef],
    method: str,
    places: Places = BY_PULSES,
    search_result: Mapping[str, Any] | None = None,
) -> Model:
    """The classifier `method` (one of `METHODS` but the forest), trained on `sample` by scikit-learn.

    Support vector machines fill missing values with the median of the training rows, and the card says how many; trees
    have a side for them. Class weights are those of ``train.class_weights``.

    `places`: how the RBF SVM thins its rows and folds those of its search; `search_result`: what `searched` says of
    that search, where it ran before.

    `ConfigError`: scikit-learn is not installed. `InputError`: the sample cannot be trained on.
    """
    notes = review(sample, classes)
    if method == "rbf-svm":
        return _rbf(
            sample, params, compare, classes, _card(sample, params, classes, method, notes), places, search_result
        )
    return {"linear-svm": _linear, "sklearn-forest": _forest, "boosting": _boosting}[method](
        sample, params, compare, classes, _card(sample, params, classes, method, notes)
    )


def fit_classifier(
    sample: Sample,
    params: TrainParams,
    compare: CompareParams,
    classes: Sequence[ClassDef],
    places: Places = BY_PULSES,
    judged: bool = True,
) -> Model:
    """A classifier of the kind that `params` names, forests too; of these the card has the accuracy out of bag where it
    is `judged`. `places` as in `train_other`."""
    if params.method != "forest":
        return train_other(sample, params, compare, classes, params.method, places)
    trees = grow_trees(sample, classes, 0, params.trees, params)
    return train(sample, trees, params, classes) if judged else assemble(trees, card(sample, classes, params))


def _card(
    sample: Sample, params: TrainParams, classes: Sequence[ClassDef], method: str, notes: Sequence[str]
) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "method": method,
        "features": list(sample.features),
        "classes": [c.plain() for c in classes],
        "params": {"samples_per_class": params.samples_per_class, "seed": params.seed},
        "samples": [int(n) for n in sample.counts],
        "eligible": [int(n) for n in sample.eligible],
        "training": sample.digest,
        "fwclass": __version__,
        "notes": list(notes),
        RANGES: ranges_of(sample.X, sample.features),
    }


def machine_weights(sample: Sample, params: TrainParams, classes: Sequence[ClassDef]) -> dict[int, float] | None:
    """Weight of every class by its index [that of the mean row], None where all weigh the same."""
    whole = whole_weights(params.class_weights, sample.counts, [c.name for c in classes])
    if len(set(whole.tolist())) == 1:
        return None
    mean = float(whole @ sample.counts) / sample.rows
    return {k: float(w) / mean for k, w in enumerate(whole)}


def _prepare(sample: Sample, compare: CompareParams, card: dict[str, Any]) -> Preparation:
    """How a machine's samples are prepared; the card tells it, and how many values of the training rows are filled."""
    prepare = preparation(sample.X, compare.scaling)
    gaps = np.isnan(sample.X).sum(axis=0)
    filled = {name: int(n) for name, n in zip(sample.features, gaps, strict=True) if n}
    card |= {"preparation": prepare.plain(), "filled": filled}
    card["params"]["scaling"] = compare.scaling
    if filled:
        counts = ", ".join(f"{name} in {n:,} rows" for name, n in filled.items())
        card["notes"].append(f"missing values are the median of the training rows: {counts}")
    return prepare


def _linear(
    sample: Sample, params: TrainParams, compare: CompareParams, classes: Sequence[ClassDef], card: dict[str, Any]
) -> Model:
    prepare, svm = _prepare(sample, compare, card), compare.linear_svm
    weights, bias, notes = fit.linear_svm(prepare(sample.X), sample.y, svm, machine_weights(sample, params, classes))
    card["params"] |= svm.model_dump(mode="json")
    card["notes"] += notes
    return _check(LinearMachine(weights, bias, card))


def _rbf(
    sample: Sample,
    params: TrainParams,
    compare: CompareParams,
    classes: Sequence[ClassDef],
    card: dict[str, Any],
    places: Places = BY_PULSES,
    search_result: Mapping[str, Any] | None = None,
) -> Model:
    svm, whole, all_rows = compare.rbf_svm, sample.rows, sample
    sample = fewer(sample, svm.max_rows, places.edge)
    if sample.rows < whole:
        alike = f", alike by class and by squares of {places.edge:g} m" if places.edge and len(sample.place) else ""
        card["notes"].append(
            f"the RBF SVM trained on {sample.rows:,} of {whole:,} rows{alike}: its time grows with their square "
            "(compare.rbf_svm.max_rows)"
        )
        card["samples"] = [int(n) for n in sample.counts]
    prepare, weights = _prepare(sample, compare, card), machine_weights(sample, params, classes)
    c, gamma = svm.c[0], svm.gamma[0]
    if len(svm.c) * len(svm.gamma) > 1:
        searched = search_rows(all_rows, svm, places.edge)
        search_result = search_result or search(
            searched, places.folding(searched, svm.folds), svm, compare.scaling, weights
        )
        c, gamma = search_result["c"], search_result["gamma"]
        card["search"] = {n: search_result[n] for n in ("rows", "folds", "blocks", "tried")}
        card["notes"] += [search_result["note"]] if search_result["note"] else []
    card["params"] |= {"c": c, "gamma": gamma, "trim": svm.trim}
    X, y = prepare(sample.X), sample.y
    clean, whole_classes = trim_rows(X, y, svm.trim)
    if svm.trim != "none":
        card |= _trimming_facts(clean, y, whole_classes, classes, card)
    return _check(KernelMachine(**fit.rbf_svm(X[clean], y[clean], c, gamma, weights), card=card))


def _trimming_facts(
    clean: NDArray[np.bool_], y: NDArray[np.uint8], whole: Sequence[int], classes: Sequence[ClassDef], card: Any
) -> dict[str, Any]:
    """What the card says of trimming: rows that went, per class, and classes that stay untrimmed."""
    went = np.bincount(y[~clean], minlength=len(classes))
    notes = [f"{int(went.sum()):,} of {len(y):,} training rows lie among those of another class and were trimmed"]
    notes += [f"every row of class {classes[k].name!r} lies among those of others: it stays untrimmed" for k in whole]
    return {"trimmed": {c.name: int(n) for c, n in zip(classes, went, strict=True)}, "notes": [*card["notes"], *notes]}


def _forest(
    sample: Sample, params: TrainParams, compare: CompareParams, classes: Sequence[ClassDef], card: dict[str, Any]
) -> Model:
    settings: Mapping[str, Any] = {
        "n_estimators": params.trees,
        "criterion": params.criterion,
        "max_features": params.per_split(len(sample.features)),
        "min_samples_split": params.min_samples_split,
        "max_samples": params.bagging if params.bagging < 1 else None,
        "bootstrap": True,
        "random_state": seed_for(params.seed) % (1 << 32),
    }
    card["params"] |= settings
    weights = machine_weights(sample, params, classes)
    trees, impure = fit.sklearn_forest(sample.X, sample.y, {**settings, "class_weight": weights})
    if impure:
        card["notes"].append(f"{impure:,} leaves are not pure; each votes for its largest class")
    return assemble(trees, card)


def _boosting(
    sample: Sample, params: TrainParams, compare: CompareParams, classes: Sequence[ClassDef], card: dict[str, Any]
) -> Model:
    card["params"] |= compare.boosting.model_dump(mode="json")
    weights = machine_weights(sample, params, classes)
    arrays = fit.boosting(sample.X, sample.y, compare.boosting, seed_for(params.seed), weights)
    return _check(Boosted(**arrays, card=card))


def _check(model: Any) -> Model:
    model.card["kind"] = model.kind
    model.check("a newly trained model")
    return model
