"""Work of the parts that learn and judge: sample, trees, train, classify, confusion, assess."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.assess.remarks import pure_share
from fwclass.assess.stage import BlockCounts, confusion, figures, intervals, packed, summary, unclassified, unpacked
from fwclass.classify.stage import classify, filled
from fwclass.errors import InputError
from fwclass.graph.work.others import stamped
from fwclass.grid import Box, Tile
from fwclass.model import ClassDef, Model, Tree, class_index, sample_matrix
from fwclass.run.inputs import TABLE, PartInputs
from fwclass.schema import Table, canonical_key
from fwclass.store.arrays import write_arrays
from fwclass.store.models import load_model, model_digest, save_model
from fwclass.store.remote_file import Location
from fwclass.store.tables import write_table
from fwclass.train.importance import drops
from fwclass.train.sample import Sample, review
from fwclass.train.stage import TrainParams, candidates, grow_trees, merge, train

SAMPLE, TREES, DROPS, MODEL, COUNTS = "sample.zarr", "trees.zarr", "drops.zarr", "model", "counts.zarr"
GROUND = 2
"""Class code."""
_IDENTITY = dict.fromkeys(("strip", "pulse", "echo_number", "x", "y"), "tile")


def within(table: Table, boxes: tuple[Box, ...]) -> NDArray[np.bool_]:
    """Rows that lie in any of `boxes`."""
    inside = np.zeros(table.rows, bool)
    for box in boxes:
        inside |= box.contains(table["x"], table["y"])
    return inside


def tested(table: Table, train: tuple[Box, ...], test: tuple[Box, ...], gap: float) -> NDArray[np.bool_]:
    """Rows to judge on: inside `test` (anywhere if empty), and further than `gap` [m] from every training box."""
    near = within(table, tuple(b.grown(gap) for b in train))
    return ~near & (within(table, test) if test else np.ones(table.rows, bool))


def sampled(
    tile: Tile,
    columns: Mapping[str, str],
    names: tuple[str, ...],
    boxes: tuple[Box, ...],
    params: TrainParams,
    classes: tuple[ClassDef, ...],
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """The rows of a tile that may train."""
    table = inputs.rows(tile.key, {**_IDENTITY, **columns, "reference": "label"})
    inside = within(table, boxes)
    if "sampled" in table:  # a thinned run
        inside &= table["sampled"]
    sample = candidates(table.select(names), table["reference"], canonical_key(table), inside, params, classes)
    _save_sample(directory, sample)
    return {"rows": sample.rows}


def merged(
    tiles: tuple[str, ...],
    names: tuple[str, ...],
    params: TrainParams,
    classes: tuple[ClassDef, ...],
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """The survey's sample; refused where a forest cannot be trained on it."""
    if not tiles:
        raise InputError(
            "no echo lies in any training area", where="areas.train", do="give boxes on the survey, in its coordinates"
        )
    sample = merge((_load_sample(inputs, "sample", t, names) for t in tiles), params)
    review(sample, classes)
    _save_sample(directory, sample)
    return {"rows": sample.rows, "counts": sample.counts.tolist()}


def _save_sample(directory: Path, sample: Sample) -> None:
    write_arrays(directory / SAMPLE, sample.arrays())


def _load_sample(inputs: PartInputs, stage: str, part: str, names: tuple[str, ...]) -> Sample:
    arrays, _ = inputs.arrays(stage, part, SAMPLE)
    return Sample.from_arrays(names, arrays)


