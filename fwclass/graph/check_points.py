"""The stage that holds the ground against the survey's check points."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.grid import Box, TileGrid
from fwclass.quality.check_points import facts_of, ground_heights
from fwclass.store.arrays import write_arrays
from fwclass.survey.check_point_file import read_check_points
from fwclass.survey.shape_files import source_of

CHECK_POINTS = "check-points"
FILE = "points"

NAME = 64
"""Bytes of a point's name that are kept."""

SQUARE = 64.0
"""m, points in one square are held against the echoes around it together."""


def compare_heights(here: StageInputs, reach: float, own_crs: str | None, crs: str | None) -> Result:
    """The ground at every check point [m], and how far its nearest ground echo is [m]."""
    x, y, z, code, names = read_check_points(here.file(), own_crs, crs)
    height, near = np.full(len(x), np.nan), np.full(len(x), np.nan)
    for rows, box in _together(x, y, reach):
        echoes = here.inputs.inside(box, here.tile_size, here.columns, here.present)
        echoes = echoes.take(echoes["ground"] & ~echoes["noise"])
        ground = echoes["x"], echoes["y"], echoes["z"]
        height[rows], near[rows] = ground_heights((x[rows], y[rows]), ground, reach)
    arrays = {"x": x, "y": y, "z": z, "code": code, "height": height, "near": near}
    if names is not None:
        arrays["name"] = np.array([n.encode() for n in names], f"S{NAME}").view(np.uint8).reshape(-1, NAME)
    write_arrays(here.directory / FILE, arrays)
    return facts_of((x, y, z), height, near, code)


def _together(x: NDArray[np.float64], y: NDArray[np.float64], reach: float) -> Iterable[tuple[NDArray[np.int64], Box]]:
    """Rows of the points of a square, and the box that the echoes around them lie in."""
    place = np.stack(TileGrid(SQUARE).indices(x, y), axis=1)
    order = np.lexsort(place.T)
    first = np.flatnonzero((np.diff(place[order], axis=0) != 0).any(axis=1)) + 1
    for rows in np.split(order, first):
        box = Box(float(x[rows].min()), float(y[rows].min()), float(x[rows].max()), float(y[rows].max()))
        yield rows, box.grown(reach + 0.001)


def has_check_points(plan: Plan) -> bool:
    """Whether a run holds its heights against check points."""
    return plan.config.quality.check_points.file is not None


MEASURE_CHECK_POINTS = Stage(
    CHECK_POINTS,
    5,
    "survey",
    "part",
    compare_heights,
    when=has_check_points,
    arguments=lambda plan: {
        "reach": plan.config.quality.check_points.reach,
        "own_crs": plan.survey.check_points.crs if plan.survey.check_points else None,
        "crs": plan.survey.crs,
    },
    reads=("x", "y", "z", "ground", "noise"),
    source=lambda plan, part: source_of(plan.survey.check_points),
)
