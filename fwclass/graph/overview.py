"""Stages that thin the echoes for a first look: squares of a fixed lattice, each with its own, and the whole survey."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from fwclass.errors import InputError
from fwclass.formats.crs import crs_of_wkt
from fwclass.graph.outputs import NO_BYTE, class_names, columns_of_tiles, repeated_argument, repeated_columns
from fwclass.graph.sites import WHOLE
from fwclass.graph.stage import Names, Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
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
    return _lowest(here, here.present, _tile_rows(here, here.tile.box), most)


Read = Callable[[str, Mapping[str, str]], Table]
"""Some columns, by the stages that wrote them, of one of several tables."""


def _tile_rows(here: StageInputs, box: Box | None) -> Read:
    return lambda tile, columns: here.inputs.rows(tile, columns, box)


def _lowest(here: StageInputs, keys: Sequence[str], read: Read, most: int) -> Table:
    """The `most` echoes of all tables with the lowest hashes, in canonical order. Who the echoes are is read first, so
    that no others are held but one table's."""
    who = dict.fromkeys(IDENTITY, "tile")
    lowest = np.zeros(0, np.uint64)
    for key in keys:
        lowest = np.concatenate([lowest, echo_hashes(read(key, who))])
        if len(lowest) > most:
            lowest = np.partition(lowest, most - 1)[:most]
    bound, tables = lowest.max(initial=0), [dict(Table.empty(here.columns))]
    tables += (dict(_below(read(key, here.columns).select(here.columns), bound)) for key in keys)
    order = np.argsort(canonical_key(Table.concat(Table({n: t[n] for n in IDENTITY}) for t in tables)), kind="stable")
    return Table({n: np.concatenate([t.pop(n) for t in tables])[order] for n in here.columns})


def _below(table: Table, bound: np.uint64) -> Table:
    """Its echoes with hashes up to `bound`."""
    return table.take(echo_hashes(table) <= bound)


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
    if here.present:
        table = _lowest(here, here.present, _tile_rows(here, None), most)
    else:
        table = _lowest(here, here.parts(DRAW_OVERVIEW.name), _square_rows(here), most)
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


def _square_rows(here: StageInputs) -> Read:
    return lambda square, columns: here.inputs.table(DRAW_OVERVIEW.name, square, columns)


def square_path(key: str) -> str:
    """Where the overview of a square lies in the delivery."""
    return f"{SQUARES}/{key}.copc.laz"


def overviews_of(bounds: Sequence[float], square: float, drawn: Mapping[str, int]) -> list[str]:
    """Overviews of the squares in which a tile's echoes lie, `bounds` (xmin, ymin, zmin, xmax, ymax, zmax [m]): paths
    beside the list of tiles. `drawn`: echoes of each overview that there is."""
    box = Box(bounds[0], bounds[1], bounds[3] + QUANTUM, bounds[4] + QUANTUM)
    keys = TileGrid(square).keys_touching(box)
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
    place="deliver",
)
