"""Stages that thin the echoes for a first look: squares of a fixed lattice, each with its own, and the whole survey."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from fwclass.errors import InputError
from fwclass.graph.outputs import (
    NO_BYTE,
    class_names,
    columns_of_tiles,
    crs_of_wkt,
    repeated_argument,
    repeated_columns,
)
from fwclass.graph.sites import WHOLE
from fwclass.graph.stage import Names, Plan, Result, Stage, StageInputs
from fwclass.grid import Box, Tile, TileGrid
from fwclass.publish.copc import copc_columns, write_tile_copc
from fwclass.publish.laz import NEEDED, without
from fwclass.publish.octree import echo_hashes
from fwclass.publish.params import PublishParams
from fwclass.publish.qgis_layers import OVERVIEW
from fwclass.schema import IDENTITY, Table, canonical_key
from fwclass.survey.layout import Layout
from fwclass.units import QUANTUM

SQUARES = "laz/overviews"
OF_FIELDS = ("intensity", "gps_time")
"""Columns of a tile that are fields of its point format, beside those it cannot be without."""


def draw_overview(here: StageInputs, most: int) -> Result:
    """Of the echoes of one square the `most` whose hash is lowest, in canonical order."""
    return _lowest(_tiles_within(here, here.tile.box, most), most, here.columns)


def _tiles_within(here: StageInputs, box: Box | None, most: int) -> Iterator[Table]:
    """Tile by tile the echoes in `box` (None: all) that may still be among the `most` lowest."""
    bound = np.iinfo(np.uint64).max
    who = dict.fromkeys(IDENTITY, "tile")
    seen = np.zeros(0, np.uint64)
    for tile in here.present:
        hashes = echo_hashes(here.inputs.rows(tile, who, box))
        rows = np.flatnonzero(hashes <= bound)
        seen = np.concatenate([seen, hashes[rows]])
        if len(seen) > most:
            seen = np.partition(seen, most - 1)[:most]
            bound = seen[-1]
        rows = rows[hashes[rows] <= bound]
        if len(rows):
            yield here.inputs.rows(tile, here.columns, box).select(here.columns).take(rows)


def _lowest(tables: Iterable[Table], most: int, columns: Iterable[str]) -> Table:
    """The `most` echoes of all `tables` with the lowest hashes, in canonical order; twice as many are held at most,
    and one of the tables."""
    kept = Table.empty(columns)
    waiting: list[Table] = []
    for table in tables:
        waiting.append(table)
        if sum(t.rows for t in waiting) > most:
            kept, waiting = _thinned(Table.concat([kept, *waiting]), most), []
    kept = _thinned(Table.concat([kept, *waiting]), most)
    return kept.take(np.argsort(canonical_key(kept), kind="stable"))


def _thinned(table: Table, most: int) -> Table:
    if table.rows <= most:
        return table
    return table.take(np.argpartition(echo_hashes(table), most - 1)[:most])


def deliver_overview(
    here: StageInputs,
    params: PublishParams,
    most: int,
    crs: str | None,
    standard_time: bool,
    calibrated: bool,
    names: Mapping[str, str],
) -> Result:
    """A fair sample of all echoes, or of those of one square, as COPC; drawn by the hash that the tiles' levels are
    drawn by. Drawn square by square, or of all tiles where no square is drawn by itself."""
    drawn = (here.inputs.table(DRAW_OVERVIEW.name, key, here.columns) for key in here.parts(DRAW_OVERVIEW.name))
    table = _lowest(_tiles_within(here, None, most) if here.present else drawn, most, here.columns)
    if not table.rows:
        return {"rows": 0}
    path = here.directory / (OVERVIEW if here.part == WHOLE else square_path(here.part))
    path.parent.mkdir(parents=True)
    called = {int(code): name for code, name in names.items()}
    try:
        shown = without(table, () if calibrated else ("reflectance",))
        write_tile_copc(shown, path, crs_of_wkt(crs), params, called, standard_time=standard_time)
    except InputError:  # places further apart than the format's whole numbers reach have no common file
        return {"rows": 0}
    return {"rows": table.rows}


def square_path(key: str) -> str:
    """Where the overview of a square lies in the delivery."""
    return f"{SQUARES}/{key}.copc.laz"


def overviews_of(bounds: Sequence[float], square: float, drawn: Mapping[str, int]) -> list[str]:
    """Overviews of the squares in which a tile's echoes lie, `bounds` (xmin, ymin, zmin, xmax, ymax, zmax [m]): paths
    beside the list of tiles. `drawn`: echoes of each overview that there is."""
    box = Box(bounds[0], bounds[1], bounds[3] + QUANTUM, bounds[4] + QUANTUM)
    keys = [t.key for t in TileGrid(square).touching(box)]
    return [square_path(key).removeprefix("laz/") for key in keys if drawn.get(key)]


def squares(layout: Layout) -> tuple[Tile, ...]:
    """Squares of the fixed lattice that a tile touches."""
    grid = TileGrid(layout.config.publish.overview_square)
    return tuple(sorted({s for t in layout.tiles for s in grid.touching(t.box)}))


def _drawn_squares(plan: Plan) -> tuple[Tile, ...]:
    """Squares that are drawn by themselves: none where there is one, or one overview has all echoes."""
    every = squares(plan.layout) if plan.layout.echoes > plan.config.publish.overview_echoes else ()
    return every if len(every) > 1 else ()


def overview_parts(plan: Plan) -> Names:
    """The whole survey; its squares too, where they are several and it has more echoes than one overview."""
    return (WHOLE, *(s.key for s in _drawn_squares(plan)))


def cloud_columns(plan: Plan) -> Names:
    """Columns of a tile that its COPC has, as fields or as extra bytes."""
    repeated = repeated_columns(plan)
    columns = [c for c in columns_of_tiles(plan) if c not in repeated]
    return tuple(dict.fromkeys((*(c for c in columns if c in (*NEEDED, *OF_FIELDS)), *copc_columns(columns))))


def cloud_arguments(plan: Plan) -> dict[str, Any]:
    """What a stage that delivers echoes of all tiles gets, whatever it makes."""
    survey = plan.survey
    return {"crs": survey.crs, "standard_time": survey.standard_time, "names": class_names(plan)}


DRAW_OVERVIEW = Stage(
    "overview",
    1,
    "block",
    "echo",
    draw_overview,
    parts=_drawn_squares,
    edge=lambda plan: plan.config.publish.overview_square,
    arguments=lambda plan: {"most": plan.config.publish.overview_echoes},
    keyed=repeated_argument,
    reads=cloud_columns,
    writes=cloud_columns,
    halo=0.0,
)
DELIVER_OVERVIEW = Stage(
    "publish-overview",
    3,
    "survey",
    "echo",
    deliver_overview,
    parts=overview_parts,
    arguments=lambda plan: {
        **cloud_arguments(plan),
        "params": plan.config.publish,
        "most": plan.config.publish.overview_echoes,
        "calibrated": plan.config.radiometry.calibrates,
    },
    keyed=repeated_argument,
    silent=NO_BYTE,
    reads=cloud_columns,
    tiles=lambda plan: () if _drawn_squares(plan) else plan.layout.tiles,
    after=(DRAW_OVERVIEW.name,),
    needs=lambda plan, part: [(DRAW_OVERVIEW.name, s.key) for s in _drawn_squares(plan) if part in (WHOLE, s.key)],
    where="deliver",
)
