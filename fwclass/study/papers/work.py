"""Work of the papers' parts: data, models, answers, times, importances."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.assess.intervals import FIGURES, caution, difference, intervals, scores
from fwclass.classify.shares import answer
from fwclass.errors import InputError
from fwclass.graph.areas import rows_to_test
from fwclass.graph.learn import SAMPLE
from fwclass.graph.machine_search import spatial
from fwclass.grid import Box, Tile, millimetres, whole_millimetres
from fwclass.hashing import hash_keys
from fwclass.model import ClassDef, Forest, KernelMachine, Model, Tree, class_index, sample_matrix
from fwclass.run.inputs import PartInputs
from fwclass.schema import canonical_key
from fwclass.store.arrays import write_arrays
from fwclass.store.models import load_model, save_model
from fwclass.train.baselines.params import CompareParams
from fwclass.train.baselines.prepare import fewer
from fwclass.train.baselines.search import BY_PULSES
from fwclass.train.baselines.stage import train_other
from fwclass.train.importance import drops, summary
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample
from fwclass.train.stage import grow_trees, merge, train

TEST, MODEL, DROPS, ANSWERS = "test", "model", "drops", "answers"
_TABLE = dict.fromkeys(("strip", "pulse", "echo_number", "x", "y"), "tile")
WARM_ROWS = 2000
"""Rows that a timing begins with and does not count: compiled code is loaded then."""


def drawn(
    tile: Tile,
    columns: Mapping[str, str],
    also: Mapping[str, str],
    names: tuple[str, ...],
    train: tuple[Box, ...],
    test: tuple[Box, ...],
    gap: float,
    classes: tuple[ClassDef, ...],
    share: float,
    seed: int,
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """A share of the tile's labelled echoes in the test areas, drawn by hash, with features, places and `also`."""
    table = inputs.rows(tile.key, {**_TABLE, **columns, **also, "reference": "label"})
    index = class_index(table["reference"], classes)
    key = canonical_key(table)
    lucky = hash_keys(seed, key) < np.uint64(min(share * 2.0**64, 2.0**64 - 2048))
    rows = np.flatnonzero(rows_to_test(table, train, test, gap) & (index >= 0) & lucky)
    arrays: dict[str, NDArray] = {
        "X": sample_matrix(table.take(rows), names, tile.key),
        "y": index[rows].astype(np.uint8),
        "key": key[rows],
        "east": millimetres(table["x"][rows]),
        "north": millimetres(table["y"][rows]),
        **{name: table[name][rows] for name in also},
    }
    write_arrays(directory / TEST, arrays)
    return {"rows": len(rows)}


def gathered(
    tiles: tuple[str, ...], names: tuple[str, ...], params: TrainParams, inputs: PartInputs, directory: Path
) -> dict[str, Any]:
    """The test echoes of all tiles, by key."""
    parts = [inputs.arrays("paper-test", t, TEST)[0] for t in tiles]
    order = np.argsort(np.concatenate([p["key"] for p in parts]), kind="stable")
    if len(order) == 0:
        raise InputError(
            "no labelled echo lies in a test area", where="areas.test, areas.gap", do="name areas with a reference"
        )
    write_arrays(directory / TEST, {n: np.concatenate([p[n] for p in parts])[order] for n in parts[0]})
    return {"rows": len(order)}


def training(
    tiles: tuple[str, ...], names: tuple[str, ...], params: TrainParams, inputs: PartInputs, directory: Path
) -> dict[str, Any]:
    """The sample of all tiles."""
    if not tiles:
        raise InputError("no echo lies in any training area", where="areas.train", do="give boxes on the survey")
    sample = merge((Sample.from_arrays(names, inputs.arrays("paper-sample", t, SAMPLE)[0]) for t in tiles), params)
    write_arrays(directory / SAMPLE, sample.arrays())
    return {"rows": sample.rows, "counts": sample.counts.tolist(), "eligible": sample.eligible.tolist()}


