"""Stages of vectors: building footprints by blocks of the fixed grid, joined across them, and delivered."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.formats.wkb import polygon_wkb
from fwclass.graph.outputs import NO_BYTE, class_names, crs_of
from fwclass.graph.rasters import owned
from fwclass.graph.stage import Made, Plan, Stage, StageInputs
from fwclass.grid import Box, Tile
from fwclass.ground.stage import last_of
from fwclass.publish.geoparquet import write_shape_parquet
from fwclass.publish.gpkg import Layer, write_gpkg
from fwclass.publish.params import PublishParams
from fwclass.run.part import Name
from fwclass.schema import Table
from fwclass.store.tables import write_table
from fwclass.vectors.buildings import COLUMNS, OUTLINES, footprints
from fwclass.vectors.cells import CELL_COLUMNS, MARGIN, by_piece, counted, joined, pieces, roofs
from fwclass.vectors.density import cell_of, median_density, pulses_by_square
from fwclass.vectors.params import VectorParams
from fwclass.vectors.shapes import CORNERS, Shapes

CELL = "vector-cell"
ROWS, RINGS, BEYOND = "buildings.parquet", "corners.parquet", "beyond.parquet"
"""Of a block: buildings that lie in it, their corners, and cells of buildings that reach its edge."""

VECTORS = "vectors.gpkg"
UNITS = {"height": "m", "height_median": "m", "area": "m2"}


def counted_pulses(here: StageInputs, square: float) -> Made:
    """How many squares of a block hold how many pulses."""
    window = owned(here.tile, square)
    table = here.inputs.inside(window.box, here.tile_size, here.columns, here.present)
    table = table.take(last_of(table))
    return {"squares": {str(n): k for n, k in pulses_by_square(table["x"], table["y"], window).items()}}


def chosen_cell(here: StageInputs, params: VectorParams) -> Made:
    """The density of the survey's pulses, and the cell that vectors are made in."""
    squares: Counter[int] = Counter()
    for block in here.parts(COUNT_PULSES.name):
        squares.update({int(n): k for n, k in here.inputs.meta(COUNT_PULSES.name, block)["squares"].items()})
    density = median_density(squares, params.square)
    return {"density": density, "cell": cell_of(density, params), "sparse": density < params.sparse}


def building_block(here: StageInputs, params: VectorParams) -> Made:
    """The buildings that lie in one block, and the cells of those that may go on beyond its edge."""
    cell = here.inputs.meta(CELL, "all")["cell"]
    core = owned(here.tile, cell)
    window = core.grown(MARGIN)
    table = here.inputs.inside(window.box, here.tile_size, here.columns, here.present)
    counts = counted(table, window, params.buildings.codes, params.buildings.low)
    inner = core.within(window)
    whole, beyond = pieces(roofs(counts)[inner], counts.within(inner), core)
    made = footprints(by_piece(whole), cell, params.buildings)
    for name, rows in ((ROWS, made.rows), (RINGS, made.corners), (BEYOND, beyond)):
        write_table(here.directory / name, rows)
    return {"buildings": made.rows.rows, "beyond": beyond.rows}


def delivered_vectors(here: StageInputs, params: VectorParams, publish: PublishParams, crs: str | None) -> Made:
    """All buildings as GeoParquet and GeoPackage; those that cross blocks are put together first."""
    about, cell = here.inputs.meta(CELL, "all"), here.inputs.meta(CELL, "all")["cell"]
    parts, beyond = [], [Table.empty(CELL_COLUMNS)]
    for block in here.parts(FIND_BUILDINGS.name):
        rows = here.inputs.table(FIND_BUILDINGS.name, block, COLUMNS, ROWS)
        parts.append(Shapes(rows, here.inputs.table(FIND_BUILDINGS.name, block, CORNERS, RINGS)))
        beyond.append(here.inputs.table(FIND_BUILDINGS.name, block, CELL_COLUMNS, BEYOND))
    across = footprints(by_piece(joined(Table.concat(beyond))), cell, params.buildings)
    made = Shapes.together([*parts, across])
    made = made.ordered(np.lexsort((made.rows["cell_column"], made.rows["cell_row"])))
    fields, geometry = building_fields(made.rows), [polygon_wkb(p) for p in made.polygons()]
    path = here.directory / "vectors" / "buildings.parquet"
    write_shape_parquet(fields, geometry, _bounds(made), path, crs_of(crs), publish, units=UNITS)
    write_gpkg([Layer("buildings", geometry, fields)], here.directory / VECTORS, crs_of(crs))
    outlines = {OUTLINES[k]: int((made.rows["outline"] == k).sum()) for k in OUTLINES}
    return {"buildings": made.rows.rows, "across_blocks": across.rows.rows, "outlines": outlines, **about}


