"""The stage that classifies: every echo of a tile by the model, or in a thinned run by its nearest sampled echo."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from fwclass.classify.exempt import Exempt
from fwclass.classify.stage import CLASSIFY, classify, count_filled, probability_columns
from fwclass.conf import Config
from fwclass.graph.context_layer import context_layer
from fwclass.graph.fine_layer import fine_layer
from fwclass.graph.kept import exempt_argument, exempt_columns
from fwclass.graph.loaded_models import used_model
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.graph.thin import thins
from fwclass.model import sample_matrix
from fwclass.model.ranges import RangeCounter
from fwclass.run.part import Name
from fwclass.schema import PLACE, Table
from fwclass.store.external_file import ExternalFile
from fwclass.store.remote_file import Location
from fwclass.survey.layout import FileDigests
from fwclass.thin.follow import follow
from fwclass.thin.sample import THIN

OUTSIDE = "outside"


def classify_tile(
    here: StageInputs, probabilities: bool, model: str | None, exempt: Exempt | None = None
) -> tuple[Table, dict[str, Any]]:
    """Class, confidence and entropy of a tile's echoes, and with `probabilities` the share of every class.

    `model`: digest of a given one, None for the run's own; `exempt`: which echoes
    do not get the class that it says.
    """
    used = used_model(here, model)
    tables, missing = [], 0
    outside = RangeCounter.of(used.card, used.features)
    for rows in here.cuts():
        X = sample_matrix(rows, used.features, here.part)
        if outside is not None:
            outside.add(X[~exempt.rows_kept(rows)] if exempt else X)
        answered = classify(X, used, probabilities)
        tables.append(exempt.written(answered, rows) if exempt else answered)
        missing += count_filled(X, used)
    table = tables[0] if len(tables) == 1 else Table.concat(tables)
    return table, {"codes": codes_of(table), "filled": missing, **outside_facts(outside)}


def classify_thinned_tile(
    here: StageInputs, probabilities: bool, model: str | None, reach: float, exempt: Exempt | None = None
) -> Result:
    """As `classify_tile`, for a thinned run: the model is asked about sampled echoes,
    in the halo too, and every other echo takes the answer to its nearest one within `reach` [m]."""
    chunk = here.chunk()
    rows = np.flatnonzero(chunk.table["sampled"])
    some = chunk.table.take(rows)
    used = used_model(here, model)
    X = sample_matrix(some, used.features, here.part)
    answer = classify(X, used, probabilities)
    outside = RangeCounter.of(used.card, used.features)
    if outside is not None:
        outside.add(X[np.isin(rows, chunk.core)])
    core = chunk.table.take(chunk.core)
    own = core["sampled"]
    near = np.searchsorted(rows, chunk.core)
    others = tuple(core[n][~own] for n in PLACE)
    near[~own] = follow((others[0], others[1], others[2]), (some["x"], some["y"], some["z"]), reach)
    answered = answer.take(near)
    table = exempt.written(answered, here.own_rows()) if exempt else answered
    facts = {"codes": codes_of(table), "filled": count_filled(X, used), "asked": int(own.sum())}
    return table, facts | outside_facts(outside)


def outside_facts(outside: RangeCounter | None) -> dict[str, Any]:
    """What a part's meta says of values that the model has not seen, if the model says what it has."""
    return {} if outside is None else {OUTSIDE: outside.counts()}


def codes_of(table: Table) -> dict[str, int]:
    """How many echoes of a table have each class code, by code as text."""
    codes, counts = np.unique(table["classification"], return_counts=True)
    return {str(c): int(n) for c, n in zip(codes.tolist(), counts.tolist(), strict=True)}


def _arguments(plan: Plan) -> Mapping[str, Any]:
    shares = plan.config.classify.probabilities
    return {"probabilities": shares, "model": plan.model[1] if plan.model else None, **exempt_argument(plan)}


def names_that_decide(plan: Plan) -> Mapping[str, Any]:
    """The features that the classifier decides by, which are read."""
    return {"names": plan.names}


def own_model(plan: Plan, part: Any) -> tuple[Name, ...]:
    """The part that holds the run's own model; none where a model is given."""
    return () if plan.model else (("train", "model"),)


def given_model(plan: Plan, part: Any) -> tuple[Location, FileDigests] | None:
    """Where a given model is, and its digest; None for the run's own."""
    return (plan.model[0], (ExternalFile("model", plan.model[1]),)) if plan.model else None


def regularizes(plan: Plan) -> bool:
    """Whether a mean field makes neighbours agree."""
    return plan.config.classify.regularize.strength > 0


def codes_on_lines(config: Config) -> tuple[int, ...]:
    """Codes of the classes whose echoes lie on lines, but for those that echoes of the source keep; none where not all
    echoes are answered for at once."""
    if thins(config) or config.classify.refine.between:
        return ()
    kept = config.classify.keep
    return tuple(code for code in config.classify.lines.among(c.code for c in config.classes) if code not in kept)


def line_codes(plan: Plan) -> tuple[int, ...]:
    """As `codes_on_lines`; none by a given model with a second layer of two classes either."""
    return codes_on_lines(plan.config) if fine_layer(plan) is None else ()


def settles(plan: Plan) -> bool:
    """Whether the model's answers are settled among neighbours: a mean field, or lines."""
    return regularizes(plan) or bool(line_codes(plan))


def classes_written(plan: Plan) -> tuple[str, ...]:
    """The columns that classifying writes, with the share of every class where the run asks for them."""
    shares = probability_columns(c.code for c in plan.config.classes) if plan.config.classify.probabilities else ()
    return (*CLASSIFY.writes, *shares)


CLASSIFY_ECHOES = Stage(
    CLASSIFY.name,
    CLASSIFY.version,
    "tile",
    "echo",
    classify_tile,
    when=lambda plan: (
        not thins(plan.config) and fine_layer(plan) is None and context_layer(plan) is None and not settles(plan)
    ),
    arguments=_arguments,
    keyed=names_that_decide,
    own=lambda plan: (*plan.names, *exempt_columns(plan)),
    writes=classes_written,
    after=("train",),
    needs=own_model,
    source=given_model,
)
CLASSIFY_THINNED = replace(
    CLASSIFY_ECHOES,
    function=classify_thinned_tile,
    when=lambda plan: thins(plan.config),
    arguments=lambda plan: {**_arguments(plan), "reach": plan.config.thin.reach},
    keyed=lambda plan: {**names_that_decide(plan), "thin": THIN.version},
    reads=lambda plan: (*PLACE, *plan.names, *THIN.writes),
    own=exempt_columns,
    halo=lambda plan: plan.config.thin.reach,
)
