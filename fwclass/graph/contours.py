"""Stages of the contour lines: pieces by blocks of the terrain, and the lines that they join to."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.contours.join import ContourLines, LinePieces, join_lines
from fwclass.contours.lines import lines
from fwclass.contours.params import ContourParams
from fwclass.contours.smooth import margin, smooth_terrain
from fwclass.errors import first_few
from fwclass.formats.crs import crs_of_wkt
from fwclass.graph.ground import terrain_blocks
from fwclass.graph.rasters import Mosaic
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.grid import Tile, TileGrid, Window
from fwclass.ground.stage import TERRAIN
from fwclass.publish.contour_file import Contours, write_contours
from fwclass.publish.contour_style import contour_style
from fwclass.publish.files import written_whole
from fwclass.publish.qgis_layers import CONTOURS
from fwclass.publish.qgis_style import style_file
from fwclass.run.part import Name
from fwclass.store.arrays import write_arrays
from fwclass.temporary import array_in_file

PIECES = "pieces"

NAMED = 3
"""Blocks that are named."""

BATCH = 1 << 20
"""Vertices of lines that are written at once."""


def contour_block(
    here: StageInputs, params: ContourParams, cell: float, inside: tuple[int, int, int, int] | None = None
) -> Result:
    """Pieces of the contour lines of one block, whose squares have their south-western corner in it, and all corners
    `inside` the survey: their first column and row in the block, and how many of either; None for all."""
    nodes = _corners(here.tile, cell)
    if inside is not None:
        nodes = Window(cell, nodes.col + inside[0], nodes.row + inside[1], *inside[2:])
    grid = TileGrid(here.tile.size)
    mosaic = Mosaic(
        here.inputs, TERRAIN.name, [grid.tile(k) for k in here.parts(TERRAIN.name)], cell, {"dtm": np.float32(np.nan)}
    )
    dtm = mosaic.laid(nodes.grown(margin(params, cell)))["dtm"]
    drawn = lines(smooth_terrain(dtm, cell, params), nodes, params.steps, params.index)
    pieces = LinePieces.of(drawn)
    arrays = {"ends": pieces.ends, "measures": pieces.measures, "vertices": drawn.vertices}
    write_arrays(here.directory / PIECES, arrays)
    return {"pieces": len(pieces.ends), "vertices": len(drawn.vertices), "every": drawn.every}


def _corners(block: Tile, cell: float) -> Window:
    """The middles of cells that are corners of a block's squares."""
    own = Window.covering(block.box, cell)
    return Window(cell, own.col, own.row, own.ncols + 1, own.nrows + 1)


def deliver_contours(here: StageInputs, params: ContourParams, crs: str | None) -> Result:
    """All contour lines as a GeoPackage, with a style beside it. Only where pieces begin and end is held of all of
    them; vertices are laid into a file that has no name, block by block, and written line by line."""
    blocks = here.parts(CONTOUR_BLOCKS.name)
    tables = [here.inputs.arrays(CONTOUR_BLOCKS.name, key, PIECES, ("ends", "measures"))[0] for key in blocks]
    pieces = LinePieces(*(np.concatenate([t[name] for t in tables]) for name in ("ends", "measures")))
    sizes, lines = [len(t["ends"]) for t in tables], join_lines(pieces)
    del tables
    long_enough = lines.length >= params.shortest
    written, places = _places(pieces, lines, long_enough)
    counts = (
        np.add.reduceat(written[lines.order], lines.first[:-1])[long_enough]
        if len(long_enough)
        else np.zeros(0, np.int64)
    )
    with tempfile.TemporaryFile(dir=here.directory) as file:
        laid = array_in_file(file, np.float64, (int(counts.sum()), 2))
        row = 0
        for key, size in zip(blocks, sizes, strict=True):
            mine = slice(row, row + size)
            row += size
            vertices = here.inputs.arrays(CONTOUR_BLOCKS.name, key, PIECES, ("vertices",))[0]["vertices"]
            last = np.cumsum(pieces.ends[mine, 7])  # of a piece that goes on another one the first vertex is left out
            laid[_runs(places[mine], written[mine])] = vertices[_runs(last - written[mine], written[mine])]
        level, depression = lines.level[long_enough], lines.depression[long_enough]
        batches = _batches(laid, counts, level, depression, params)
        write_contours(here.directory / CONTOURS, batches, crs_of_wkt(crs))
    with written_whole(here.directory / Path(CONTOURS).with_suffix(".qml")) as beside:
        beside.write_bytes(style_file(contour_style(), "vector"))
    coarse = [k for k in blocks if here.inputs.meta(CONTOUR_BLOCKS.name, k)["every"] > 1]
    return {"lines": int(long_enough.sum()), "vertices": int(counts.sum()), "remarks": _of_coarse(coarse, params)}


