"""Stages of standing water: its polygons, the ground along its shores, and its levels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from fwclass.graph.stage import Made, Plan, Stage, StageInputs
from fwclass.grid import Box, Window, millimetres
from fwclass.label.polygons import Polygons, owners
from fwclass.read.polygons import open_polygons, read_polygons, reprojected
from fwclass.run.part import Name
from fwclass.store.arrays import write_arrays
from fwclass.water.level import Body, level_of
from fwclass.water.params import WaterParams
from fwclass.water.shore import Shoreline, nearest_shore, shoreline

WATER, SHORE, LEVELS = "water", "shore", "water-levels"
FILE = "water"
NAMED = 5
"""Bodies of water that are named."""

Points = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
"""x, y, z [m]."""


@dataclass(frozen=True)
class Water:
    """Bodies of water that are flattened: their polygons, the level of each [m], and places along their shores."""

    polygons: Polygons
    level: NDArray[np.float64]
    knots: Points

    def levels(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Level [m] of the water that each point [m] lies in; NaN in none, and where two overlap."""
        out = np.full(len(x), np.nan)
        if not len(x):
            return out
        mx, my = millimetres(x), millimetres(y)
        low_x, low_y, high_x, high_y = self.polygons.bounds
        near = (low_x <= mx.max()) & (high_x >= mx.min()) & (low_y <= my.max()) & (high_y >= my.min())
        chosen = np.flatnonzero(near)
        some = self.polygons.take(chosen)
        _, body = owners(mx, my, replace(some, group=np.arange(len(chosen)).astype(np.int16)))
        out[body >= 0] = self.level[chosen[body[body >= 0]]]
        return out

    def of_cells(self, window: Window) -> NDArray[np.float64]:
        """As `levels`, at the middles of the cells of `window`."""
        x, y = (
            (first + np.arange(n) + 0.5) * window.cell
            for first, n in ((window.col, window.ncols), (window.row, window.nrows))
        )
        wide, high = np.meshgrid(x, y)
        return self.levels(wide.ravel(), high.ravel()).reshape(window.shape)

    def knots_in(self, box: Box) -> Points:
        """Places along the shores in `box`, with the water's level."""
        rows = np.flatnonzero(box.contains(*self.knots[:2]))
        return self.knots[0][rows], self.knots[1][rows], self.knots[2][rows]


def water_of(here: StageInputs) -> Water | None:
    """The survey's water, where the stage reads any."""
    if not here.parts(LEVELS):
        return None
    arrays = here.inputs.arrays(LEVELS, "all", FILE)[0]
    return Water(Polygons.from_arrays(arrays), arrays["level"], (arrays["knot_x"], arrays["knot_y"], arrays["knot_z"]))


def water_read(
    here: StageInputs, crs: str | None, layer: str, own_crs: str | None, step: float, stretch: float
) -> Made:
    """Polygons of water in whole millimetres of the survey's system, and places every `step` [m] along their shores."""
    path = here.file()
    shapes = read_polygons(open_polygons(path, layer), None)[1]
    if own_crs is not None and crs is not None:
        shapes, _ = reprojected(shapes, CRS.from_wkt(own_crs), CRS.from_wkt(crs), path)
    features = np.zeros(1 + int(shapes.feature.max(initial=0)), np.int16)
    polygons = Polygons.of(shapes, features, features, path)
    line = shoreline(polygons.x, polygons.y, polygons.ring_start, polygons.part_start, step, stretch)
    arrays = {"shore_x": line.x, "shore_y": line.y, "body": line.body, "stretch": line.stretch}
    write_arrays(here.directory / FILE, {**polygons.arrays(), **arrays, "feature": shapes.feature})
    return {"bodies": polygons.parts, "invalid": shapes.invalid}


def _line(arrays: Mapping[str, NDArray]) -> Shoreline:
    return Shoreline(arrays["shore_x"], arrays["shore_y"], arrays["body"], arrays["stretch"])


def shore_measured(here: StageInputs, reach: float) -> Made:
    """Ground echoes of a tile within `reach` [m] of a shore: which place of it is nearest, and their heights."""
    line = _line(here.inputs.arrays(WATER, "all", FILE, ("shore_x", "shore_y", "body", "stretch"))[0])
    table = here.own_rows()
    ground = np.flatnonzero(table["ground"] & ~table["noise"])
    rows, place = nearest_shore(line, table["x"][ground], table["y"][ground], reach)
    write_arrays(here.directory / FILE, {"place": place, "z": table["z"][ground[rows]]})
    return {"echoes": len(rows)}


