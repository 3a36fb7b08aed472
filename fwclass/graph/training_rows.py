"""Stages of the rows that are learned from: those of every tile, and the survey's sample."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.conf import Config
from fwclass.conf.sections import AreasSection
from fwclass.errors import InputError
from fwclass.graph.areas import IDENTITY_AND_PLACE, training_tiles, within
from fwclass.graph.corrections import CORRECTIONS, corrected_training_rows, corrections_here, corrections_of, reach_here
from fwclass.graph.density import COUNT_TRAINING_ECHOES, SQUARES, densities_by_receipts
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.graph.thin import sampled_columns
from fwclass.grid import Box, millimetres
from fwclass.label.offset import measure_offset
from fwclass.model import ClassDef, sample_matrix
from fwclass.model.density import DENSITY
from fwclass.run.inputs import PartInputs
from fwclass.run.part import Name
from fwclass.schema import IDENTITY, Table, canonical_key
from fwclass.store.arrays import write_arrays
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample, join, review
from fwclass.train.stage import TRAIN_SAMPLE, candidates, merge

SAMPLE, BASE_ROWS = "sample", "base-rows"

KEPT = 64 << 20
"""Bytes of a survey's sample that a process keeps at most: parts that grow trees of one forest read it in turn."""

_kept: dict[tuple[str, str], dict[str, NDArray]] = {}


def draw_tile(
    here: StageInputs,
    names: tuple[str, ...],
    areas: tuple[Box, ...],
    params: TrainParams,
    classes: tuple[ClassDef, ...],
    judging: AreasSection | None = None,
    reach: float = 0.0,
) -> Result:
    """Which rows of a tile may train: those in training areas, and those that are corrected, wherever they lie."""
    table = here.rows()
    inside, corrected = within(table, areas), taught_rows(here, table, judging, reach)
    inside |= corrected
    if "sampled" in table:  # a thinned run
        inside &= table["sampled"]
    key = canonical_key(table)
    sample = candidates(table.select(names), table["reference"], key, inside, params, classes, first=corrected)
    write_arrays(here.directory / SAMPLE, sample.without_values().arrays())
    return {"rows": sample.rows, **({"corrected": int(corrected.sum())} if judging is not None else {})}


def taught_rows(here: StageInputs, table: Table, judging: AreasSection | None, reach: float) -> NDArray[np.bool_]:
    """bool (rows,): echoes of a tile that train because they are corrected; `judging` None: there is no correction."""
    if judging is None:
        return np.zeros(table.rows, bool)
    return corrected_training_rows(table, corrections_of(here), judging, reach)


def taught_argument(plan: Plan, tile: Any) -> Mapping[str, Any]:
    """What a stage that draws rows gets besides where echoes of its tile are corrected."""
    return {"judging": plan.config.areas, **reach_here(plan, tile)} if corrections_here(plan, tile) else {}


def places(table: Table) -> NDArray[np.int64]:
    """x and y (rows, 2) in whole millimetres."""
    return np.stack([millimetres(table["x"]), millimetres(table["y"])], axis=1).astype(np.int64)


def merge_samples(
    here: StageInputs,
    names: tuple[str, ...],
    params: TrainParams,
    classes: tuple[ClassDef, ...],
    based: bool = False,
    by_place: bool = False,
) -> Result:
    """The survey's sample; refused where a forest cannot be trained on it, unless it is `based` on another model.
    `by_place`: labels hang on places alone, and may lie elsewhere."""
    tiles = here.parts(TRAIN_SAMPLE.name)
    if not tiles:
        raise InputError(
            "no echo lies in any training area", where="areas.train", do="give boxes on the survey, in its coordinates"
        )
    sample = merged_sample(here.inputs, TRAIN_SAMPLE.name, tiles, {n: here.columns[n] for n in names}, params)
    if not based:  # the base model's rows may be all that there are of a class
        review(sample, classes)
    write_arrays(here.directory / SAMPLE, sample.arrays())
    facts: dict[str, Any] = {"rows": sample.rows, "counts": sample.counts.tolist()}
    counted = COUNT_TRAINING_ECHOES.name
    facts[DENSITY] = densities_by_receipts(here.inputs.meta(counted, block)[SQUARES] for block in here.parts(counted))
    if by_place:
        offset = measure_offset(sample.X, sample.y, sample.place, len(classes))
        facts["offset"] = None if offset is None else asdict(offset)
    return facts


def merged_sample(
    inputs: PartInputs, stage: str, tiles: Iterable[str], columns: Mapping[str, str], params: TrainParams
) -> Sample:
    """The sample of the rows that parts of `stage` drew from `tiles`; features (stage by column) and places are read of
    those rows alone that remain."""
    sample, names = merge((load_sample(inputs, stage, t, ()) for t in tiles), params), tuple(columns)
    X, place = np.empty((sample.rows, len(names)), np.float32), np.empty((sample.rows, 2), np.int64)
    for tile in tiles:
        keys = np.intersect1d(inputs.arrays(stage, tile, SAMPLE, ("key",))[0]["key"], sample.key, assume_unique=True)
        if len(keys) == 0:
            continue
        rows = rows_of(keys, canonical_key(inputs.rows(tile, dict.fromkeys(IDENTITY, "tile"))))
        order = np.argsort(rows)
        table = inputs.rows_at(tile, {**dict.fromkeys(("x", "y"), "tile"), **columns}, rows[order])
        at = np.searchsorted(sample.key, keys[order])
        X[at], place[at] = sample_matrix(table, names, "training rows"), places(table)
    return replace(sample, features=names, X=X, place=place)


