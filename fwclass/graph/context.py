"""The stages of a layer that decides in context, as it answers: the first layer's shares, and both layers' classes."""

from __future__ import annotations

from typing import Any

import numpy as np

from fwclass.classify.context import CONTEXT, context_of, whole_shares, with_context
from fwclass.classify.exempt import Exempt
from fwclass.classify.stage import CLASSIFY, classify, count_filled
from fwclass.errors import InputError
from fwclass.graph.classify import (
    classes_written,
    classify_tile,
    codes_of,
    given_model,
    names_that_decide,
    outside_facts,
    own_model,
    settles,
)
from fwclass.graph.context_layer import ContextLayer, context_layer, layer_of
from fwclass.graph.kept import exempt_argument, exempt_columns
from fwclass.graph.loaded_models import used_model
from fwclass.graph.stage import Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.model import Contextual, sample_matrix
from fwclass.model.ranges import RangeCounter
from fwclass.schema import PLACE, Table

FIRST = "first-shares"


def share_first(here: StageInputs, layer: ContextLayer, model: str | None) -> Result:
    """The first layer's shares of a tile's echoes; none (0) where the run found that a second one does not pay."""
    both = used_model(here, model)
    if not isinstance(both, Contextual):
        _check_own(here, model)
        none = np.zeros(here.inputs.rows(here.part, {"x": "tile"}).rows, np.uint8)
        return Table(dict.fromkeys(layer.columns(), none)), {}
    used, tables = both.coarse, []
    outside = RangeCounter.of(used.card, used.features)
    for rows in here.cuts():
        X = sample_matrix(rows, used.features, here.part)
        if outside is not None:
            outside.add(X)
        tables.append(Table(dict(zip(layer.columns(), whole_shares(X, used).T, strict=True))))
    table = tables[0] if len(tables) == 1 else Table.concat(tables)
    return table, outside_facts(outside)


def classify_tile_in_context(
    here: StageInputs, layer: ContextLayer, probabilities: bool, model: str | None, exempt: Exempt | None = None
) -> tuple[Table, dict[str, Any]]:
    """Answers of both layers for a tile; `exempt` echoes do not get the class that they say.
    Where the run found that a second layer does not pay, those of the first one."""
    used = used_model(here, model)
    if not isinstance(used, Contextual):
        _check_own(here, model)
        return classify_tile(here, probabilities, model, exempt)
    rows_of, parts = [], []
    for these, chunk in here.chunks():
        rows_of.append(these)
        parts.append(context_of(chunk.table, chunk.core, layer.columns(), layer.cells))
    context = np.concatenate(parts)[np.argsort(np.concatenate(rows_of))]
    tables, missing, first = [], 0, 0
    for rows in here.cuts():
        X = sample_matrix(rows, used.features, here.part)
        answers = classify(with_context(X, context[first : first + rows.rows]), used, probabilities)
        tables.append(exempt.written(answers, rows) if exempt else answers)
        missing += count_filled(X, used.coarse)
        first += rows.rows
    table = tables[0] if len(tables) == 1 else Table.concat(tables)
    return table, {"codes": codes_of(table), "filled": missing}


def _check_own(here: StageInputs, model: str | None) -> None:
    """`InputError` unless the run made its model itself: one that is given has the second layer that was planned."""
    if model is not None:
        raise InputError("the model has no context", where=here.part, do="run the same again: it was changed")


SHARE_FIRST = Stage(
    FIRST,
    CLASSIFY.version,
    "tile",
    "echo",
    share_first,
    when=lambda plan: context_layer(plan) is not None,
    arguments=lambda plan: {"layer": layer_of(plan), "model": plan.model[1] if plan.model else None},
    keyed=names_that_decide,
    own=lambda plan: plan.names,
    writes=lambda plan: layer_of(plan).columns(),
    after=("train",),
    needs=own_model,
    source=given_model,
    row_digests=True,
)
CLASSIFY_IN_CONTEXT = Stage(
    CLASSIFY.name,
    1000 * CONTEXT.version + CLASSIFY.version,
    "tile",
    "echo",
    classify_tile_in_context,
    when=lambda plan: context_layer(plan) is not None and not settles(plan),
    arguments=lambda plan: {
        "layer": layer_of(plan),
        "probabilities": plan.config.classify.probabilities,
        "model": plan.model[1] if plan.model else None,
        **exempt_argument(plan),
    },
    keyed=names_that_decide,
    reads=lambda plan: (*PLACE, *layer_of(plan).columns()),
    own=lambda plan: (*plan.names, *exempt_columns(plan)),
    writes=classes_written,
    halo=lambda plan: layer_of(plan).halo,
    after=("train", FIRST),
    needs=own_model,
    source=given_model,
)
