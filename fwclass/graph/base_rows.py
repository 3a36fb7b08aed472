"""The stage that chooses rows of a base model, to be learned from beside the survey's own."""

from __future__ import annotations

import numpy as np

from fwclass.graph.learn import BASE_ROWS, SAMPLE, forest_learns, learning_arguments, survey_sample
from fwclass.graph.stage import Result, Stage, StageInputs
from fwclass.model import ClassDef
from fwclass.store.arrays import write_arrays
from fwclass.store.external_file import ExternalFile
from fwclass.store.model_rows import load_rows
from fwclass.train.params import TrainParams
from fwclass.train.sample import kept_sample
from fwclass.train.stage import TRAIN_SAMPLE


def choose_base_rows(
    here: StageInputs, names: tuple[str, ...], params: TrainParams, classes: tuple[ClassDef, ...]
) -> Result:
    """Of every class as many of the base model's rows as the survey has, `base_rows` at least, by the smallest hash."""
    model, X, codes = load_rows(here.file())
    columns = [model.features.index(name) for name in names]
    kept = kept_sample(names, np.ascontiguousarray(X[:, columns]), codes, classes, params.seed)
    own, rows = survey_sample(here.inputs, names).counts, []
    for k, count in enumerate(own.tolist()):
        mine = np.flatnonzero(kept.y == k)
        most = min(params.samples_per_class, max(count, params.base_rows))
        rows.append(mine[np.argsort(kept.hash[mine], kind="stable")[:most]])
    sample = kept.take(np.sort(np.concatenate(rows)))
    write_arrays(here.directory / SAMPLE, sample.arrays())
    return {"rows": sample.rows, "counts": sample.counts.tolist()}


CHOOSE_BASE_ROWS = Stage(
    BASE_ROWS,
    TRAIN_SAMPLE.version,
    "survey",
    "row",
    choose_base_rows,
    when=lambda plan: plan.base is not None and forest_learns(plan),
    arguments=learning_arguments,
    silent=frozenset(TrainParams.model_fields) - {"seed", "samples_per_class", "base_rows"},
    after=("training",),
    needs=lambda plan, part: (("training", "all"),),
    source=lambda plan, part: (plan.base[0], (ExternalFile("model", plan.base[1]),)) if plan.base else None,
)
