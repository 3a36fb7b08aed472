"""Work of the papers' parts: data, models, answers, times, importances."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.assess.confusion import confusion_by_square
from fwclass.assess.intervals import FIGURES, class_gains, difference, intervals, scores
from fwclass.classify.shares import answer
from fwclass.errors import InputError
from fwclass.graph.areas import rows_to_test
from fwclass.graph.machine_search import folds_of_squares
from fwclass.graph.stage_work import StageInputs
from fwclass.graph.training_rows import SAMPLE, merged_sample
from fwclass.grid import Box, millimetres, whole_millimetres
from fwclass.hashing import hash_keys
from fwclass.model import ClassDef, Forest, KernelMachine, Model, Tree, class_index, sample_matrix
from fwclass.run.inputs import PartInputs
from fwclass.schema import canonical_key
from fwclass.store.arrays import write_arrays
from fwclass.store.models import load_model, save_model
from fwclass.train.baselines.params import CompareParams
from fwclass.train.baselines.prepare import fewer
from fwclass.train.baselines.search import BY_PULSES
from fwclass.train.baselines.stage import fit_classifier
from fwclass.train.importance import drops, summary
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample
from fwclass.train.stage import grow_trees

TEST, MODEL, DROPS, ANSWERS = "test", "model", "drops", "answers"
DRAWN, TRAINING, TESTED = "paper-sample", "paper-training", "paper-tested"
MODELS, JUDGED, DROPPED = "paper-model", "paper-judged", "paper-drops"
"""Stages that others read: rows of a tile, the sample, the test echoes; models, their answers, drops of accuracy."""
WARM_ROWS = 2000
"""Rows that a timing begins with and does not count: compiled code is loaded then."""


@dataclass(frozen=True)
class Variant:
    """A classifier that differs from the run's own.

    Attributes
    ----------
    name : of its parts.
    features : what it decides by, of those of the sample.
    train : its method and parameters; the sample's are those of the configuration.
    classes : how many of `all_classes` it knows, the first.
    rows : so many rows of the sample train it at most; 0 is all.
    squares : edge of the squares that a machine's rows are thinned and its search is folded by, and their gap [m];
        None: pieces of consecutive pulses.
    filtered : index of the class that the ground filter answers; the classifier knows the others. None: it knows all.
    """

    name: str
    features: tuple[str, ...]
    train: TrainParams
    classes: int
    rows: int = 0
    squares: tuple[float, float] | None = None
    filtered: int | None = None


def draw_test_echoes(
    here: StageInputs,
    names: tuple[str, ...],
    also: tuple[str, ...],
    train: tuple[Box, ...],
    test: tuple[Box, ...],
    gap: float,
    classes: tuple[ClassDef, ...],
    share: float,
    seed: int,
) -> dict[str, Any]:
    """A share of the tile's labelled echoes in the test areas, drawn by hash, with features, places and `also`."""
    table = here.own_rows()
    index = class_index(table["reference"], classes)
    key = canonical_key(table)
    sampled = hash_keys(seed, key) < np.uint64(min(share * 2.0**64, 2.0**64 - 2048))
    rows = np.flatnonzero(rows_to_test(table, train, test, gap) & (index >= 0) & sampled)
    arrays: dict[str, NDArray] = {
        "X": sample_matrix(table.take(rows), names, here.part),
        "y": index[rows].astype(np.uint8),
        "key": key[rows],
        "east": millimetres(table["x"][rows]),
        "north": millimetres(table["y"][rows]),
        **{name: table[name][rows] for name in also},
    }
    write_arrays(here.directory / TEST, arrays)
    return {"rows": len(rows)}


def gather_test_echoes(here: StageInputs) -> dict[str, Any]:
    """The test echoes of all tiles, by key."""
    parts = [here.inputs.arrays(stage, tile, TEST)[0] for stage, tile in here.needs]
    order = np.argsort(np.concatenate([p["key"] for p in parts]), kind="stable")
    if len(order) == 0:
        raise InputError(
            "no labelled echo lies in a test area", where="areas.test, areas.gap", do="name areas with a reference"
        )
    write_arrays(here.directory / TEST, {n: np.concatenate([p[n] for p in parts])[order] for n in parts[0]})
    return {"rows": len(order)}


