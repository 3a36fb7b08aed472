"""Stages of vectors: building footprints and trees by blocks of the fixed grid, joined across them, and delivered."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.formats.crs import crs_of_wkt
from fwclass.formats.wkb import point_wkb, polygon_wkb
from fwclass.graph.ground import survey_blocks
from fwclass.graph.outputs import NO_BYTE, class_names
from fwclass.graph.rasters import owned
from fwclass.graph.stage import Names, Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.grid import Box, Tile, Window
from fwclass.ground.stage import last_of
from fwclass.publish.geoparquet import write_shape_parquet
from fwclass.publish.gpkg import Layer, write_gpkg
from fwclass.publish.params import PublishParams
from fwclass.run.part import Name
from fwclass.schema import Table
from fwclass.store.tables import write_table
from fwclass.vectors.buildings import COLUMNS as BUILDING_COLUMNS
from fwclass.vectors.buildings import OUTLINES, footprints
from fwclass.vectors.cells import (
    CELL_COLUMNS,
    MARGIN,
    by_piece,
    cell_of,
    count_cells,
    count_passage,
    join_cells,
    median_density,
    pieces,
    pulses_by_square,
    roofs,
)
from fwclass.vectors.params import VectorParams
from fwclass.vectors.shapes import CORNERS, Shapes
from fwclass.vectors.trees import COLUMNS as TREE_COLUMNS
from fwclass.vectors.trees import trees

CELL = "vector-cell"
ROWS, RINGS, BEYOND = "objects.parquet", "corners.parquet", "beyond.parquet"
"""Of a block: what lies in it, the corners of these, and cells of buildings that reach its edge."""

VECTORS = "vectors.gpkg"
UNITS = {"height": "m", "height_median": "m", "area": "m2", "crown_area": "m2"}


def count_pulses(here: StageInputs, square: float) -> Result:
    """How many squares of a block hold how many pulses."""
    window = owned(here.tile, square)
    table = here.inputs.inside(window.box, here.tile_size, here.columns, here.present)
    table = table.take(last_of(table))
    return {"squares": {str(n): k for n, k in pulses_by_square(table["x"], table["y"], window).items()}}


def choose_cell(here: StageInputs, params: VectorParams) -> Result:
    """The density of the survey's pulses, and the cell that vectors are made in."""
    squares: Counter[int] = Counter()
    for block in here.parts(COUNT_PULSES.name):
        squares.update({int(n): k for n, k in here.inputs.meta(COUNT_PULSES.name, block)["squares"].items()})
    density = median_density(squares, params.square)
    return {"density": density, "cell": cell_of(density, params), "sparse": density < params.sparse}


def find_buildings(here: StageInputs, params: VectorParams) -> Result:
    """The buildings that lie in one block, and the cells of those that may go on beyond its edge."""
    cell = here.inputs.meta(CELL, "all")["cell"]
    core = owned(here.tile, cell)
    wide = core.grown(MARGIN)
    counts = count_cells(_read_window(here, wide), wide, params.buildings.codes, params.buildings.low)
    inner = core.within(wide)
    whole, beyond = pieces(roofs(counts)[inner], counts.within(inner), core)
    shapes = footprints(by_piece(whole), cell, params.buildings)
    _write(here, shapes)
    write_table(here.directory / BEYOND, beyond)
    return {"buildings": shapes.rows.rows, "beyond": beyond.rows}


def find_trees(here: StageInputs, params: VectorParams) -> Result:
    """The trees whose tops lie in one block."""
    cell = max(here.inputs.meta(CELL, "all")["cell"], params.trees.cell)
    core = owned(here.tile, cell)
    window = core.grown(math.ceil(params.trees.halo(cell) / cell))
    table, codes = _read_window(here, window), params.trees.codes
    passage = count_passage(table, last_of(table), window, codes, params.trees.clear)
    shapes = trees(table, count_cells(table, window, codes, 0.0), passage, window, core, params.trees)
    _write(here, shapes)
    return {"trees": shapes.rows.rows}


def _read_window(here: StageInputs, window: Window) -> Table:
    """Echoes of surfaces: a bird over a wood is no tree of its height."""
    table = here.inputs.inside(window.box, here.tile_size, here.columns, here.present)
    return table.take(~table["noise"])


