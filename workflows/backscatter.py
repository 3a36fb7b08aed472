"""From waveforms to voxels, vertical profiles and samples as points; nothing is classified."""

from __future__ import annotations

from fwclass.graph.ground_classes import without_classifier
from fwclass.graph.simulation import SIMULATE
from fwclass.graph.sources import INDEX
from fwclass.graph.stacking import DELIVER_STACK
from fwclass.graph.stages import OF_GROUND, OF_STRIPS, OF_WAVEFORMS
from fwclass.graph.tiling import TILE_ECHOES
from fwclass.walk.workflow import Workflow

backscatter = Workflow(
    "backscatter",
    "from waveforms to voxels, vertical profiles and samples as points",
    stages=(SIMULATE, INDEX, *OF_STRIPS, TILE_ECHOES, *OF_GROUND, DELIVER_STACK, *OF_WAVEFORMS),
    settle=without_classifier,
)
