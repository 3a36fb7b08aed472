"""From waveforms to voxels, vertical profiles and samples as points; nothing is classified."""

from __future__ import annotations

from fwclass.graph.backscatter import (
    DELIVER_PROFILES,
    DELIVER_SAMPLES,
    DELIVER_VOXELS,
    FILL_PROFILES,
    FILL_VOXELS,
    SAMPLE_WAVES,
)
from fwclass.graph.breaklines import READ_BREAKLINES
from fwclass.graph.ground import FILTER_GROUND, GATHER_GROUND, GATHER_HEIGHT, MAKE_TERRAIN
from fwclass.graph.sources import DECOMPOSE_RETURNS, DECOMPOSE_WAVES, INDEX, MEASURE_PLACES, MEASURE_PULSE, READ_SPAN
from fwclass.graph.stacking import DELIVER_STACK, MAKE_FIRST_TERRAIN, STACK_PULSES
from fwclass.graph.survey import SIMULATE
from fwclass.graph.tiling import SPLIT_ECHOES, TILE_ECHOES
from fwclass.graph.water import LEVEL_WATER, MEASURE_SHORE, READ_WATER
from fwclass.graph.workflow import Workflow

backscatter = Workflow(
    "backscatter",
    "from waveforms to voxels, vertical profiles and samples as points",
    stages=(
        SIMULATE,
        INDEX,
        READ_SPAN,
        MEASURE_PULSE,
        MEASURE_PLACES,
        DECOMPOSE_WAVES,
        DECOMPOSE_RETURNS,
        SPLIT_ECHOES,
        TILE_ECHOES,
        FILTER_GROUND,
        GATHER_GROUND,
        MAKE_FIRST_TERRAIN,
        STACK_PULSES,
        READ_BREAKLINES,
        READ_WATER,
        MEASURE_SHORE,
        LEVEL_WATER,
        MAKE_TERRAIN,
        GATHER_HEIGHT,
        DELIVER_STACK,
        SAMPLE_WAVES,
        FILL_VOXELS,
        FILL_PROFILES,
        DELIVER_SAMPLES,
        DELIVER_VOXELS,
        DELIVER_PROFILES,
    ),
)
