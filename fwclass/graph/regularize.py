"""The stages of a run whose answers are settled among neighbours: the model's own shares, and the classes after the
mean field and along lines."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.classify.exempt import Exempt
from fwclass.classify.lines import LINES, count_settled, settle_lines
from fwclass.classify.mean_field import (
    REGULARIZE,
    after_mean_field,
    answers,
    model_share_columns,
    shares_of,
    whole_columns,
)
from fwclass.classify.params import LineParams, RegularizeParams
from fwclass.classify.stage import CLASSIFY
from fwclass.graph.areas import has_reference, within
from fwclass.graph.classify import CLASSIFY_ECHOES, classes_written, classify_tile, codes_of, line_codes, settles
from fwclass.graph.context import CLASSIFY_IN_CONTEXT, classify_tile_in_context
from fwclass.graph.context_layer import ContextLayer, context_layer, layer_of
from fwclass.graph.fine_layer import fine_layer
from fwclass.graph.kept import exempt_argument, exempt_columns
from fwclass.graph.loaded_models import model_at
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.grid import Box
from fwclass.schema import Table
from fwclass.store.remote_file import local

MODEL_SHARES = "model-shares"


def share_tile(
    here: StageInputs, codes: tuple[int, ...], model: str | None, layer: ContextLayer | None = None
) -> Result:
    """The shares of all classes that the model gives a tile's echoes, with a `layer` in context both layers'."""
    table, facts = classify_tile_in_context(here, layer, True, model) if layer else classify_tile(here, True, model)
    return whole_columns(table, codes), {name: fact for name, fact in facts.items() if name != "codes"}


def regularize_tile(
    here: StageInputs,
    codes: tuple[int, ...],
    params: RegularizeParams,
    lines: LineParams | None,
    probabilities: bool,
    exempt: Exempt | None = None,
    taught: tuple[tuple[Box, ...], tuple[int, ...]] | None = None,
) -> Result:
    """Classes of a tile's echoes after the mean field and along `lines`; `exempt` echoes do not get
    them, and all are neighbours by what the model says of them. The model has learned from
    echoes in the areas `taught` that are labelled with one of its codes: these stay off the lines."""
    rows_of, parts, before = [], [], []
    written_as = np.array(codes, np.uint8)
    learned = _learned(here.own_rows(), *taught) if taught else None
    sparse = 0
    for rows, chunk in here.chunks():
        own = shares_of(chunk.table, codes)
        shares = after_mean_field(chunk.table, chunk.core, own, params)
        before.append(written_as[shares.argmax(axis=1)])
        if lines:
            for code in lines.codes:
                seen = None if learned is None else learned[rows]
                shares, few = settle_lines(chunk.table, chunk.core, own, shares, codes.index(code), lines, seen)
                sparse += few
        rows_of.append(rows)
        parts.append(answers(shares, written_as, probabilities))
    order = np.argsort(np.concatenate(rows_of))
    answered = Table.concat(parts).take(order)
    table = exempt.written(answered, here.own_rows()) if exempt else answered
    facts: dict[str, Any] = {"codes": codes_of(table)}
    if lines:
        stands = np.isfinite(table["confidence"]) & (table["classification"] == answered["classification"])
        both = np.concatenate(before)[order][stands], table["classification"][stands]
        facts |= {"lines": list(count_settled(*both, lines.codes)), "too_sparse": sparse}
    return table, facts


def _learned(table: Table, areas: tuple[Box, ...], codes: tuple[int, ...]) -> NDArray[np.bool_]:
    """bool (rows,): echoes in training `areas` that are labelled with one of `codes`."""
    return within(table, areas) & np.isin(table["reference"], [*codes])


def _taught(plan: Plan) -> tuple[tuple[Box, ...], tuple[int, ...]] | None:
    """Training areas of the run's own model, and the labels that it learns; None where lines ask for neither."""
    areas = plan.config.areas.boxes("train")
    if not areas or not line_codes(plan) or plan.model is not None or not has_reference(plan):
        return None
    return areas, tuple(code for c in plan.config.classes for code in c.codes)


def _codes(plan: Plan) -> tuple[int, ...]:
    """Codes of the classes, in the order of the model's shares."""
    if plan.model is not None:
        return tuple(model_at(local(plan.model[0]), plan.model[1], True).codes.tolist())
    return tuple(c.code for c in plan.config.classes)


def _share_arguments(plan: Plan) -> dict[str, Any]:
    return {"codes": _codes(plan), "model": plan.model[1] if plan.model else None}


def _lines(plan: Plan) -> LineParams | None:
    """Which classes lie on lines, and how; None where none does."""
    codes = line_codes(plan)
    return plan.config.classify.lines.model_copy(update={"codes": codes}) if codes else None


def settled_halo(plan: Plan) -> float:
    """What a tile reads around it [m]."""
    ways = plan.config.classify
    return max(
        ways.regularize.halo if ways.regularize.strength > 0 else 0.0, ways.lines.halo if line_codes(plan) else 0.0
    )


SHARE_ECHOES = replace(
    CLASSIFY_ECHOES,
    name=MODEL_SHARES,
    function=share_tile,
    when=lambda plan: settles(plan) and fine_layer(plan) is None and context_layer(plan) is None,
    arguments=_share_arguments,
    own=lambda plan: plan.names,
    writes=lambda plan: model_share_columns(_codes(plan)),
    row_digests=True,
)
SHARE_IN_CONTEXT = replace(
    CLASSIFY_IN_CONTEXT,
    name=MODEL_SHARES,
    function=share_tile,
    when=lambda plan: settles(plan) and context_layer(plan) is not None,
    arguments=lambda plan: {**_share_arguments(plan), "layer": layer_of(plan)},
    own=lambda plan: plan.names,
    writes=lambda plan: model_share_columns(_codes(plan)),
    row_digests=True,
)
CLASSIFY_REGULARIZED = Stage(
    CLASSIFY.name,
    1_000_000 * (REGULARIZE.version + LINES.version) + CLASSIFY.version,
    "tile",
    "echo",
    regularize_tile,
    when=settles,
    arguments=lambda plan: {
        "codes": _codes(plan),
        "params": plan.config.classify.regularize,
        "lines": _lines(plan),
        "probabilities": plan.config.classify.probabilities,
        **exempt_argument(plan),
        **({"taught": _taught(plan)} if _taught(plan) else {}),
    },
    reads=lambda plan: (
        *("x", "y", "z"),
        *(("echo_number",) if line_codes(plan) else ()),
        *model_share_columns(_codes(plan)),
    ),
    own=lambda plan: (*exempt_columns(plan), *(("x", "y", "reference") if _taught(plan) else ())),
    writes=classes_written,
    halo=settled_halo,
    after=(MODEL_SHARES,),
)
