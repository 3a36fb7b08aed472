"""The stage that chooses rows of a base model, to be learned from beside the survey's own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fwclass.classify.context import with_context
from fwclass.graph.base_model import base_has_context, base_layer, base_remarks
from fwclass.graph.context_layer import ContextLayer, context_layer
from fwclass.graph.learn import forest_learns
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.graph.training_rows import BASE_ROWS, OF_TREES, SAMPLE, learning_arguments, survey_sample
from fwclass.model import ClassDef, Contextual
from fwclass.store.arrays import write_arrays
from fwclass.store.external_file import ExternalFile
from fwclass.store.model_rows import load_same_rows
from fwclass.train.params import TrainParams
from fwclass.train.sample import kept_sample
from fwclass.train.stage import TRAIN_SAMPLE


def _arguments(plan: Plan) -> Mapping[str, Any]:
    more = {"layer": context_layer(plan)} if base_has_context(plan) else {}
    return {
        **learning_arguments(plan),
        "remarks": tuple(base_remarks(plan)),
        "base": plan.base[1] if plan.base else "",
        **more,
    }


def choose_base_rows(
    here: StageInputs,
    names: tuple[str, ...],
    params: TrainParams,
    classes: tuple[ClassDef, ...],
    remarks: tuple[str, ...],
    base: str,
    layer: ContextLayer | None = None,
) -> Result:
    """Of every class as many of the base model's rows as the survey has, `base_rows` at least, by the smallest hash;
    with their context where the run's second `layer` has the same. `base`: digest of the model and its rows."""
    model, rows_kept = load_same_rows(here.file(), base)
    X, there, theirs = rows_kept.X, model.features, base_layer(model, classes, layer)
    if isinstance(model, Contextual):
        X, there = with_context(X, rows_kept.context), model.deciding
    columns = [there.index(name) for name in (*names, *(theirs.names if theirs else ()))]
    wanted = (*names, *(layer.names if layer else ()))
    values = np.ascontiguousarray(X[:, columns])
    kept = kept_sample(wanted, values, rows_kept.codes, model.classes, classes, params.seed)
    own, rows = survey_sample(here.inputs, names).counts, []
    for k, count in enumerate(own.tolist()):
        mine = np.flatnonzero(kept.y == k)
        most = min(params.samples_per_class, max(count, params.base_rows))
        rows.append(mine[np.argsort(kept.hash[mine], kind="stable")[:most]])
    sample = kept.take(np.sort(np.concatenate(rows)))
    write_arrays(here.directory / SAMPLE, sample.arrays())
    return {"rows": sample.rows, "counts": sample.counts.tolist(), "remarks": list(remarks)}


CHOOSE_BASE_ROWS = Stage(
    BASE_ROWS,
    10 * TRAIN_SAMPLE.version + 1,
    "survey",
    "row",
    choose_base_rows,
    when=lambda plan: plan.base is not None and forest_learns(plan),
    arguments=_arguments,
    silent=OF_TREES | {"class_weights", "corrected_share"},
    after=("training",),
    needs=lambda plan, part: (("training", "all"),),
    source=lambda plan, part: (plan.base[0], (ExternalFile("model", plan.base[1]),)) if plan.base else None,
)
