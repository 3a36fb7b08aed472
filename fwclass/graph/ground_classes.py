"""Classes that the ground filter alone gives, for a survey that is delivered without a classifier."""

from __future__ import annotations

from typing import Any

import numpy as np

from fwclass.classes import GROUND, HIGH_NOISE, LOW_NOISE, STANDARD, UNCLASSIFIED
from fwclass.classify.kept import Kept, with_kept
from fwclass.classify.stage import CLASSIFY
from fwclass.conf import Config
from fwclass.conf.sections import ClassSection, ReferenceSection
from fwclass.graph.classify import codes_of
from fwclass.graph.kept import kept_argument
from fwclass.graph.stage import Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.schema import Table

CODES = (UNCLASSIFIED, GROUND, LOW_NOISE, HIGH_NOISE)


def without_classifier(config: Config) -> Config:
    """`config` for a run that classifies by the ground filter: the standard's classes, and neither features, labels,
    a model nor what only features are made of."""
    survey: dict[str, Any] = {
        "classes": tuple(ClassSection(name=STANDARD[code], code=code, codes=(code,)) for code in CODES),
        "features": (),
        "model": None,
        "reference": ReferenceSection(kind="none"),
        "trajectory": config.survey.trajectory.model_copy(update={"files": ()}),
    }
    changes: dict[str, dict[str, Any]] = {
        "survey": survey,
        "areas": {"train": (), "test": ()},
        "features": {"also": ()},
        "radiometry": {"platform_altitude": None},
        "classify": {"probabilities": False},
        "thin": {"rate": 1.0},
    }
    sections = {name: getattr(config, name).model_copy(update=change) for name, change in changes.items()}
    return Config(**{**vars(config), **sections})


def classify_by_ground(here: StageInputs, kept: Kept | None = None) -> Result:
    """Codes of a tile's echoes by the filter's flags: 2 ground, 7 or 18 noise below or above the terrain, 1 the rest.

    Noise without a terrain below counts as low. There is no confidence, and no entropy (NaN). `kept` echoes have the
    class of their source.
    """
    table = here.rows()
    noise = np.where(table["height_above_ground"] > 0.0, HIGH_NOISE, LOW_NOISE)
    codes = np.where(table["noise"], noise, np.where(table["ground"], GROUND, UNCLASSIFIED)).astype(np.uint8)
    nothing = np.full(table.rows, np.nan, np.float32)
    classes = Table({"classification": codes, "confidence": nothing, "entropy": nothing})
    classes = with_kept(classes, table["source_class"], kept) if kept else classes
    return classes, {"codes": codes_of(classes), "of_source": _by_source(table)}


def _by_source(table: Table) -> dict[str, list[int]]:
    """Echoes by the class of their source, and how many of them are ground."""
    count = np.bincount(table["source_class"], minlength=256)
    ground = np.bincount(table["source_class"][table["ground"]], minlength=256)
    return {str(code): [int(count[code]), int(ground[code])] for code in np.flatnonzero(count).tolist()}


CLASSIFY_GROUND = Stage(
    CLASSIFY.name,
    2,
    "tile",
    "echo",
    classify_by_ground,
    when=lambda plan: not plan.names,  # a classifier decides by some features
    arguments=kept_argument,
    own=("ground", "noise", "height_above_ground", "source_class"),
    writes=CLASSIFY.writes,
)