def _write(here: StageInputs, shapes: Shapes) -> None:
    for name, rows in ((ROWS, shapes.rows), (RINGS, shapes.corners)):
        write_table(here.directory / name, rows)


def _read(here: StageInputs, stage: Stage, columns: Names) -> list[Shapes]:
    """The objects of all declared blocks."""
    tables = here.inputs.table
    blocks = here.parts(stage.name)
    return [Shapes(tables(stage.name, b, columns, ROWS), tables(stage.name, b, CORNERS, RINGS)) for b in blocks]


def deliver_vectors(here: StageInputs, params: VectorParams, publish: PublishParams, crs: str | None) -> Result:
    """All buildings and trees as GeoParquet and GeoPackage; buildings that cross blocks are put together first."""
    facts, layers = dict(here.inputs.meta(CELL, "all")), []
    if here.parts(FIND_BUILDINGS.name):
        cells = (
            here.inputs.table(FIND_BUILDINGS.name, b, CELL_COLUMNS, BEYOND) for b in here.parts(FIND_BUILDINGS.name)
        )
        across = footprints(by_piece(join_cells(Table.concat(cells))), facts["cell"], params.buildings)
        buildings = Shapes.together([*_read(here, FIND_BUILDINGS, BUILDING_COLUMNS), across])
        buildings = buildings.ordered(np.lexsort((buildings.rows["cell_column"], buildings.rows["cell_row"])))
        layers.append((buildings, Layer("buildings", _wkb(buildings), building_fields(buildings.rows))))
        outlines = {OUTLINES[k]: int((buildings.rows["outline"] == k).sum()) for k in OUTLINES}
        facts |= {"buildings": buildings.rows.rows, "across_blocks": across.rows.rows, "outlines": outlines}
    if here.parts(FIND_TREES.name):
        crowns = Shapes.together(_read(here, FIND_TREES, TREE_COLUMNS))
        crowns = crowns.ordered(np.lexsort((crowns.rows["x"], crowns.rows["y"])))
        x, y, fields = crowns.rows["x"], crowns.rows["y"], tree_fields(crowns.rows)
        places = Shapes.of(crowns.rows, [[np.array([place])] for place in np.stack([x, y], axis=1)])
        layers.append((crowns, Layer("crowns", _wkb(crowns), fields)))
        layers.append((places, Layer("trees", point_wkb(x, y), fields, "Point")))
        facts |= {"trees": crowns.rows.rows}
    for shapes, layer in layers:
        path = here.directory / "vectors" / f"{layer.name}.parquet"
        boxes = _bounds(shapes)
        write_shape_parquet(layer.fields, layer.geometry, boxes, path, crs_of_wkt(crs), publish, layer.kind, UNITS)
    write_gpkg([layer for _, layer in layers], here.directory / VECTORS, crs_of_wkt(crs))
    return facts


def _wkb(shapes: Shapes) -> list[bytes]:
    return [polygon_wkb(polygon) for polygon in shapes.polygons()]


def building_fields(rows: Table) -> dict[str, Any]:
    """The delivered fields of buildings; `id` follows from the place of the first cell."""
    places = zip(rows["cell_column"].tolist(), rows["cell_row"].tolist(), strict=True)
    return {
        "id": [f"{column}_{row}" for column, row in places],
        "height": _round(rows["object_height"]),
        "height_median": _round(rows["median_height"]),
        "area": _round(rows["object_area"]),
        "confidence": _round(rows["confidence"], 4),
        "echoes": rows["object_echoes"].astype(np.int64),
        "outline": [OUTLINES[k] for k in rows["outline"].tolist()],
    }


def tree_fields(rows: Table) -> dict[str, Any]:
    """The delivered fields of trees; `id` follows from the place of the top, in centimetres."""
    places = np.rint(100.0 * np.stack([rows["x"], rows["y"]], axis=1)).astype(np.int64)
    return {
        "id": [f"{x}_{y}" for x, y in places.tolist()],
        "height": _round(rows["object_height"]),
        "crown_area": _round(rows["object_area"]),
        "confidence": _round(rows["confidence"], 4),
        "echoes": rows["object_echoes"].astype(np.int64),
    }


def _round(values: NDArray[np.float32], digits: int = 2) -> NDArray[np.float64]:
    return np.asarray(np.round(values.astype(np.float64), digits), np.float64)


