"""From waveforms or points to ground, terrain and heights of a whole survey; needs no labels and no model."""

from __future__ import annotations

from fwclass.graph.breaklines import READ_BREAKLINES
from fwclass.graph.catalogue import DELIVER_CATALOGUE, DELIVER_OVERVIEW, DELIVER_POLYGONS
from fwclass.graph.contours import CONTOUR_BLOCKS, DELIVER_CONTOURS
from fwclass.graph.ground import CHECK_SEAMS, FILTER_GROUND, GATHER_GROUND, GATHER_HEIGHT, MAKE_TERRAIN
from fwclass.graph.ground_classes import CLASSIFY_GROUND, without_classifier
from fwclass.graph.outputs import DELIVER_STRIP, DELIVER_TILE
from fwclass.graph.quality import DELIVER_QUALITY, MEASURE_QUALITY
from fwclass.graph.raster_outputs import DELIVER_RASTERS, MAP_CLASSES
from fwclass.graph.sources import DECOMPOSE_RETURNS, DECOMPOSE_WAVES, INDEX, MEASURE_PLACES, MEASURE_PULSE, READ_SPAN
from fwclass.graph.stacking import DELIVER_STACK, MAKE_FIRST_TERRAIN, STACK_PULSES
from fwclass.graph.survey import SIMULATE
from fwclass.graph.tiling import SPLIT_ECHOES, TILE_ECHOES
from fwclass.graph.water import LEVEL_WATER, MEASURE_SHORE, READ_WATER
from fwclass.graph.workflow import Workflow

ground = Workflow(
    "ground",
    "from waveforms or points to ground, terrain and heights, without labels or a model",
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
        CHECK_SEAMS,
        CLASSIFY_GROUND,
        MEASURE_QUALITY,
        DELIVER_TILE,
        DELIVER_STRIP,
        DELIVER_STACK,
        MAP_CLASSES,
        DELIVER_RASTERS,
        CONTOUR_BLOCKS,
        DELIVER_CONTOURS,
        DELIVER_QUALITY,
        DELIVER_OVERVIEW,
        DELIVER_CATALOGUE,
        DELIVER_POLYGONS,
    ),
    settle=without_classifier,
)
