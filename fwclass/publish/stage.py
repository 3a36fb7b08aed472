"""The outputs of a survey: what other rooms may call, and the record of the stage."""

from __future__ import annotations

from fwclass.publish.cog import class_raster, write_cog
from fwclass.publish.figures import class_map, relief
from fwclass.publish.geoparquet import write_geoparquet
from fwclass.publish.laz import write_tile_laz
from fwclass.publish.palette import colours
from fwclass.publish.params import PublishParams
from fwclass.publish.report import render_report
from fwclass.publish.strips import write_strip_laz
from fwclass.stage import Stage

PUBLISH = Stage(
    name="publish",
    version=1,
    kind="publish",
    function=write_tile_laz,
    params=PublishParams,
    reads=("strip", "echo_number", "number_of_echoes", "x", "y", "z", "classification"),
)

__all__ = [
    "PUBLISH",
    "PublishParams",
    "class_map",
    "class_raster",
    "colours",
    "relief",
    "render_report",
    "write_cog",
    "write_geoparquet",
    "write_strip_laz",
    "write_tile_laz",
]
