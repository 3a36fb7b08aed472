"""Work of the parts of Li 2018: drives, radii, single features."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.conf import Config
from fwclass.conf.street import scanner
from fwclass.graph.street import (
    Rows,
    Split,
    by_model,
    fit_model,
    frames_with_features,
    join_rows,
    judge_answers,
    rows_of,
    sample_of,
)
from fwclass.hashing import hash_keys, seed_for
from fwclass.model import Model, class_index
from fwclass.run.inputs import PartInputs
from fwclass.store.arrays import write_arrays
from fwclass.street.params import StreetParams
from fwclass.street.recording_parquet import write_recording
from fwclass.street.ring import feature_names
from fwclass.street.simulate import simulate_frames

DRIVE, RECORDING, GRIDS = "street-drive", "drive.parquet", "grids"
SHOWN = 400
"""Frames of the pictures, as many as the paper has."""

SINGLE_ROWS = 2000
"""Rows that train an SVM of one feature: classes that overlap make a support vector of every second row."""

TEST_ROWS = 2
"""Of the seeds that are drawn from one: of the rows that test."""

WINDOW_FRAMES = 60
"""Frames on which the paper's window is held against the exact one."""


def simulate_drive(config: Config, changes: Mapping[str, Any], inputs: PartInputs, directory: Path) -> dict[str, Any]:
    """A simulated recording."""
    params = config.street_scene.model_copy(update=dict(changes))
    frames = simulate_frames(params, scanner(config.street.scanner), config.street.mounting)
    return {"frames": write_recording(directory / RECORDING, frames), **changes}


def _path(inputs: PartInputs, name: str) -> Path:
    return inputs.path(DRIVE, name, RECORDING)


def _rows(inputs: PartInputs, name: str, params: StreetParams) -> Rows:
    return join_rows(list(rows_of([_path(inputs, name)], params)))


def _some(rows: Rows, most: int, seed: int) -> Rows:
    """About `most` of the rows, by a hash of their own: with that of the split they would be those that train."""
    share = min(1.0, most / max(1, len(rows.key)))
    return rows.take(hash_keys(seed_for(seed, TEST_ROWS), rows.key) < np.uint64(min(share * 2.0**64, 2.0**64 - 2048)))


def _judged(
    config: Config, rows: Rows, answers: Callable[[Rows], NDArray[np.uint8]], split: Split | None
) -> dict[str, Any]:
    return judge_answers([rows], answers, split, config.classes, config.assess.block)


def _model(config: Config, rows: Rows, names: tuple[str, ...], split: Split, params: StreetParams) -> Model:
    sample = sample_of([rows], names, split, config.classes, config.train.samples_per_class)
    return fit_model(sample, params, config.train, config.compare, config.classes)


def judge_radius(config: Config, metres: float, inputs: PartInputs, directory: Path) -> dict[str, Any]:
    """One line of table 1: at random as the paper, then a model of the whole drive on other drives."""
    params = config.street.model_copy(update={"radii": (metres,), "window": "exact"})
    names, most, seed = feature_names(params), config.papers.test_echoes, config.papers.seed
    began = time.thread_time()
    rows = _rows(inputs, "main", params)
    spent = time.thread_time() - began
    chance = Split("random", params.share, config.train.seed, (), 0.0)
    every = Split("stretch", 0.0, config.train.seed, ((-1e9, -1e9, 1e9, 1e9),), 0.0)
    by_chance = _model(config, rows, names, chance, params)
    by_street = _model(config, rows, names, every, params)
    results: dict[str, Any] = {"radius": metres, "vectors": _vectors(by_street)}
    results["frame_ms"] = 1e3 * spent / max(1, len(np.unique(rows.key >> np.uint64(16))))
    results["random"] = _judged(config, _some(rows, most, seed), by_model(by_chance), chance)
    for name in ("other", "leafless"):
        there = _some(_rows(inputs, name, params), most, seed)
        results[name] = _judged(config, there, by_model(by_street), None)
    results["lost"] = _lost(inputs, params)
    return results


def _vectors(model: Model) -> int | None:
    vectors = getattr(model, "vectors", None)
    return None if vectors is None else len(vectors)


def _lost(inputs: PartInputs, params: StreetParams) -> float:
    """Share of the spheres that lose members by the paper's window."""
    counts = []
    for window in ("exact", "paper"):
        here = params.model_copy(update={"window": window})
        rows = []
        for one in frames_with_features(_path(inputs, "main"), here):
            rows.append(one.features[:, 6].copy())
            if len(rows) == WINDOW_FRAMES:
                break
        counts.append(np.concatenate(rows))
    known = ~np.isnan(counts[0])
    return float((counts[1][known] < counts[0][known]).mean())


def judge_feature(config: Config, metres: float, feature: int, inputs: PartInputs, directory: Path) -> dict[str, Any]:
    """One line of table 2, and the answers of the first frames as a grid."""
    params = config.street.model_copy(update={"radii": (metres,), "window": "exact"})
    names = feature_names(params)
    rows = _rows(inputs, "main", params)
    alone = replace(rows, X=np.ascontiguousarray(rows.X[:, feature : feature + 1]))
    chance = Split("random", params.share, config.train.seed, (), 0.0)
    rbf = config.compare.rbf_svm
    few = rbf.model_copy(update={"max_rows": min(rbf.max_rows, SINGLE_ROWS), "search_rows": min(rbf.search_rows, 1000)})
    config = replace(config, compare=config.compare.model_copy(update={"rbf_svm": few}))
    model = _model(config, alone, names[feature : feature + 1], chance, params)
    accuracy = _judged(
        config, _some(alone, config.papers.test_echoes // 3, config.papers.seed), by_model(model), chance
    )
    first = alone.take((alone.key >> np.uint64(16)) < np.uint64(SHOWN))
    index = class_index(first.codes, config.classes)
    crown, other = (rows.X[class_index(rows.codes, config.classes) == k, feature] for k in (0, 1))
    write_arrays(
        directory / GRIDS,
        {
            "answer": _grid(first, by_model(model)(first) != config.classes[0].code),
            "reference": _grid(first, index != 0),
        },
    )
    return {
        "name": names[feature],
        **{k: accuracy[k] for k in ("error", "detection", "false_alarm", "kappa", "rows")},
        "interval": accuracy["error_interval"],
        "means": [float(np.mean(crown)), float(np.mean(other))],
    }


def _grid(rows: Rows, values: NDArray) -> NDArray[np.uint8]:
    """(frames, beams) of values, 255 without a return."""
    frame, beam = (rows.key >> np.uint64(16)).astype(int), (rows.key & np.uint64(0xFFFF)).astype(int)
    grid = np.full((frame.max(initial=0) + 1, beam.max(initial=0) + 1), 255, np.uint8)
    grid[frame, beam] = values
    return grid