def building_fields(rows: Table) -> dict[str, Any]:
    """The delivered fields of buildings; `id` follows from the place of the first cell."""
    places = zip(rows["cell_column"].tolist(), rows["cell_row"].tolist(), strict=True)
    return {
        "id": [f"{column}_{row}" for column, row in places],
        "height": np.round(rows["object_height"].astype(np.float64), 2),
        "height_median": np.round(rows["median_height"].astype(np.float64), 2),
        "area": np.round(rows["object_area"].astype(np.float64), 2),
        "confidence": np.round(rows["confidence"].astype(np.float64), 4),
        "echoes": rows["object_echoes"].astype(np.int64),
        "outline": [OUTLINES[k] for k in rows["outline"].tolist()],
    }


def _bounds(shapes: Shapes) -> NDArray[np.float64]:
    """xmin, ymin, xmax, ymax of every object [m]."""
    out = np.empty((shapes.rows.rows, 4))
    for k, polygon in enumerate(shapes.polygons()):
        out[k, :2], out[k, 2:] = polygon[0].min(axis=0), polygon[0].max(axis=0)
    return out


def makes_vectors(plan: Plan) -> bool:
    """A run delivers vectors: they are asked for, and there is a class that they are made of."""
    return plan.config.vectors.write and not lacking(plan)


def lacking(plan: Plan) -> str:
    """What a user should know of a survey without buildings; nothing of others."""
    codes = plan.config.vectors.buildings.codes
    if not plan.config.vectors.write or any(str(code) in class_names(plan) for code in codes):
        return ""
    wanted = ", ".join(map(str, codes))
    return f"note: no vectors are made: the survey has no class of code {wanted} (vectors.buildings.codes)"


def vector_remarks(made: Mapping[str, Any]) -> list[str]:
    """What a user should know of delivered vectors, by the facts of their part."""
    if not made["sparse"]:
        return []
    return [
        f"{made['density']:.2g} pulses per m² are few for footprints: their outlines, of cells of {made['cell']:g} m, "
        "are rough, and small buildings are missing"
    ]


def _blocks(plan: Plan) -> tuple[Tile, ...]:
    return plan.layout.blocks(plan.config.terrain.block)


def _of_blocks(stage: str) -> Any:
    def needs(plan: Plan, part: object) -> Iterator[Name]:
        return ((stage, block.key) for block in _blocks(plan))

    return needs


def _largest_cells(plan: Plan, block: Tile) -> Box:
    """What a block owns, and the smaller cells too."""
    return owned(block, plan.config.vectors.cells[-1]).box.grown(plan.config.vectors.cells[-1])


def _given(plan: Plan) -> Mapping[str, Any]:
    return {"params": plan.config.vectors}


COUNT_PULSES = Stage(
    "pulse-density",
    1,
    "block",
    "echo",
    counted_pulses,
    when=makes_vectors,
    parts=_blocks,
    edge=lambda plan: plan.config.terrain.block,
    arguments=lambda plan: {"square": plan.config.vectors.square},
    reads=("echo_number", "number_of_echoes"),
    halo=0.0,
    area=lambda plan, block: owned(block, plan.config.vectors.square).box,
)
CHOOSE_CELL = Stage(
    CELL,
    1,
    "survey",
    "part",
    chosen_cell,
    when=makes_vectors,
    arguments=_given,
    after=(COUNT_PULSES.name,),
    needs=_of_blocks(COUNT_PULSES.name),
)
FIND_BUILDINGS = Stage(
    "buildings",
    1,
    "block",
    "echo",
    building_block,
    when=makes_vectors,
    parts=_blocks,
    edge=lambda plan: plan.config.terrain.block,
    arguments=_given,
    reads=("classification", "confidence", "height_above_ground"),
    halo=lambda plan: MARGIN * plan.config.vectors.cells[-1],
    area=_largest_cells,
    after=(CELL,),
    needs=lambda plan, part: [(CELL, "all")],
)
DELIVER_VECTORS = Stage(
    "publish-vectors",
    1,
    "survey",
    "part",
    delivered_vectors,
    when=makes_vectors,
    arguments=lambda plan: {"params": plan.config.vectors, "publish": plan.config.publish, "crs": plan.survey.crs},
    silent=NO_BYTE,
    after=(CELL, FIND_BUILDINGS.name),
    needs=lambda plan, part: [(CELL, "all"), *_of_blocks(FIND_BUILDINGS.name)(plan, part)],
    where="deliver",
)