def merge_sample(
    here: StageInputs, names: tuple[str, ...], params: TrainParams, classes: tuple[ClassDef, ...]
) -> dict[str, Any]:
    """The sample of all tiles."""
    tiles = here.parts(DRAWN)
    if not tiles:
        raise InputError("no echo lies in any training area", where="areas.train", do="give boxes on the survey")
    sample = merged_sample(here.inputs, DRAWN, tiles, {n: here.columns[n] for n in names}, params)
    write_arrays(here.directory / SAMPLE, sample.arrays())
    return {"rows": sample.rows, "counts": sample.counts.tolist(), "eligible": sample.eligible.tolist()}


def sample_for(inputs: PartInputs, names: tuple[str, ...], one: Variant) -> Sample:
    """The sample with the columns and the classes that a variant knows; `Variant.rows` rows of it."""
    whole = Sample.from_arrays(names, inputs.arrays(TRAINING, "all", SAMPLE)[0])
    known = _known(one)
    rows = np.isin(whole.y, known)
    X = np.ascontiguousarray(whole.X[rows][:, [names.index(f) for f in one.features]])
    y = np.searchsorted(known, whole.y[rows]).astype(np.uint8)
    sample = Sample(one.features, X, y, whole.key[rows], whole.hash[rows], whole.eligible[known])
    sample = replace(sample, place=whole.place[rows]) if len(whole.place) else sample
    return fewer(sample, one.rows) if one.rows else sample


def _known(one: Variant) -> NDArray[np.int64]:
    """Indices of the classes that a variant's classifier knows."""
    return np.array([k for k in range(one.classes) if k != one.filtered], np.int64)


def fit_variant(sample: Sample, one: Variant, compare: CompareParams, classes: tuple[ClassDef, ...]) -> Model:
    """A variant's classifier, trained on `sample`; `classes` are all, also those that it does not know."""
    places = folds_of_squares(*one.squares) if one.squares else BY_PULSES
    return fit_classifier(sample, one.train, compare, tuple(classes[k] for k in _known(one)), places)


def learn(
    here: StageInputs, one: Variant, names: tuple[str, ...], compare: CompareParams, classes: tuple[ClassDef, ...]
) -> dict[str, Any]:
    """A variant's model."""
    model = fit_variant(sample_for(here.inputs, names, one), one, compare, classes)
    save_model(here.directory / MODEL, model)
    card = model.card
    bag = card.get("out_of_bag") or {}
    return {
        "rows": int(np.sum(card["samples"])),
        "notes": list(card.get("notes", ())),
        "out_of_bag": bag.get("accuracy"),
        "nodes": len(model.feature) if isinstance(model, Forest) else None,
        "vectors": len(model.vectors) if isinstance(model, KernelMachine) else None,
        "params": {n: card["params"].get(n) for n in ("c", "gamma")},
    }


def _model(inputs: PartInputs, name: str) -> Model:
    return load_model(inputs.path(MODELS, name, MODEL))


def _test_echoes(inputs: PartInputs) -> dict[str, NDArray]:
    return inputs.arrays(TESTED, "all", TEST)[0]


def judge(
    here: StageInputs, one: Variant, names: tuple[str, ...], classes: tuple[ClassDef, ...], edge: float
) -> dict[str, Any]:
    """Confusion of a variant on the test echoes: rows are all classes, columns those that it tells.

    The answers (uint8, index of the class) are kept for comparisons between variants.
    """
    model, test = _model(here.inputs, one.name), _test_echoes(here.inputs)
    X = np.ascontiguousarray(test["X"][:, [names.index(f) for f in model.features]])
    answers, _ = answer(X, model)
    if one.filtered is not None:
        answers = np.where(test["ground"], one.filtered, _known(one)[answers])
    cell = test["y"].astype(np.int64) * one.classes + answers
    matrix = np.bincount(cell, minlength=len(classes) * one.classes).reshape(len(classes), one.classes)
    write_arrays(here.directory / ANSWERS, {"found": answers.astype(np.uint8)})
    return {"matrix": matrix.tolist(), "intervals": intervals(by_block(test, answers, one.classes, edge))}