def _of_coarse(blocks: Sequence[str], params: ContourParams) -> list[str]:
    """What a user should know of blocks with too many lines."""
    if not blocks:
        return []
    return [
        f"contours every {params.interval:g} m are too many in {len(blocks)} terrain blocks "
        f"({first_few(blocks, NAMED)}), as on broken "
        "land: index contours alone are drawn there, and other lines end at their edges. Choose a larger "
        "contours.interval or contours.smooth"
    ]


def _places(
    pieces: LinePieces, lines: ContourLines, long_enough: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """For every piece the vertices that are written of it, and which row the first of them gets."""
    begins = np.zeros(len(lines.order), bool)
    begins[lines.first[:-1]] = True
    there = np.repeat(long_enough, np.diff(lines.first))
    number = np.where(there, pieces.ends[lines.order, 7] - ~begins, 0)
    written, places = np.empty_like(number), np.empty_like(number)
    written[lines.order], places[lines.order] = number, np.cumsum(number) - number
    return written, places


def _runs(first: NDArray[np.int64], count: NDArray[np.int64]) -> NDArray[np.int64]:
    """``first, first + 1, …`` for `count` of each."""
    return np.repeat(first - (np.cumsum(count) - count), count) + np.arange(int(count.sum()))


def _batches(
    vertices: NDArray[np.float64],
    count: NDArray[np.int64],
    level: NDArray[np.int64],
    depression: NDArray[np.bool_],
    params: ContourParams,
) -> Iterator[Contours]:
    first = np.append(0, np.cumsum(count))
    cuts = [0]
    while cuts[-1] < len(count) or len(cuts) == 1:
        low = cuts[-1]
        high = max(low + 1, int(np.searchsorted(first, first[low] + BATCH, "right")) - 1)
        cuts.append(min(high, len(count)))
        some = slice(low, cuts[-1])
        yield Contours(
            np.array(vertices[first[low] : first[cuts[-1]]]),
            count[some],
            level[some].astype(np.float64) * params.interval,
            level[some] % params.index == 0,
            depression[some],
        )
        if cuts[-1] == len(count):
            break


def _around(plan: Plan, block: Tile) -> list[Name]:
    edge, cell = plan.config.terrain.block, plan.config.terrain.cell
    box, owned = block.box.grown((margin(plan.config.contours, cell) + 1) * cell), plan.layout.occupied[edge]
    return [
        (TERRAIN.name, b.key)
        for b in TileGrid(edge).touching(box)
        if any(key in owned for key in TileGrid(edge).keys_touching(b.box.grown(edge)))
    ]


def _inside(plan: Plan, block: Tile) -> Mapping[str, Any]:
    """Which corners of a block that the survey's edge cuts lie within; counted from the block, so that blocks along one
    edge share their parameters."""
    cell = plan.config.terrain.cell
    own = _corners(block, cell)
    part = own.common(Window.of_points(plan.layout.box, cell)) or Window(cell, own.col, own.row, 1, 1)
    if part == own:
        return {}
    return {"inside": (part.col - own.col, part.row - own.row, part.ncols, part.nrows)}


CONTOUR_BLOCKS = Stage(
    "contours",
    1,
    "block",
    "cell",
    contour_block,
    when=lambda plan: plan.config.contours.enabled,
    parts=lambda plan: terrain_blocks(plan.layout),
    edge=lambda plan: plan.config.terrain.block,
    arguments=lambda plan: {"params": plan.config.contours, "cell": plan.config.terrain.cell},
    each=_inside,
    silent=frozenset({"shortest"}),
    after=(TERRAIN.name,),
    needs=_around,
)
DELIVER_CONTOURS = Stage(
    "publish-contours",
    1,
    "survey",
    "cell",
    deliver_contours,
    when=lambda plan: plan.config.contours.enabled,
    arguments=lambda plan: {"params": plan.config.contours, "crs": plan.survey.crs},
    after=(CONTOUR_BLOCKS.name,),
    needs=lambda plan, part: [(CONTOUR_BLOCKS.name, b.key) for b in terrain_blocks(plan.layout)],
    place="deliver",
)
