"""Stages of standing water: its polygons, the ground along its shores, and its levels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import first_few
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.grid import Box, Window, joint_box, millimetres
from fwclass.ground.stage import TERRAIN
from fwclass.label.polygons import Polygons, owners
from fwclass.neighbours import Points
from fwclass.run.part import Name
from fwclass.store.arrays import write_arrays
from fwclass.survey.shape_files import read_as, read_shapes, source_of
from fwclass.water.level import Body, level_of
from fwclass.water.params import WaterParams
from fwclass.water.shore import Shoreline, check_bodies, nearest_shore, shoreline

WATER, SHORE, LEVELS = "water", "shore", "water-levels"
FILE = "water"
NAMED = 5
"""Bodies of water that are named."""

STANDING, WORTH = 2, 100
"""m above the level from which an echo stands on something, and echoes of a body from which their share is told."""


def bodies_at(polygons: Polygons, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.int64]:
    """Number of the one polygon that each point [m] lies in; -1 in none, and where two overlap."""
    out = np.full(len(x), -1)
    if not len(x):
        return out
    mx, my = millimetres(x), millimetres(y)
    low_x, low_y, high_x, high_y = polygons.bounds
    near = (low_x <= mx.max()) & (high_x >= mx.min()) & (low_y <= my.max()) & (high_y >= my.min())
    chosen = np.flatnonzero(near)
    _, body = owners(mx, my, replace(polygons.take(chosen), group=np.arange(len(chosen)).astype(np.int16)))
    out[body >= 0] = chosen[body[body >= 0]]
    return out


@dataclass(frozen=True)
class Water:
    """Bodies of water that are flattened: their polygons, the level of each [m], and places along their shores."""

    polygons: Polygons
    level: NDArray[np.float64]
    knots: Points

    def levels(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Level [m] of the water that each point [m] lies in; NaN in none, and where two overlap."""
        out, body = np.full(len(x), np.nan), bodies_at(self.polygons, x, y)
        out[body >= 0] = self.level[body[body >= 0]]
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


def near_echoes(plan: Plan) -> tuple[float, float, float, float]:
    """xmin, ymin, xmax, ymax [m] of all that blocks of the terrain read, also where `fwclass seams` shifts them, and
    shores: the same whatever the tiles."""
    edge, terrain = plan.config.terrain.block, plan.config.terrain
    box = joint_box(block.box for block in plan.layout.blocks(edge))
    return box.grown(edge + TERRAIN.halo(terrain) + plan.config.water.shore).bounds


def read_water(
    here: StageInputs,
    crs: str | None,
    layer: str,
    own_crs: str | None,
    step: float,
    stretch: float,
    near: tuple[float, float, float, float],
) -> Result:
    """Polygons of water in whole millimetres of the survey's system, and places every `step` [m] along their shores in
    the box `near` [m]."""
    path = here.file()
    shapes = read_shapes(path, crs, layer, own_crs)
    features = np.zeros(1 + int(shapes.feature.max(initial=0)), np.int16)
    polygons = Polygons.of(shapes, features, features, path)
    check_bodies(polygons.parts, path)
    line = shoreline(polygons.x, polygons.y, polygons.ring_start, polygons.part_start, step, stretch, near)
    arrays = {"shore_x": line.x, "shore_y": line.y, "body": line.body, "stretch": line.stretch}
    write_arrays(here.directory / FILE, {**polygons.arrays(), **arrays, "feature": shapes.feature})
    return {"bodies": polygons.parts, "invalid": shapes.invalid}


def _line(arrays: Mapping[str, NDArray]) -> Shoreline:
    return Shoreline(arrays["shore_x"], arrays["shore_y"], arrays["body"], arrays["stretch"])


