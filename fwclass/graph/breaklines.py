"""The stage of breaklines: lines with heights as places that the terrain passes through."""

from __future__ import annotations

import numpy as np
from pyproj import CRS

from fwclass.graph.stage import Made, Plan, Stage, StageInputs
from fwclass.graph.water import Points
from fwclass.grid import Box, quantised
from fwclass.read.polygons import open_polygons, read_lines, reprojected
from fwclass.run.part import Name
from fwclass.store.arrays import write_arrays

BREAKLINES = "breaklines"
FILE = "knots"


def breaklines_read(here: StageInputs, crs: str | None, layer: str, own_crs: str | None, step: float) -> Made:
    """Places every `step` [m] at most along the lines, with heights between those of their points."""
    path = here.file()
    shapes, z = read_lines(open_polygons(path, layer))
    if own_crs is not None and crs is not None:
        shapes, _ = reprojected(shapes, CRS.from_wkt(own_crs), CRS.from_wkt(crs), path)
    x, y = shapes.x, shapes.y
    last = np.zeros(len(x), bool)
    last[shapes.ring_start[1:] - 1] = True
    at = np.flatnonzero(~last)
    number = np.maximum(1, np.ceil(np.hypot(x[at + 1] - x[at], y[at + 1] - y[at]) / step)).astype(np.int64)
    edge = np.repeat(at, number)
    share = (np.arange(len(edge)) - np.repeat(np.cumsum(number) - number, number)) / np.repeat(number, number)
    ends = np.flatnonzero(last)
    knots = [np.append(v[edge] + share * (v[edge + 1] - v[edge]), v[ends]) for v in (x, y, z)]
    write_arrays(here.directory / FILE, {n: quantised(v) for n, v in zip("xyz", knots, strict=True)})
    return {"lines": shapes.parts, "knots": len(knots[0])}


def breaklines_in(here: StageInputs, box: Box) -> list[Points]:
    """Places of the survey's breaklines in `box`, where the stage reads any."""
    if not here.parts(BREAKLINES):
        return []
    arrays = here.inputs.arrays(BREAKLINES, "all", FILE)[0]
    rows = np.flatnonzero(box.contains(arrays["x"], arrays["y"]))
    return [(arrays["x"][rows], arrays["y"][rows], arrays["z"][rows])]


def _wanted(plan: Plan) -> bool:
    return plan.config.breaklines.file is not None


def breaklines_needed(plan: Plan) -> list[Name]:
    """The part that holds the survey's breaklines, for a stage that makes terrain."""
    return [(BREAKLINES, "all")] if _wanted(plan) else []


READ_BREAKLINES = Stage(
    BREAKLINES,
    1,
    "survey",
    "part",
    breaklines_read,
    when=_wanted,
    arguments=lambda plan: {
        "crs": plan.survey.crs,
        "layer": plan.survey.breaklines.layer if plan.survey.breaklines else "",
        "own_crs": plan.survey.breaklines.crs if plan.survey.breaklines else None,
        "step": plan.config.terrain.thin,
    },
    source=lambda plan, part: (
        (plan.survey.breaklines.path, plan.survey.breaklines.digests) if plan.survey.breaklines else None
    ),
)