def _bounds(shapes: Shapes) -> NDArray[np.float64]:
    """xmin, ymin, xmax, ymax of every object [m]."""
    out = np.empty((shapes.rows.rows, 4))
    for k, polygon in enumerate(shapes.polygons()):
        out[k, :2], out[k, 2:] = polygon[0].min(axis=0), polygon[0].max(axis=0)
    return out


def vector_layers(plan: Plan) -> Names:
    """The layers of a run's ``vectors.gpkg``: of what is asked for, where there is a class of it."""
    params, there = plan.config.vectors, class_names(plan)
    if not params.write:
        return ()
    buildings = any(str(code) in there for code in params.buildings.codes)
    trees = any(str(code) in there for code in params.trees.codes)
    return (*(("buildings",) if buildings else ()), *(("trees", "crowns") if trees else ()))


def lacking(plan: Plan) -> str:
    """What a user should know of vectors that a survey's classes do not give; nothing of others."""
    params, layers = plan.config.vectors, vector_layers(plan)
    codes = {"buildings": params.buildings.codes, "trees": params.trees.codes}
    return "\n".join(
        f"note: vectors have no {name}: no class has code {', '.join(map(str, some))} (vectors.{name}.codes)"
        for name, some in codes.items()
        if params.write and name not in layers
    )


def vector_remarks(facts: Mapping[str, Any]) -> list[str]:
    """What a user should know of delivered vectors, by the facts of their part."""
    if not facts["sparse"]:
        return []
    return [
        f"{facts['density']:.2g} pulses per m² are few for footprints: their outlines, of cells of {facts['cell']:g} m"
        ", are rough, and small buildings are missing"
    ]


def _of_blocks(stage: str) -> Any:
    def needs(plan: Plan, part: object) -> Iterator[Name]:
        return ((stage, block.key) for block in survey_blocks(plan))

    return needs


def _largest_cells(plan: Plan, block: Tile) -> Box:
    """What a block owns, in cells of any size."""
    return owned(block, _largest(plan)).box.grown(_largest(plan))


def _largest(plan: Plan) -> float:
    """Edge of the largest cells that there may be [m]."""
    return max(plan.config.vectors.cells[-1], plan.config.vectors.trees.cell)


def _arguments(plan: Plan) -> Mapping[str, Any]:
    return {"params": plan.config.vectors}


COUNT_PULSES = Stage(
    "pulse-density",
    1,
    "block",
    "echo",
    count_pulses,
    when=lambda plan: bool(vector_layers(plan)),
    parts=survey_blocks,
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
    choose_cell,
    when=lambda plan: bool(vector_layers(plan)),
    arguments=_arguments,
    after=(COUNT_PULSES.name,),
    needs=_of_blocks(COUNT_PULSES.name),
)
FIND_BUILDINGS = Stage(
    "buildings",
    3,
    "block",
    "echo",
    find_buildings,
    when=lambda plan: "buildings" in vector_layers(plan),
    parts=survey_blocks,
    edge=lambda plan: plan.config.terrain.block,
    arguments=_arguments,
    reads=("classification", "confidence", "height_above_ground", "noise"),
    halo=lambda plan: MARGIN * plan.config.vectors.cells[-1],
    area=_largest_cells,
    after=(CELL,),
    needs=lambda plan, part: [(CELL, "all")],
)
FIND_TREES = replace(
    FIND_BUILDINGS,
    name="tree-tops",
    version=6,
    function=find_trees,
    reads=("classification", "confidence", "height_above_ground", "noise", "echo_number", "number_of_echoes"),
    when=lambda plan: "trees" in vector_layers(plan),
    halo=lambda plan: plan.config.vectors.trees.halo(_largest(plan)) + _largest(plan),
)
DELIVER_VECTORS = Stage(
    "publish-vectors",
    1,
    "survey",
    "part",
    deliver_vectors,
    when=lambda plan: bool(vector_layers(plan)),
    arguments=lambda plan: {"params": plan.config.vectors, "publish": plan.config.publish, "crs": plan.survey.crs},
    silent=NO_BYTE,
    after=(CELL, FIND_BUILDINGS.name, FIND_TREES.name),
    needs=lambda plan, part: [
        (CELL, "all"),
        *((s.name, b.key) for s in (FIND_BUILDINGS, FIND_TREES) if s.when(plan) for b in survey_blocks(plan)),
    ],
    place="deliver",
)