def measure_shore(here: StageInputs, reach: float) -> Result:
    """Ground echoes of a tile within `reach` [m] of a shore: which place of it is nearest, and their heights; and how
    many of those further inside lie at which height, by body; and all echoes there, by whole metres."""
    arrays = here.inputs.arrays(WATER, "all", FILE)[0]
    table = here.own_rows()
    table = table.take(np.flatnonzero(~table["noise"]))
    near, place = nearest_shore(_line(arrays), table["x"], table["y"], reach)
    body = bodies_at(Polygons.from_arrays(arrays), table["x"], table["y"])
    body[near] = -1
    at_shore, inside = table["ground"][near], np.flatnonzero((body >= 0) & table["ground"])
    cells, counts = np.unique(np.stack([body[inside], millimetres(table["z"][inside])]), axis=1, return_counts=True)
    over = np.flatnonzero(body >= 0)
    metres = np.floor(table["z"][over]).astype(np.int64)
    standing, many = np.unique(np.stack([body[over], metres]), axis=1, return_counts=True)
    heights = {"inside_body": cells[0], "inside_height": cells[1], "inside_count": counts}
    heights |= {"over_body": standing[0], "over_metre": standing[1], "over_count": many}
    write_arrays(here.directory / FILE, {"place": place[at_shore], "z": table["z"][near[at_shore]], **heights})
    return {"echoes": int(at_shore.sum()), "inside": len(inside)}


def level_water(here: StageInputs, params: WaterParams) -> Result:
    """The level of every body of water, those that are level with their shores, and what a user should know."""
    arrays = here.inputs.arrays(WATER, "all", FILE)[0]
    tiles = [here.inputs.arrays(SHORE, key, FILE)[0] for key in here.parts(SHORE)]
    place, z, own, heights, counts, over, metre, many = (
        np.concatenate([t[n] for t in tiles])
        for n in ("place", "z", "inside_body", "inside_height", "inside_count", "over_body", "over_metre", "over_count")
    )
    line, polygons = _line(arrays), Polygons.from_arrays(arrays)
    at_shore, inside = (_rows_of(body, polygons.parts) for body in (line.body[place], own))
    bodies = [
        level_of(line.stretch[place[r]], z[r], heights[k], counts[k], params)
        for r, k in zip(at_shore, inside, strict=True)
    ]
    flat = np.array([b.level_enough for b in bodies], bool)
    level = np.array([np.nan if b.level is None else b.level for b in bodies])
    shore = flat[line.body]
    flat_bodies = {
        **polygons.take(flat).arrays(),
        "level": level[flat],
        "knot_x": line.x[shore],
        "knot_y": line.y[shore],
        "knot_z": level[line.body[shore]],
    }
    write_arrays(here.directory / FILE, flat_bodies)
    facts = [{"feature": int(f) + 1, **b.facts()} for f, b in zip(arrays["feature"], bodies, strict=True)]
    high = _share_high(over, metre, many, level)
    return {"bodies": facts, "remarks": [*_remarks(facts, bodies, params), *_of_high(facts, high)]}


def _share_high(
    body: NDArray[np.int64], metre: NDArray[np.int64], count: NDArray[np.int64], level: NDArray[np.float64]
) -> NDArray[np.float64]:
    """float64 (bodies,): share of the echoes in each body, away from its shore, that lie more than `STANDING` above its
    `level` [m]; 0 where fewer than `WORTH` lie there."""
    high = metre >= np.floor(level[body]) + STANDING
    above, all_of = (np.bincount(body, count * some, len(level)) for some in (high, 1))
    return np.where(all_of >= WORTH, above / np.maximum(all_of, 1), 0.0)


def _of_high(facts: Sequence[Mapping[str, Any]], high: NDArray[np.float64]) -> list[str]:
    """Bodies in which most echoes stand high above the water."""
    some = [f"feature {t['feature']} {100 * share:.0f} %" for t, share in zip(facts, high, strict=True) if share > 0.5]
    if not some:
        return []
    return [
        f"in {len(some)} of {len(facts)} polygons of water most echoes lie {STANDING} m and more above the level, as "
        f"on roofs, trees or a bridge ({first_few(some, NAMED)}): are the polygons in their place?"
    ]


