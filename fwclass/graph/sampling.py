"""Stages that count the labels: how many echoes of every tile have which, and how many of them train."""

from __future__ import annotations

import numpy as np

from fwclass.conf.model import AreasSection
from fwclass.graph.areas import IDENTITY_AND_PLACE, labelled, tested, training_tiles
from fwclass.graph.learn import SAMPLE, trains
from fwclass.graph.stage import Made, Plan, Stage, StageInputs
from fwclass.label.census import census, taken
from fwclass.model import ClassDef
from fwclass.schema import canonical_key

LABELS, SAMPLES = "label-counts", "sample-counts"


def labels_counted(here: StageInputs, areas: AreasSection, classes: tuple[ClassDef, ...]) -> Made:
    """How many of a tile's echoes are labelled as what, and where they lie."""
    table, train = here.rows(), areas.boxes("train")
    return census(table, tested(table, train, areas.boxes("test"), areas.gap), train, classes)


def samples_counted(here: StageInputs, areas: AreasSection, classes: tuple[ClassDef, ...]) -> Made:
    """How many of a tile's echoes are in the survey's sample."""
    table = here.rows()
    arrays, _ = here.inputs.arrays("training", "all", SAMPLE, ("key",))
    return taken(table, np.isin(canonical_key(table), arrays["key"]), areas.boxes("train"), classes)


def _counted(plan: Plan) -> bool:
    return trains(plan) and labelled(plan)


COUNT_LABELS = Stage(
    LABELS,
    1,
    "tile",
    "echo",
    labels_counted,
    when=_counted,
    arguments=lambda plan: {"areas": plan.config.areas, "classes": plan.config.classes},
    own=("x", "y", "reference"),
)
COUNT_SAMPLES = Stage(
    SAMPLES,
    1,
    "tile",
    "echo",
    samples_counted,
    when=_counted,
    parts=training_tiles,
    arguments=lambda plan: {"areas": plan.config.areas, "classes": plan.config.classes},
    own=(*IDENTITY_AND_PLACE, "reference"),
    after=("training",),
    needs=lambda plan, tile: (("training", "all"),),
)
