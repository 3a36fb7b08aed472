"""Reference classes for echoes: from the source's own classes, from another cloud, or from polygons."""

from __future__ import annotations

from fwclass.label.cloud import from_cloud
from fwclass.label.params import LabelParams
from fwclass.label.polygons import from_polygons
from fwclass.schema import Table
from fwclass.stage import Chunk, Computation

__all__ = ["LABEL", "LabelParams", "from_cloud", "from_polygons", "from_source"]


def from_source(chunk: Chunk, params: LabelParams) -> Table:
    """The class that the source file gave to the nearest return of the echo's pulse."""
    return Table({"reference": chunk.table["source_class"][chunk.core]})


LABEL = Computation(
    "label", 2, reads=("x", "y", "z", "gps_time", "source_class"), writes=("reference",), halo=lambda p: p.max_distance
)