def water_levelled(here: StageInputs, params: WaterParams) -> Made:
    """The level of every body of water, those that are level with their shores, and what a user should know."""
    arrays = here.inputs.arrays(WATER, "all", FILE)[0]
    tiles = [here.inputs.arrays(SHORE, key, FILE)[0] for key in here.parts(SHORE)]
    place, z = (np.concatenate([t[n] for t in tiles]) for n in ("place", "z"))
    line, polygons = _line(arrays), Polygons.from_arrays(arrays)
    body = line.body[place]
    order = np.argsort(body, kind="stable")
    first = np.searchsorted(body[order], np.arange(polygons.parts + 1))
    rows = [order[a:b] for a, b in zip(first[:-1], first[1:], strict=True)]
    bodies = [level_of(line.stretch[place[r]], z[r], params) for r in rows]
    flat = np.array([b.level_enough for b in bodies], bool)
    level = np.array([np.nan if b.level is None else b.level for b in bodies])
    shore = flat[line.body]
    made = {
        **polygons.take(flat).arrays(),
        "level": level[flat],
        "knot_x": line.x[shore],
        "knot_y": line.y[shore],
        "knot_z": level[line.body[shore]],
    }
    write_arrays(here.directory / FILE, made)
    told = [{"feature": int(f) + 1, **b.facts()} for f, b in zip(arrays["feature"], bodies, strict=True)]
    return {"bodies": told, "remarks": _remarks(told, bodies, params)}


def _remarks(told: Sequence[Mapping[str, Any]], bodies: Sequence[Body], params: WaterParams) -> list[str]:
    """Bodies that are not flattened, and why."""
    lines = []
    sloping = [t for t, b in zip(told, bodies, strict=True) if b.level is not None and not b.level_enough]
    if sloping:
        some = "; ".join(f"feature {t['feature']} {t['lowest']:.2f} to {t['highest']:.2f} m" for t in sloping[:NAMED])
        more = f" and {len(sloping) - NAMED} more" if len(sloping) > NAMED else ""
        lines.append(
            f"{len(sloping)} of {len(told)} polygons of water are not flattened: the level along their shores differs "
            f"by more than water.most_spread ({params.most_spread:g} m), as of a river: {some}{more}. Cut them into "
            "reaches, or allow more"
        )
    few = [str(t["feature"]) for t, b in zip(told, bodies, strict=True) if b.level is None]
    if few:
        some = ", ".join(few[:NAMED]) + (f" and {len(few) - NAMED} more" if len(few) > NAMED else "")
        lines.append(
            f"{len(few)} of {len(told)} polygons of water are not flattened: fewer than {params.least} ground echoes "
            f"lie within {params.shore:g} m of their shores (features {some})"
        )
    return lines


def _wanted(plan: Plan) -> bool:
    return plan.config.water.file is not None


def levels_needed(plan: Plan) -> list[Name]:
    """The part that holds the survey's water, for a stage that flattens it."""
    return [(LEVELS, "all")] if _wanted(plan) else []


READ_WATER = Stage(
    WATER,
    1,
    "survey",
    "part",
    water_read,
    when=_wanted,
    arguments=lambda plan: {
        "crs": plan.survey.crs,
        "layer": plan.survey.water.layer if plan.survey.water else "",
        "own_crs": plan.survey.water.crs if plan.survey.water else None,
        "step": plan.config.terrain.thin,
        "stretch": plan.config.water.stretch,
    },
    source=lambda plan, part: (plan.survey.water.path, plan.survey.water.digests) if plan.survey.water else None,
)
MEASURE_SHORE = Stage(
    SHORE,
    1,
    "tile",
    "echo",
    shore_measured,
    when=_wanted,
    arguments=lambda plan: {"reach": plan.config.water.shore},
    own=("x", "y", "z", "ground", "noise"),
    after=(WATER,),
    needs=lambda plan, tile: [(WATER, "all")],
)
LEVEL_WATER = Stage(
    LEVELS,
    1,
    "survey",
    "part",
    water_levelled,
    when=_wanted,
    arguments=lambda plan: {"params": plan.config.water},
    silent=frozenset({"file", "layer", "crs", "shore", "stretch"}),  # what is read tells them
    after=(WATER, SHORE),
    needs=lambda plan, part: [(WATER, "all"), *((SHORE, t.key) for t in plan.layout.tiles)],
)
