"""From waveforms or points to ground, terrain and heights of a whole survey; needs no labels and no model."""

from __future__ import annotations

from fwclass.graph.ground_classes import CLASSIFY_GROUND, without_classifier
from fwclass.graph.ground_seams import CHECK_SEAMS
from fwclass.graph.simulation import SIMULATE
from fwclass.graph.sources import INDEX
from fwclass.graph.stages import DELIVERY, OF_GROUND, OF_QUALITY, OF_STRIPS
from fwclass.graph.tiling import TILE_ECHOES
from fwclass.walk.workflow import Workflow

ground = Workflow(
    "ground",
    "from waveforms or points to ground, terrain and heights, without labels or a model",
    stages=(SIMULATE, INDEX, *OF_STRIPS, TILE_ECHOES, *OF_GROUND, CHECK_SEAMS, CLASSIFY_GROUND, *OF_QUALITY, *DELIVERY),
    settle=without_classifier,
)