def grown(
    first: int,
    count: int,
    names: tuple[str, ...],
    params: TrainParams,
    classes: tuple[ClassDef, ...],
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """Some of the forest's trees."""
    trees = grow_trees(_load_sample(inputs, "training", "all", names), classes, first, count, params)
    arrays: dict[str, NDArray] = {}
    for number, (feature, threshold, child) in enumerate(trees, first):
        arrays |= {f"{number:05d}-feature": feature, f"{number:05d}-threshold": threshold, f"{number:05d}-child": child}
    write_arrays(directory / TREES, arrays)
    return {"nodes": int(sum(len(t[0]) for t in trees))}


def _load_trees(inputs: PartInputs, batch: str) -> list[Tree]:
    arrays, _ = inputs.arrays("trees", batch, TREES)
    numbers = sorted({n.split("-")[0] for n in arrays})
    return [(arrays[f"{n}-feature"], arrays[f"{n}-threshold"], arrays[f"{n}-child"]) for n in numbers]


def weighed(
    first: int, names: tuple[str, ...], params: TrainParams, inputs: PartInputs, directory: Path
) -> dict[str, Any]:
    """What some of the forest's trees lose when a feature is permuted."""
    sample = _load_sample(inputs, "training", "all", names)
    lost, judged = drops(sample, _load_trees(inputs, f"{first:05d}"), first, params, params.importance_repeats)
    write_arrays(directory / DROPS, {"drops": lost, "judged": judged})
    return {"rows": int(judged.sum())}


def trained(
    batches: tuple[str, ...],
    names: tuple[str, ...],
    params: TrainParams,
    classes: tuple[ClassDef, ...],
    computed: Mapping[str, Any],
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """The forest, delivered as the run's model."""
    trees = [tree for batch in batches for tree in _load_trees(inputs, batch)]
    lost = None
    if params.importance_repeats:
        parts = [inputs.arrays("importance", b, DROPS)[0] for b in batches]
        lost = (np.concatenate([p["drops"] for p in parts]), np.concatenate([p["judged"] for p in parts]))
    forest = stamped(train(_load_sample(inputs, "training", "all", names), trees, params, classes, lost), computed)
    save_model(directory / MODEL, forest)
    return {"card": dict(forest.card), "trees": forest.trees, "nodes": len(forest.feature)}


_loaded: dict[tuple[str, str], Model] = {}


def model_at(path: Path, digest: str, foreign: bool) -> Model:
    """The model in `path`, kept in this process as long as its digest is the same.

    A `foreign` model, which no receipt names, must still have it.
    """
    key = (str(path), digest)
    if key not in _loaded:
        _loaded.clear()
        model = load_model(path)
        if foreign and model_digest(path) != digest:
            raise InputError(
                "the model was changed while the run was under way",
                where=path,
                do="run the same again with one of them",
            )
        _loaded[key] = model
    return _loaded[key]


def model_of(given: tuple[Location, str] | None, inputs: PartInputs) -> Model:
    """The model at a path, by its digest; None: the run's own."""
    foreign = given is not None
    if given is None:
        return model_at(inputs.path("train", "model", MODEL), inputs.digest("train", "model"), foreign)
    return model_at(inputs.local(given[0]), given[1], foreign)


def classified(
    tile: Tile,
    columns: Mapping[str, str],
    names: tuple[str, ...],
    model: tuple[Location, str] | None,
    probabilities: bool,
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """Class, confidence and entropy of a tile's echoes, and with `probabilities` the share of every class.

    `model`: path and digest of a given one, None for the run's own.
    """
    used = model_of(model, inputs)
    tables, missing = [], 0
    for rows in inputs.runs_of_rows(tile.key, columns):
        X = sample_matrix(rows, used.features, tile.key)
        tables.append(classify(X, used, probabilities))
        missing += filled(X, used)
    table = tables[0] if len(tables) == 1 else Table.concat(tables)
    write_table(directory / TABLE, table)
    codes, counts = np.unique(table["classification"], return_counts=True)
    found = {str(c): int(n) for c, n in zip(codes.tolist(), counts.tolist(), strict=True)}
    return {"codes": found, "filled": missing}


def judged(
    tile: Tile,
    columns: Mapping[str, str],
    names: tuple[str, ...],
    train: tuple[Box, ...],
    test: tuple[Box, ...],
    gap: float,
    block: float,
    classes: tuple[ClassDef, ...],
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """Confusion counts (whole, and by blocks of edge `block` [m]) and feature histograms of a tile's echoes in the test
    areas; the ground filter's counts of all its labelled echoes, for it learns from none."""
    extra = {"reference": "label", "classification": "classify", "ground": "ground"}
    table = inputs.rows(tile.key, {**_IDENTITY, **columns, **extra})
    filtered = ground_counts(table, classes)
    table = table.take(tested(table, train, test, gap))
    matrix = confusion(table["reference"], table["classification"], classes)
    lost = unclassified(table["reference"], table["classification"], classes)
    places, counts = packed(table.select(names), table["reference"], classes)
    blocks = BlockCounts.of(table["x"], table["y"], table["reference"], table["classification"], classes, block)
    kept = {"places": places, "counts": counts, "place": blocks.place, "blocks": blocks.counts}
    write_arrays(directory / COUNTS, kept)
    return {"matrix": matrix.tolist(), "lost": lost.tolist(), "ground": filtered.tolist()}


def ground_counts(table: Table, classes: tuple[ClassDef, ...]) -> NDArray[np.int64]:
    """(2, 2) labelled echoes: the reference says ground or not (rows), the filter says so or not; 0 where no class is
    ground."""
    index = class_index(table["reference"], classes)
    ours = [k for k, one in enumerate(classes) if one.code == GROUND]
    if not ours:
        return np.zeros((2, 2), np.int64)
    known = index >= 0
    cells = 2 * ~np.isin(index[known], ours) + ~table["ground"][known]
    return np.bincount(cells, minlength=4).reshape(2, 2).astype(np.int64)


def assessed(
    tiles: tuple[str, ...],
    names: tuple[str, ...],
    classes: tuple[ClassDef, ...],
    shares: tuple[float, ...],
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """Figures over all test areas with their intervals, and the distribution of the features by class.

    What it keeps of the blocks serves to compare two runs.
    """
    n = len(classes)
    matrix, lost, filtered = np.zeros((n, n), np.int64), np.zeros(n, np.int64), np.zeros((2, 2), np.int64)
    parts, counted = [], []
    for tile in tiles:
        meta = inputs.meta("confusion", tile)
        matrix += np.array(meta["matrix"], np.int64)
        lost += np.array(meta["lost"], np.int64)
        filtered += np.array(meta["ground"], np.int64)
        arrays, _ = inputs.arrays("confusion", tile, COUNTS)
        counted.append((arrays["places"], arrays["counts"]))
        parts.append(BlockCounts(arrays["place"], arrays["blocks"]))
    blocks = BlockCounts.merged(parts, n)
    write_arrays(directory / COUNTS, {"place": blocks.place, "blocks": blocks.counts})
    histograms = unpacked(counted, names, n)
    called = [c.name for c in classes]
    accuracy = figures(matrix, called, lost) | {
        "intervals": intervals(blocks.counts),
        "blocks": int(blocks.counts.any(axis=(1, 2)).sum()),
        "pure_share": pure_share(blocks.counts),
    }
    return {
        "accuracy": accuracy if matrix.any() or lost.any() else None,
        "distribution": summary(histograms, called, shares),
        "ground": figures(filtered, ("ground", "other")) if filtered.any() else None,
    }