def by_block(test: Mapping[str, NDArray], answers: NDArray[np.int64], known: int, edge: float) -> NDArray[np.int64]:
    """int64 (blocks, known, known): the confusion in every square of `edge` [m] of the global grid that has a test echo
    of one of the first `known` classes."""
    scored = test["y"] < known
    square = np.stack([test[n][scored] for n in ("east", "north")], axis=1) // whole_millimetres(edge, "papers.block")
    return confusion_by_square(square, test["y"][scored], answers[scored], known)[1]


def spans(change: Mapping[str, Any]) -> dict[str, dict[str, float | None]]:
    """``{figure: {"value", "low", "high"}}`` of a `difference`, fractions; None where it has no interval."""
    ends = {f: (change[f]["difference"], *(change[f]["interval"] or (None, None))) for f in FIGURES}
    return {f: dict(zip(("value", "low", "high"), v, strict=True)) for f, v in ends.items()}


def compare(here: StageInputs, name: str, other: str, known: int, edge: float) -> dict[str, Any]:
    """How much better `name` is than `other`: ``{"blocks", figure: {"value", "low", "high"}}``, fractions; ``iou``, a
    list of the same by class; low and high are None where there are too few blocks for an interval."""
    test = _test_echoes(here.inputs)
    both = [
        by_block(test, here.inputs.arrays(JUDGED, one, ANSWERS)[0]["found"].astype(np.int64), known, edge)
        for one in (other, name)
    ]
    change = difference(*both)
    if change is None:
        gain = np.diff([scores(b.sum(axis=0)[None])[0] for b in both], axis=0)[0]
        change_alone = {f: {"value": float(v), "low": None, "high": None} for f, v in zip(FIGURES, gain, strict=True)}
        return {"blocks": len(both[0]), **change_alone, "iou": class_gains(*both)}
    return {"blocks": change["blocks"], **spans(change), "iou": class_gains(*both)}


def time_variant(
    here: StageInputs, one: Variant, names: tuple[str, ...], compare: CompareParams, classes: tuple[ClassDef, ...]
) -> dict[str, Any]:
    """Processor seconds of training and of answering, without reading, writing and loading of compiled code."""
    sample, params = sample_for(here.inputs, names, one), one.train
    known = tuple(classes[k] for k in _known(one))
    model, test = _model(here.inputs, one.name), _test_echoes(here.inputs)
    tested_rows = test["X"] if one.filtered is None else test["X"][~test["ground"]]
    X = np.ascontiguousarray(tested_rows[:, [names.index(f) for f in one.features]])
    answer(X[:WARM_ROWS], model)
    if params.method == "forest":
        grow_trees(sample, known, 0, 1, params)
    began = time.process_time()
    if params.method == "forest":
        grow_trees(sample, known, 0, params.trees, params)
    else:
        fit_variant(sample, one, compare, classes)
    trained = time.process_time()
    answer(X, model)
    return {
        "train": trained - began,
        "test": time.process_time() - trained,
        "train_rows": sample.rows,
        "test_rows": len(X),
    }


def trees_of(model: Forest, first: int, count: int) -> list[Tree]:
    """Some of a forest's trees."""
    cut = model.offsets
    return [
        (model.feature[a:b], model.threshold[a:b], model.child[a:b])
        for a, b in zip(cut[first : first + count].tolist(), cut[first + 1 : first + count + 1].tolist(), strict=True)
    ]


def measure_drops(
    here: StageInputs, one: Variant, names: tuple[str, ...], first: int, count: int, repeats: int
) -> dict[str, Any]:
    """What permuting a feature takes from some of the trees."""
    model = _model(here.inputs, one.name)
    if not isinstance(model, Forest):
        raise TypeError(f"{one.name} is no forest")
    losses, rows = drops(
        sample_for(here.inputs, names, one), trees_of(model, first, count), first, one.train.drawing, repeats
    )
    write_arrays(here.directory / DROPS, {"drops": losses, "rows": rows})
    return {"trees": count}


def importance(here: StageInputs, features: tuple[str, ...]) -> dict[str, Any]:
    """Mean drop of the out-of-bag accuracy by feature."""
    parts = [here.inputs.arrays(DROPPED, batch, DROPS)[0] for batch in here.parts(DROPPED)]
    losses, rows = (np.concatenate([p[n] for p in parts]) for n in ("drops", "rows"))
    return dict(summary(features, losses, rows))
