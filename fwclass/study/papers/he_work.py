"""Work of the parts of He 2023: one filter on one labelled sample, as it is set, at its best, and held out."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.graph.ground_trial import FilterTrial, halves, ranges_of, search_halves, start_of, truth_of, with_values
from fwclass.graph.stage_work import StageInputs
from fwclass.grid import Window
from fwclass.ground.blocks import ground_by_blocks
from fwclass.ground.measure import measure
from fwclass.ground.params import GroundParams
from fwclass.ground.terrain.blocks import terrain_by_blocks
from fwclass.ground.terrain.params import TerrainParams
from fwclass.ground.tuning_params import GroundSearchParams
from fwclass.neighbours import Points
from fwclass.read.cloud import PointCloud, read_point_cloud
from fwclass.run.inputs import PartInputs
from fwclass.store.arrays import write_arrays

TERRAIN, REFERENCE = "terrain", "reference"


def judge_filter(
    here: StageInputs, params: GroundParams, limits: GroundSearchParams, terrain: TerrainParams
) -> Mapping[str, Any]:
    """A filter's parameters with the greatest kappa on a sample, what it has right by them, and its terrain.

    ``start``, ``best``, ``held_out`` and ``curves`` as in `search_halves`, ``seconds`` of the processor of a run as
    set, ``points``, ``runs`` that were tried; arrays ``dtm`` of the best flags.
    """
    cloud = read_point_cloud(here.file())
    truth, shown, rows = _labelled(cloud)
    places = (cloud.x, cloud.y, cloud.z)
    seen = shown.copy()
    seen[rows] = ~ground_by_blocks(*_some(places, rows), cloud.last[rows], params).noise
    ranges = ranges_of(params, limits)
    start = start_of(params, ranges)
    trial = FilterTrial(places, cloud.last, seen, halves(cloud.x, cloud.y, cloud.usable), truth, params, ranges)
    searches = search_halves(trial, start, limits)
    began = time.thread_time()
    ground_by_blocks(*_some(places, rows), cloud.last[rows], params)
    seconds = time.thread_time() - began
    best = with_values(params, searches["best"]["parameters"])
    flags = ground_by_blocks(*_some(places, rows), cloud.last[rows], best)
    _write_terrain(places, rows, flags.ground, flags.noise, terrain, here.directory)
    return {**searches, "seconds": seconds, "points": len(rows), "runs": len(trial.known)}


def describe_sample(here: StageInputs, params: GroundParams, terrain: TerrainParams) -> Mapping[str, Any]:
    """Size, density and slope of a sample, and the terrain of its reference."""
    cloud = read_point_cloud(here.file())
    truth, _, rows = _labelled(cloud)
    places = (cloud.x, cloud.y, cloud.z)
    measured = measure(*_some(places, rows), cloud.last[rows])
    dtm = _write_terrain(places, rows, truth[rows] == 1, np.zeros(len(rows), bool), terrain, here.directory)
    rise = np.hypot(*np.gradient(dtm.astype(np.float64), terrain.cell))
    known = np.isfinite(rise)
    return {
        "points": len(rows),
        "ground": float((truth == 1).sum() / (truth >= 0).sum()),
        "density": float(measured.density),
        "relief": float(np.nanmax(dtm) - np.nanmin(dtm)),
        "slope": float(rise[known].mean()) if known.any() else 0.0,
    }


def _labelled(cloud: PointCloud) -> tuple[NDArray[np.int8], NDArray[np.bool_], NDArray[np.int64]]:
    """Truth of all points, which a filter may see, and the rows of these; `InputError` without labels of both kinds."""
    shown = cloud.usable & ~cloud.flagged
    truth = truth_of(cloud.classes, shown)
    if not ((truth == 1).any() and (truth == 0).any()):
        raise InputError(
            "a sample has no labels to judge a filter by",
            where=cloud.path,
            expected="class 2 on ground and other classes elsewhere, or a text with labels 0 (ground) and 1",
            got=f"{int((truth == 1).sum()):,} ground and {int((truth == 0).sum()):,} other points",
            do="leave it out of survey.sources",
        )
    return truth, shown, np.flatnonzero(shown)


def _some(places: Points, rows: NDArray[np.int64]) -> Points:
    x, y, z = places
    return x[rows], y[rows], z[rows]


def _write_terrain(
    places: Points,
    rows: NDArray[np.int64],
    ground: NDArray[np.bool_],
    noise: NDArray[np.bool_],
    params: TerrainParams,
    directory: Path,
) -> NDArray[np.float32]:
    """Write the terrain of some flags; its heights."""
    surface, window = terrain_by_blocks(*_some(places, rows), ground, noise, params)
    place = {"cell": window.cell, "col": window.col, "row": window.row, "ncols": window.ncols, "nrows": window.nrows}
    write_arrays(directory / TERRAIN, {"dtm": surface.dtm}, place)
    return surface.dtm


def terrain_of(inputs: PartInputs, stage: str, part: str) -> tuple[NDArray[np.float32], Window]:
    """The terrain that a part wrote, and where it lies."""
    arrays, place = inputs.arrays(stage, part, TERRAIN)
    return arrays["dtm"], Window(**place)