def rows_of(keys: NDArray[np.uint64], there: NDArray[np.uint64]) -> NDArray[np.int64]:
    """int64 (keys,): in which rows of `there` the keys stand; each stands in one."""
    order = np.argsort(there)
    return order[np.searchsorted(there[order], keys)]


def load_sample(inputs: PartInputs, stage: str, part: str, names: tuple[str, ...]) -> Sample:
    """The sample that a part wrote, of features `names`."""
    return Sample.from_arrays(names, inputs.arrays(stage, part, SAMPLE)[0])


def survey_sample(inputs: PartInputs, names: tuple[str, ...]) -> Sample:
    """The sample of the whole survey, which this process keeps where it is no larger than `KEPT`; it is not to be
    written to."""
    key = (str(inputs.arrays_path("training", "all", SAMPLE)), inputs.digest("training", "all"))
    if key not in _kept:
        arrays, _ = inputs.arrays("training", "all", SAMPLE)
        _kept.clear()
        if sum(a.nbytes for a in arrays.values()) > KEPT:
            return Sample.from_arrays(names, arrays)
        _kept[key] = arrays
    return Sample.from_arrays(names, _kept[key])


def learned_sample(here: StageInputs, names: tuple[str, ...]) -> Sample:
    """All rows that the model learns from: the survey's sample, and rows of the base model where there is one."""
    return with_base_rows(here, survey_sample(here.inputs, names))


def with_base_rows(here: StageInputs, sample: Sample) -> Sample:
    """`sample`, rows of the survey, and after it those of the base model where there is one that has its features."""
    if not here.parts(BASE_ROWS):
        return sample
    arrays, _ = here.inputs.arrays(BASE_ROWS, "all", SAMPLE)
    values = arrays["X"]  # features, and context where the base model has it
    if values.shape[1] < len(sample.features):
        return sample
    wanted = np.ascontiguousarray(values[:, : len(sample.features)])
    base = Sample.from_arrays(sample.features, {**arrays, "X": wanted})
    return join((sample, base), sample.rows + base.rows)


def base_rows_part(plan: Plan) -> tuple[Name, ...]:
    """The rows of the base model, where there is one."""
    return ((BASE_ROWS, "all"),) if plan.base is not None else ()


def trains(plan: Plan) -> bool:
    """Whether the run trains a model of its own."""
    return plan.config.survey.model is None


def learning_arguments(plan: Plan) -> Mapping[str, Any]:
    """Arguments that all stages that learn share."""
    config = plan.config
    return {"names": config.features_asked, "params": config.train, "classes": config.classes}


def sample_rows(config: Config) -> int:
    """Rows of the survey's sample at most."""
    return config.train.samples_per_class * len(config.survey.classes)


OF_TREES = frozenset(
    {"bagging", "bins", "criterion", "features_per_split", "importance_repeats", "method"}
    | {"min_samples_split", "replacement", "split", "steps", "trees"}
)
"""Settings of `train` that grow trees and choose no rows: by name, so that a new one enters every key at first."""
NOT_OF_THE_SAMPLE = OF_TREES | {"base_rows", "class_weights"}
DRAW_SAMPLE = Stage(
    TRAIN_SAMPLE.name,
    TRAIN_SAMPLE.version,
    "tile",
    "echo",
    draw_tile,
    when=trains,
    parts=training_tiles,
    arguments=lambda plan: {**learning_arguments(plan), "areas": plan.config.areas.boxes("train")},
    each=taught_argument,
    silent=NOT_OF_THE_SAMPLE,
    own=lambda plan: (*IDENTITY_AND_PLACE, "z", *plan.config.features_asked, *sampled_columns(plan), "reference"),
    after=(CORRECTIONS,),
    needs=corrections_here,
    named=True,
)
MERGE_SAMPLE = Stage(
    "training",
    TRAIN_SAMPLE.version,
    "survey",
    "row",
    merge_samples,
    when=trains,
    arguments=lambda plan: {
        **learning_arguments(plan),
        **({"based": True} if plan.base is not None else {}),
        **({"by_place": True} if plan.config.survey.reference.kind == "polygons" else {}),
    },
    silent=NOT_OF_THE_SAMPLE,
    reads=lambda plan: ("x", "y", *plan.config.features_asked),
    tiles=training_tiles,
    after=("sample", COUNT_TRAINING_ECHOES.name),
    needs=lambda plan, part: [
        *((TRAIN_SAMPLE.name, t.key) for t in training_tiles(plan)),
        *((COUNT_TRAINING_ECHOES.name, b.key) for b in COUNT_TRAINING_ECHOES.all_parts(plan)),
    ],
    bulky=True,
)