def sample_for(
    inputs: PartInputs,
    names: tuple[str, ...],
    features: tuple[str, ...],
    classes: int,
    most: int = 0,
    filtered: int | None = None,
) -> Sample:
    """The sample with the columns and the classes that a variant knows, the first but `filtered`; `most` rows of it, 0
    for all."""
    whole = Sample.from_arrays(names, inputs.arrays("paper-training", "all", SAMPLE)[0])
    at = [names.index(f) for f in features]
    known = _known(classes, filtered)
    rows = np.isin(whole.y, known)
    X = np.ascontiguousarray(whole.X[rows][:, at])
    y = np.searchsorted(known, whole.y[rows]).astype(np.uint8)
    made = Sample(features, X, y, whole.key[rows], whole.hash[rows], whole.eligible[known])
    made = replace(made, place=whole.place[rows]) if len(whole.place) else made
    return fewer(made, most) if most else made


def _known(classes: int, filtered: int | None) -> NDArray[np.int64]:
    """Indices of the classes that a classifier knows."""
    return np.array([k for k in range(classes) if k != filtered], np.int64)


def fitted(
    sample: Sample,
    params: TrainParams,
    compare: CompareParams,
    classes: tuple[ClassDef, ...],
    squares: tuple[float, float] | None = None,
) -> Model:
    """The classifier that `params.method` names."""
    if params.method == "forest":
        return train(sample, grow_trees(sample, classes, 0, params.trees, params), params, classes)
    return train_other(sample, params, compare, classes, params.method, spatial(*squares) if squares else BY_PULSES)


