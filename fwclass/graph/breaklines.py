"""The stage of breaklines: lines with heights as places that the terrain passes through."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray
from pyproj import CRS

from fwclass.formats.projected import height_unit
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.graph.water import near_echoes
from fwclass.grid import Box, quantise
from fwclass.neighbours import Points
from fwclass.read.polygons import open_polygons, read_lines, reproject
from fwclass.run.part import Name
from fwclass.store.arrays import write_arrays
from fwclass.survey.shape_files import read_as, source_of
from fwclass.water.along import knots_along, lines_outside

BREAKLINES = "breaklines"
FILE = "knots"

BESIDE = 3.0
"""m, in plan: further away a slope alone makes a metre."""

OFF = 1.0
"""m; a wall has echoes of its foot and of its crest beside it, so that half of the places may be off."""

Floats = NDArray[np.float64]


def read_breaklines(
    here: StageInputs,
    crs: str | None,
    layer: str,
    own_crs: str | None,
    step: float,
    near: tuple[float, float, float, float],
) -> Result:
    """Places every `step` [m] at most along the lines in the box `near` [m], with heights between those of their
    points, in metres by the unit that their own system has for heights."""
    path = here.file()
    shapes, z = read_lines(open_polygons(path, layer))
    if own_crs is not None and crs is not None:
        own = CRS.from_wkt(own_crs)
        shapes, _ = reproject(shapes, own, CRS.from_wkt(crs), path)
        z = z * height_unit(own)
    knots = knots_along(shapes.x, shapes.y, z, shapes.ring_start, step, near)
    write_arrays(here.directory / FILE, {n: quantise(v) for n, v in zip("xyz", knots, strict=True)})
    outside = lines_outside(shapes.x, shapes.y, shapes.ring_start, near)
    return {"lines": shapes.parts, "outside": outside, "knots": len(knots[0])}


def breaklines_in(here: StageInputs, box: Box) -> list[Points]:
    """Places of the survey's breaklines in `box`, where the stage reads any."""
    if not here.parts(BREAKLINES):
        return []
    arrays = here.inputs.arrays(BREAKLINES, "all", FILE)[0]
    rows = np.flatnonzero(box.contains(arrays["x"], arrays["y"]))
    return [(arrays["x"][rows], arrays["y"][rows], arrays["z"][rows])]


def beside_ground(knots: Sequence[Points], x: Floats, y: Floats, z: Floats) -> dict[str, int]:
    """How many places of breaklines have a ground echo (x, y, z) within `BESIDE`, and how many of these lie more than
    `OFF` above or below the nearest."""
    if not knots or not len(x):
        return {"compared": 0, "above": 0, "below": 0}
    kx, ky, kz = (np.concatenate(v) for v in zip(*knots, strict=True))
    distance, nearest = scipy.spatial.cKDTree(np.c_[x, y]).query(np.c_[kx, ky], distance_upper_bound=BESIDE)
    near = np.isfinite(distance)
    dz = kz[near] - z[np.asarray(nearest)[near]]
    return {"compared": int(near.sum()), "above": int((dz > OFF).sum()), "below": int((dz < -OFF).sum())}


def breakline_remarks(blocks: Iterable[Mapping[str, int]]) -> list[str]:
    """That most places of breaklines lie beside the terrain: then their heights are of another kind."""
    total: Counter[str] = Counter()
    for counts in blocks:
        total.update(counts)
    return [
        f"breaklines lie more than {OFF:g} m {side} the ground echoes beside them at {total[side]:,} of "
        f"{total['compared']:,} places, and the terrain follows them: are both heights of one kind (geoid or "
        "ellipsoid, metres)?"
        for side in ("above", "below")
        if total[side] > total["compared"] / 2
    ]


def outside_remarks(files: Iterable[Mapping[str, int]]) -> list[str]:
    """That some lines lie far from the survey: most files of lines cover more, and some are in another system."""
    return [
        f"{f['outside']:,} of {f['lines']:,} breaklines lie away from the survey, and change nothing: if they should "
        "not, check their coordinates"
        for f in files
        if f["outside"]
    ]


def _is_wanted(plan: Plan) -> bool:
    return plan.config.breaklines.file is not None


def breaklines_needed(plan: Plan) -> list[Name]:
    """The part that holds the survey's breaklines, for a stage that makes terrain."""
    return [(BREAKLINES, "all")] if _is_wanted(plan) else []


READ_BREAKLINES = Stage(
    BREAKLINES,
    3,
    "survey",
    "part",
    read_breaklines,
    when=_is_wanted,
    arguments=lambda plan: {
        **read_as(plan.survey.breaklines, plan.survey.crs),
        "step": plan.config.terrain.thin,
        "near": near_echoes(plan),
    },
    source=lambda plan, part: source_of(plan.survey.breaklines),
)
