"""How good a survey is: density, noise and differences of its strips; needs no labels and no model."""

from __future__ import annotations

from fwclass.graph.ground import FILTER_GROUND, GATHER_GROUND
from fwclass.graph.ground_auto import CHOOSE_PARAMETERS
from fwclass.graph.ground_classes import without_classifier
from fwclass.graph.quality import DELIVER_QUALITY
from fwclass.graph.simulation import SIMULATE
from fwclass.graph.sources import INDEX
from fwclass.graph.stages import OF_NOISE, OF_QUALITY, OF_STRIPS
from fwclass.graph.tiling import TILE_ECHOES
from fwclass.walk.workflow import Workflow

quality = Workflow(
    "quality",
    "how good a survey is: density, noise, differences of strips; without labels or a model",
    stages=(
        *(SIMULATE, INDEX, *OF_STRIPS, TILE_ECHOES),
        *(CHOOSE_PARAMETERS, FILTER_GROUND, GATHER_GROUND, *OF_NOISE, *OF_QUALITY, DELIVER_QUALITY),
    ),
    settle=without_classifier,
    only_judges=True,
)
