"""Stages that count the labels: how many echoes of every tile have which, and how many of them train."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fwclass.conf.sections import AreasSection
from fwclass.errors import ConfigError
from fwclass.graph.areas import IDENTITY_AND_PLACE, has_reference, rows_to_test, training_tiles
from fwclass.graph.base_model import base_has_context, classes_of_base
from fwclass.graph.context_layer import context_layer, tries
from fwclass.graph.corrections import (
    CORRECTIONS,
    corrected_training_rows,
    corrections_around,
    corrections_of,
    reach_around,
    untaught_rows,
)
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.graph.training_rows import SAMPLE, trains
from fwclass.label.counts import count_labelled, count_training, lacking, total
from fwclass.model import ClassDef
from fwclass.run.part import Name
from fwclass.schema import canonical_key
from fwclass.store.receipts import Receipt

LABELS, SAMPLES = "label-counts", "sample-counts"


def count_labels(here: StageInputs, areas: AreasSection, classes: tuple[ClassDef, ...], reach: float = 0.0) -> Result:
    """How many of a tile's echoes are labelled as what, and where they lie."""
    table, train = here.rows(), areas.boxes("train")
    if not here.parts(CORRECTIONS):
        return count_labelled(table, rows_to_test(table, train, areas.boxes("test"), areas.gap), train, classes)
    corrections = corrections_of(here)
    corrected = corrected_training_rows(table, corrections, areas, reach)
    return count_labelled(table, untaught_rows(table, corrections, areas, reach), train, classes, corrected)


def count_samples(here: StageInputs, areas: AreasSection, classes: tuple[ClassDef, ...]) -> Result:
    """How many of a tile's echoes are in the survey's sample."""
    table = here.rows()
    arrays, _ = here.inputs.arrays("training", "all", SAMPLE, ("key",))
    return count_training(table, np.isin(canonical_key(table), arrays["key"]), areas.boxes("train"), classes)


def check_labels(plan: Plan, counted: Mapping[Name, Receipt]) -> dict[str, Any]:
    """`ConfigError` where a class, or a training area, has no labelled echo to learn from; else the counts.

    `counted`: receipts of `COUNT_LABELS`. Where one is missing nothing is said: its echoes may have what is lacking.
    """
    if not _counts_labels(plan) or len(counted) < len(plan.layout.tiles):
        return {}
    config = plan.config
    train = config.areas.boxes("train")
    whole = total((receipt.meta for receipt in counted.values()), len(train), len(config.classes))
    layers = context_layer(plan) is None or tries(plan) or base_has_context(plan)
    stands = layers and any(whole["labelled"])  # base rows stand in for a class without labels
    sentences = lacking(whole, config.classes, train, classes_of_base(plan) if stands else frozenset())
    if sentences:
        by_hand = config.survey.reference.kind == "corrections"
        how = (
            "correct or confirm echoes of it (docs/labels.md)"
            if by_hand
            else "draw training areas where every class is labelled"
        )
        if config.survey.reference.kind == "echoes" and not any(whole["labelled"]):
            how = (
                "give labels of these very files (a strip is its file's name, a pulse its place in the file, and x, y, "
                f"z within {config.label.max_move:g} m, label.max_move)"
            )
        raise ConfigError(
            "the labels do not suffice to train on",
            where=f"{config.path}: {'' if by_hand else 'areas.train, '}survey.classes",
            got=" ".join(sentences),
            do=f"{how}, or leave the class out of survey.classes",
        )
    return dict(whole)


def _counts_labels(plan: Plan) -> bool:
    return trains(plan) and has_reference(plan)


COUNT_LABELS = Stage(
    LABELS,
    1,
    "tile",
    "echo",
    count_labels,
    when=_counts_labels,
    arguments=lambda plan: {"areas": plan.config.areas, "classes": plan.config.classes},
    each=reach_around,
    own=(*IDENTITY_AND_PLACE, "z", "reference"),
    after=(CORRECTIONS,),
    needs=corrections_around,
    named=True,
)
COUNT_SAMPLES = Stage(
    SAMPLES,
    1,
    "tile",
    "echo",
    count_samples,
    when=_counts_labels,
    parts=training_tiles,
    arguments=lambda plan: {"areas": plan.config.areas, "classes": plan.config.classes},
    own=(*IDENTITY_AND_PLACE, "reference"),
    after=("training",),
    needs=lambda plan, tile: (("training", "all"),),
)
