"""From waveforms (or echoes) to classified tiles that a GIS opens: the stages, in order."""

from __future__ import annotations

from fwclass.graph.ground_seams import CHECK_SEAMS
from fwclass.graph.simulation import SIMULATE
from fwclass.graph.stages import (
    CLASSIFYING,
    DELIVERY,
    JUDGING,
    LEARNING,
    OF_QUALITY,
    OF_VECTORS,
    OF_WAVEFORMS,
    TO_LABELS,
    TO_TILES,
)
from fwclass.walk.workflow import Workflow

classification = Workflow(
    "classification",
    "from waveforms or echoes to classified tiles, strips and rasters",
    stages=(
        SIMULATE,
        *TO_TILES,
        *TO_LABELS,
        CHECK_SEAMS,  # long, and one part: not at the end
        *OF_QUALITY,
        *LEARNING,
        *CLASSIFYING,
        *JUDGING,
        *DELIVERY,
        *OF_VECTORS,
        *OF_WAVEFORMS,
    ),
)