def _rows_of(body: NDArray[np.int64], bodies: int) -> list[NDArray[np.int64]]:
    """The rows of each body."""
    order = np.argsort(body, kind="stable")
    first = np.searchsorted(body[order], np.arange(bodies + 1))
    return [order[a:b] for a, b in zip(first[:-1], first[1:], strict=True)]


def _remarks(facts: Sequence[Mapping[str, Any]], bodies: Sequence[Body], params: WaterParams) -> list[str]:
    """Bodies that are not flattened, and why."""
    lines, all_of = [], f"of {len(facts)} polygons of water"
    pairs = list(zip(facts, bodies, strict=True))
    sloping = [t for t, b in pairs if b.lowest is not None and t["highest"] - t["lowest"] > params.most_spread]
    if sloping:
        some = first_few(
            [f"feature {t['feature']} {t['lowest']:.2f} to {t['highest']:.2f} m" for t in sloping], NAMED, "; "
        )
        lines.append(
            f"{len(sloping)} {all_of} are not flattened: the level differs by more than "
            f"water.most_spread ({params.most_spread:g} m) from place to place, as of a river: {some}. Cut them into "
            "reaches, or allow more"
        )
    apart = [
        t
        for t, b in pairs
        if b.shore_level is not None
        and b.inside_level is not None
        and t not in sloping
        and abs(b.inside_level - b.shore_level) > params.most_spread
    ]
    for kept, does in ((True, "the level is that of the echoes in them"), (False, "they are not flattened")):
        some_of = [t for t in apart if t["level_enough"] == kept]
        if some_of:
            words = [f"feature {t['feature']} {t['inside_level']:.2f}, shore {t['shore_level']:.2f} m" for t in some_of]
            lines.append(
                f"{len(some_of)} {all_of}: ground echoes in them lie {'below' if kept else 'above'} the shore by more "
                f"than water.most_spread ({params.most_spread:g} m), {does}: {first_few(words, NAMED, '; ')}. "
                "Are the polygons in their place?"
            )
    few = [str(t["feature"]) for t, b in pairs if b.level is None]
    if few:
        lines.append(
            f"{len(few)} {all_of} are not flattened: fewer than {params.least} ground echoes lie in them or within "
            f"{params.shore:g} m of their shores (features {first_few(few, NAMED)})"
        )
    return lines


def _is_wanted(plan: Plan) -> bool:
    return plan.config.water.file is not None


def levels_needed(plan: Plan) -> list[Name]:
    """The part that holds the survey's water, for a stage that flattens it."""
    return [(LEVELS, "all")] if _is_wanted(plan) else []


READ_WATER = Stage(
    WATER,
    1,
    "survey",
    "part",
    read_water,
    when=_is_wanted,
    arguments=lambda plan: {
        **read_as(plan.survey.water, plan.survey.crs),
        "step": plan.config.terrain.thin,
        "stretch": plan.config.water.stretch,
        "near": near_echoes(plan),
    },
    source=lambda plan, part: source_of(plan.survey.water),
)
MEASURE_SHORE = Stage(
    SHORE,
    2,
    "tile",
    "echo",
    measure_shore,
    when=_is_wanted,
    arguments=lambda plan: {"reach": plan.config.water.shore},
    own=("x", "y", "z", "ground", "noise"),
    after=(WATER,),
    needs=lambda plan, tile: [(WATER, "all")],
)
LEVEL_WATER = Stage(
    LEVELS,
    2,
    "survey",
    "part",
    level_water,
    when=_is_wanted,
    arguments=lambda plan: {"params": plan.config.water},
    silent=frozenset({"file", "layer", "crs", "shore", "stretch"}),  # what is read tells them
    after=(WATER, SHORE),
    needs=lambda plan, part: [(WATER, "all"), *((SHORE, t.key) for t in plan.layout.tiles)],
)