def learned(
    names: tuple[str, ...],
    features: tuple[str, ...],
    params: TrainParams,
    compare: CompareParams,
    classes: tuple[ClassDef, ...],
    rows: int,
    squares: tuple[float, float] | None,
    filtered: int | None,
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """A variant's model."""
    sample = sample_for(inputs, names, features, len(classes), rows, filtered)
    classes = tuple(c for k, c in enumerate(classes) if k != filtered)
    model = fitted(sample, params, compare, classes, squares)
    save_model(directory / MODEL, model)
    card = model.card
    bag = card.get("out_of_bag") or {}
    told = {n: card["params"].get(n) for n in ("c", "gamma")}
    return {
        "rows": int(np.sum(card["samples"])),
        "notes": list(card.get("notes", ())),
        "out_of_bag": bag.get("accuracy"),
        "nodes": len(model.feature) if isinstance(model, Forest) else None,
        "vectors": len(model.vectors) if isinstance(model, KernelMachine) else None,
        "params": told,
    }


def _model(inputs: PartInputs, name: str) -> Model:
    return load_model(inputs.path("paper-model", name, MODEL))


def _test(inputs: PartInputs) -> dict[str, NDArray]:
    return inputs.arrays("paper-tested", "all", TEST)[0]


def judged(
    name: str,
    names: tuple[str, ...],
    classes: tuple[ClassDef, ...],
    known: int,
    filtered: int | None,
    edge: float,
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """Confusion of a variant on the test echoes: rows are all classes, columns the first `known`, which it tells.

    The answers (uint8, index of the class) are kept for comparisons between variants.
    """
    model, test = _model(inputs, name), _test(inputs)
    X = np.ascontiguousarray(test["X"][:, [names.index(f) for f in model.features]])
    found, _ = answer(X, model)
    if filtered is not None:
        found = np.where(test["ground"], filtered, _known(known, filtered)[found])
    cell = test["y"].astype(np.int64) * known + found
    matrix = np.bincount(cell, minlength=len(classes) * known).reshape(len(classes), known)
    write_arrays(directory / ANSWERS, {"found": found.astype(np.uint8)})
    return {"matrix": matrix.tolist(), "intervals": intervals(by_block(test, found, known, edge))}


def by_block(test: Mapping[str, NDArray], found: NDArray[np.int64], known: int, edge: float) -> NDArray[np.int64]:
    """int64 (blocks, known, known): the confusion in every square of `edge` [m] of the global grid that has a test echo
    of one of the first `known` classes."""
    scored = test["y"] < known
    mm = whole_millimetres(edge, "papers.block")
    square = np.stack([test["east"][scored] // mm, test["north"][scored] // mm], axis=1)
    blocks, place = np.unique(square, axis=0, return_inverse=True)
    cell = (place.reshape(-1) * known + test["y"][scored].astype(np.int64)) * known + found[scored]
    return np.bincount(cell, minlength=len(blocks) * known * known).reshape(len(blocks), known, known)


def cautioned(made: Mapping[str, Any]) -> dict[str, Any]:
    """What `compared` found, with what is to be said where it rests on few blocks (``caution``, or None)."""
    return {**made, "caution": caution(made["blocks"])}


def compared(name: str, other: str, known: int, edge: float, inputs: PartInputs, directory: Path) -> dict[str, Any]:
    """How much better `name` is than `other`: ``{"blocks", figure: {"value", "low", "high"}}``, fractions; low and high
    are None where there are too few blocks for an interval."""
    test = _test(inputs)
    both = [
        by_block(test, inputs.arrays("paper-judged", one, ANSWERS)[0]["found"].astype(np.int64), known, edge)
        for one in (other, name)
    ]
    told = difference(*both)
    if told is None:
        gain = np.diff([scores(b.sum(axis=0)[None])[0] for b in both], axis=0)[0]
        lone = {f: {"value": float(v), "low": None, "high": None} for f, v in zip(FIGURES, gain, strict=True)}
        return {"blocks": len(both[0]), **lone}
    spans = {f: (told[f]["difference"], *(told[f]["interval"] or (None, None))) for f in FIGURES}
    return {
        "blocks": told["blocks"],
        **{f: dict(zip(("value", "low", "high"), v, strict=True)) for f, v in spans.items()},
    }


def timed(
    name: str,
    names: tuple[str, ...],
    features: tuple[str, ...],
    params: TrainParams,
    compare: CompareParams,
    classes: tuple[ClassDef, ...],
    rows: int,
    squares: tuple[float, float] | None,
    filtered: int | None,
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """Processor seconds of training and of answering, without reading, writing and loading of compiled code."""
    sample = sample_for(inputs, names, features, len(classes), rows, filtered)
    classes = tuple(c for k, c in enumerate(classes) if k != filtered)
    model, test = _model(inputs, name), _test(inputs)
    asked = test["X"] if filtered is None else test["X"][~test["ground"]]
    X = np.ascontiguousarray(asked[:, [names.index(f) for f in features]])
    answer(X[:WARM_ROWS], model)
    if params.method == "forest":
        grow_trees(sample, classes, 0, 1, params)
    began = time.process_time()
    if params.method == "forest":
        grow_trees(sample, classes, 0, params.trees, params)
    else:
        fitted(sample, params, compare, classes, squares)
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


def dropped(
    name: str,
    names: tuple[str, ...],
    params: TrainParams,
    first: int,
    count: int,
    repeats: int,
    classes: int,
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """What permuting a feature takes from some of the trees."""
    model = _model(inputs, name)
    if not isinstance(model, Forest):
        raise TypeError(f"{name} is no forest")
    sample = sample_for(inputs, names, model.features, classes)
    made, rows = drops(sample, trees_of(model, first, count), first, params, repeats)
    write_arrays(directory / DROPS, {"drops": made, "rows": rows})
    return {"trees": count}


def importance(
    batches: tuple[str, ...], features: tuple[str, ...], inputs: PartInputs, directory: Path
) -> dict[str, Any]:
    """Mean drop of the out-of-bag accuracy by feature."""
    parts = [inputs.arrays("paper-drops", b, DROPS)[0] for b in batches]
    made, rows = (np.concatenate([p[n] for p in parts]) for n in ("drops", "rows"))
    return dict(summary(features, made, rows))
