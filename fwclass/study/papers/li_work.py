"""Work of the parts of Li 2018: drives, radii, single features."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.assess.params import AssessParams
from fwclass.conf.sections import PapersSection
from fwclass.conf.street import scanner
from fwclass.graph.stage_work import StageInputs
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
from fwclass.model import ClassDef, Model, class_index
from fwclass.run.inputs import PartInputs
from fwclass.store.arrays import write_arrays
from fwclass.street.params import MountingParams, StreetParams, StreetSceneParams
from fwclass.street.recording_parquet import write_recording
from fwclass.street.ring import feature_names
from fwclass.street.simulate import simulate_frames
from fwclass.train.baselines.params import CompareParams
from fwclass.train.params import TrainParams

DRIVE, RECORDING, GRIDS = "street-drive", "drive.parquet", "grids"
SHOWN = 400
"""Frames of the pictures, as many as the paper has."""

SINGLE_ROWS = 2000
"""Rows that train an SVM of one feature: classes that overlap make a support vector of every second row."""

TEST_ROWS = 2
"""Of the seeds that are drawn from one: of the rows that test."""

WINDOW_FRAMES = 60
"""Frames on which the paper's window is held against the exact one."""


@dataclass(frozen=True)
class StreetSettings:
    """Sections of the configuration by which streets are judged, and its classes."""

    street: StreetParams
    train: TrainParams
    compare: CompareParams
    papers: PapersSection
    assess: AssessParams
    classes: tuple[ClassDef, ...]


def simulate_drive(
    here: StageInputs, scene: StreetSceneParams, scanner_name: str, mounting: MountingParams, changes: Mapping[str, Any]
) -> dict[str, Any]:
    """A simulated recording."""
    params = scene.model_copy(update=dict(changes))
    frames = simulate_frames(params, scanner(scanner_name), mounting)
    return {"frames": write_recording(here.directory / RECORDING, frames), **changes}


def _path(inputs: PartInputs, name: str) -> Path:
    return inputs.path(DRIVE, name, RECORDING)


def _rows(inputs: PartInputs, name: str, params: StreetParams) -> Rows:
    return join_rows(list(rows_of([_path(inputs, name)], params)))


def _some(rows: Rows, most: int, seed: int) -> Rows:
    """About `most` of the rows, by a hash of their own: with that of the split they would be those that train."""
    share = min(1.0, most / max(1, len(rows.key)))
    return rows.take(hash_keys(seed_for(seed, TEST_ROWS), rows.key) < np.uint64(min(share * 2.0**64, 2.0**64 - 2048)))


def _judged(
    settings: StreetSettings, rows: Rows, answers: Callable[[Rows], NDArray[np.uint8]], split: Split | None
) -> dict[str, Any]:
    return judge_answers([rows], answers, split, settings.classes, settings.assess.block)


def _model(settings: StreetSettings, rows: Rows, names: tuple[str, ...], split: Split, params: StreetParams) -> Model:
    sample = sample_of([rows], names, split, settings.classes, settings.train.samples_per_class)
    return fit_model(sample, params, settings.train, settings.compare, settings.classes)


def judge_radius(here: StageInputs, settings: StreetSettings, metres: float) -> dict[str, Any]:
    """One line of table 1: at random as the paper, then a model of the whole drive on other drives."""
    params = settings.street.model_copy(update={"radii": (metres,), "window": "exact"})
    names, most, seed = feature_names(params), settings.papers.test_echoes, settings.papers.seed
    began = time.thread_time()
    rows = _rows(here.inputs, "main", params)
    spent = time.thread_time() - began
    chance = Split("random", params.share, settings.train.seed, (), 0.0)
    every = Split("stretch", 0.0, settings.train.seed, ((-1e9, -1e9, 1e9, 1e9),), 0.0)
    by_chance = _model(settings, rows, names, chance, params)
    by_street = _model(settings, rows, names, every, params)
    results: dict[str, Any] = {"radius": metres, "vectors": _vectors(by_street)}
    results["frame_ms"] = 1e3 * spent / max(1, len(np.unique(rows.key >> np.uint64(16))))
    results["random"] = _judged(settings, _some(rows, most, seed), by_model(by_chance), chance)
    for name in ("other", "leafless"):
        there = _some(_rows(here.inputs, name, params), most, seed)
        results[name] = _judged(settings, there, by_model(by_street), None)
    results["lost"] = _lost(here.inputs, params)
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


def judge_feature(here: StageInputs, settings: StreetSettings, metres: float, feature: int) -> dict[str, Any]:
    """One line of table 2, and the answers of the first frames as a grid."""
    params = settings.street.model_copy(update={"radii": (metres,), "window": "exact"})
    names = feature_names(params)
    rows = _rows(here.inputs, "main", params)
    alone = replace(rows, X=np.ascontiguousarray(rows.X[:, feature : feature + 1]))
    chance = Split("random", params.share, settings.train.seed, (), 0.0)
    rbf = settings.compare.rbf_svm
    few = rbf.model_copy(update={"max_rows": min(rbf.max_rows, SINGLE_ROWS), "search_rows": min(rbf.search_rows, 1000)})
    settings = replace(settings, compare=settings.compare.model_copy(update={"rbf_svm": few}))
    model = _model(settings, alone, names[feature : feature + 1], chance, params)
    accuracy = _judged(
        settings, _some(alone, settings.papers.test_echoes // 3, settings.papers.seed), by_model(model), chance
    )
    first = alone.take((alone.key >> np.uint64(16)) < np.uint64(SHOWN))
    index = class_index(first.codes, settings.classes)
    crown, other = (rows.X[class_index(rows.codes, settings.classes) == k, feature] for k in (0, 1))
    write_arrays(
        here.directory / GRIDS,
        {
            "answer": _grid(first, by_model(model)(first) != settings.classes[0].code),
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
