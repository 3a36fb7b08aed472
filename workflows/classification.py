"""From waveforms (or echoes) to classified tiles that a GIS opens: the stages, in order."""

from __future__ import annotations

from fwclass.graph.assess import ASSESS, COUNT_CONFUSION
from fwclass.graph.backscatter import (
    DELIVER_PROFILES,
    DELIVER_SAMPLES,
    DELIVER_VOXELS,
    FILL_PROFILES,
    FILL_VOXELS,
    SAMPLE_WAVES,
)
from fwclass.graph.breaklines import READ_BREAKLINES
from fwclass.graph.catalogue import DELIVER_CATALOGUE, DELIVER_OVERVIEW, DELIVER_POLYGONS
from fwclass.graph.classify import CLASSIFY_ECHOES, CLASSIFY_THINNED
from fwclass.graph.contours import CONTOUR_BLOCKS, DELIVER_CONTOURS
from fwclass.graph.corrections import READ_CORRECTIONS, READ_ECHO_LABELS
from fwclass.graph.features import COMPUTE_FEATURES
from fwclass.graph.ground import CHECK_SEAMS, FILTER_GROUND, GATHER_GROUND, GATHER_HEIGHT, MAKE_TERRAIN
from fwclass.graph.label import LABEL_BY_CLOUD, LABEL_BY_ECHOES, LABEL_BY_POLYGONS, LABEL_BY_SOURCE, READ_POLYGONS
from fwclass.graph.learn import (
    DRAW_SAMPLE,
    GROW_TREES,
    MERGE_SAMPLE,
    TRAIN_BASELINE,
    TRAIN_FOREST,
    TRY_MACHINES,
    WEIGH_FEATURES,
)
from fwclass.graph.outputs import DELIVER_STRIP, DELIVER_TILE
from fwclass.graph.quality import DELIVER_QUALITY, MEASURE_QUALITY
from fwclass.graph.radiometry import (
    CALIBRATE_STRIPS,
    CHECK_POINTING,
    COMPARE_STRIPS,
    MEASURE_RADIOMETRY,
    READ_TRAJECTORY,
)
from fwclass.graph.raster_outputs import DELIVER_RASTERS, MAP_CLASSES
from fwclass.graph.refine import (
    ANSWER_COARSE,
    CLASSIFY_REFINED,
    DRAW_BOUNDARY,
    MERGE_BOUNDARY,
    TRAIN_COARSE_BASELINE,
    TRAIN_COARSE_FOREST,
    TRAIN_FINE,
    WIDEN_BOUNDARY,
)
from fwclass.graph.sampling import COUNT_LABELS, COUNT_SAMPLES
from fwclass.graph.sources import DECOMPOSE_RETURNS, DECOMPOSE_WAVES, INDEX, MEASURE_PLACES, MEASURE_PULSE, READ_SPAN
from fwclass.graph.stacking import DELIVER_STACK, MAKE_FIRST_TERRAIN, STACK_PULSES
from fwclass.graph.survey import SIMULATE
from fwclass.graph.thin import THIN_ECHOES
from fwclass.graph.tiling import SPLIT_ECHOES, SPLIT_REFERENCE, TILE_ECHOES, TILE_REFERENCE
from fwclass.graph.vectors import CHOOSE_CELL, COUNT_PULSES, DELIVER_VECTORS, FIND_BUILDINGS, FIND_TREES
from fwclass.graph.water import LEVEL_WATER, MEASURE_SHORE, READ_WATER
from fwclass.graph.workflow import Workflow

classification = Workflow(
    "classification",
    "from waveforms or echoes to classified tiles, strips and rasters",
    stages=(
        # files to echoes
        SIMULATE,
        READ_POLYGONS,
        READ_ECHO_LABELS,
        READ_CORRECTIONS,
        INDEX,
        READ_SPAN,
        MEASURE_PULSE,
        MEASURE_PLACES,
        DECOMPOSE_WAVES,
        DECOMPOSE_RETURNS,
        # echoes to tiles
        SPLIT_ECHOES,
        SPLIT_REFERENCE,
        TILE_ECHOES,
        TILE_REFERENCE,
        READ_TRAJECTORY,
        # what is known of every echo
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
        THIN_ECHOES,
        COMPUTE_FEATURES,
        CHECK_POINTING,
        COMPARE_STRIPS,
        CALIBRATE_STRIPS,
        MEASURE_RADIOMETRY,
        LABEL_BY_SOURCE,
        LABEL_BY_CLOUD,
        LABEL_BY_POLYGONS,
        LABEL_BY_ECHOES,
        CHECK_SEAMS,  # long, and one part: not at the end
        MEASURE_QUALITY,
        # the model
        DRAW_SAMPLE,
        MERGE_SAMPLE,
        GROW_TREES,
        WEIGH_FEATURES,
        TRAIN_FOREST,
        TRY_MACHINES,
        TRAIN_BASELINE,
        # of two layers: the first one's answers, and what the second learns where classes meet
        TRAIN_COARSE_FOREST,
        TRAIN_COARSE_BASELINE,
        ANSWER_COARSE,
        DRAW_BOUNDARY,
        MERGE_BOUNDARY,
        TRAIN_FINE,
        WIDEN_BOUNDARY,
        COUNT_LABELS,
        COUNT_SAMPLES,
        # classes, how good they are, and what is delivered
        CLASSIFY_ECHOES,
        CLASSIFY_THINNED,
        CLASSIFY_REFINED,
        COUNT_CONFUSION,
        ASSESS,
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
        # footprints of buildings, trees
        COUNT_PULSES,
        CHOOSE_CELL,
        FIND_BUILDINGS,
        FIND_TREES,
        DELIVER_VECTORS,
        # for those who want the waveform, not echoes
        SAMPLE_WAVES,
        FILL_VOXELS,
        FILL_PROFILES,
        DELIVER_SAMPLES,
        DELIVER_VOXELS,
        DELIVER_PROFILES,
    ),
)
