"""Building footprints from cells: outline, height, confidence."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from fwclass.schema import Table
from fwclass.vectors.cells import EIGHT
from fwclass.vectors.outline import Cells, Ring, area, corners, cover, fill_holes, mask_of, rings, simplify, sound
from fwclass.vectors.params import FootprintParams
from fwclass.vectors.regular import direction, middles, right_angled
from fwclass.vectors.shapes import Shapes

RIGHT_ANGLED, SIMPLIFIED, OF_CELLS = 1, 2, 3
OUTLINES = {RIGHT_ANGLED: "right-angled", SIMPLIFIED: "simplified", OF_CELLS: "cells"}
"""What an outline is."""

COLUMNS = (
    *("cell_row", "cell_column"),
    *("object_height", "median_height", "object_area", "confidence", "object_echoes", "outline"),
)


def footprints(pieces: Iterable[Table], cell: float, params: FootprintParams) -> Shapes:
    """The buildings among pieces of cells; what is too small or too low is none.

    Parameters
    ----------
    pieces : cells of each (`cells.pieces`), at least one.
    cell : their edge [m].

    Returns
    -------
    `COLUMNS` of every building, by row and column of its first cell, and its polygon [m].
    """
    rows, polygons = [], []
    for piece in pieces:
        height, middle = _heights(piece["cell_top"], params.height_share)
        if piece.rows * cell**2 < params.least_area or not height >= params.least_height:
            continue
        polygon, kind = _polygon(piece, cell, params)
        size = sum(area(ring) for ring in polygon) * cell**2
        first = int(np.lexsort((piece["cell_column"], piece["cell_row"]))[0])
        rated = int(piece["cell_rated"].sum())
        sure = 0.01 * int(piece["cell_percent"].sum()) / rated if rated else math.nan
        place = int(piece["cell_row"][first]), int(piece["cell_column"][first])
        rows.append((*place, height, middle, size, sure, int(piece["cell_echoes"].sum()), kind))
        polygons.append([cell * ring for ring in polygon])
    if not rows:
        return Shapes.of(Table.empty(COLUMNS), [])
    table = Table({name: np.array(v) for name, v in zip(COLUMNS, zip(*rows, strict=True), strict=True)})
    return Shapes.of(table, polygons).ordered(np.lexsort((table["cell_column"], table["cell_row"])))


def _heights(tops: NDArray[np.float32], share: float) -> tuple[float, float]:
    """Height of a building and its median [m] by the tops of its cells; NaN where none is known."""
    known = tops[np.isfinite(tops)].astype(np.float64)
    if not len(known):
        return math.nan, math.nan
    high, middle = np.quantile(known, [share, 0.5])
    return float(high), float(middle)


def _polygon(piece: Table, cell: float, params: FootprintParams) -> tuple[list[Ring], int]:
    """Rings in columns and rows of the global raster, and what they are."""
    mask, row, col = mask_of(piece["cell_row"].astype(np.int64), piece["cell_column"].astype(np.int64))
    origin = np.array([col, row], np.float64)
    mask = fill_holes(mask, max(1, round(params.least_area / cell**2)))
    around = rings(mask)
    points = [middles(ring) for ring in around]
    plain = [ring[simplify(ring, params.tolerance)] for ring in points]
    angle = direction([ring for ring in plain if len(ring) > 1] or points)
    regular = [right_angled(ring, angle, params.tolerance, params.shortest) for ring in points]
    full = [ring for ring in regular if ring is not None]
    for polygon, kind in ((full, RIGHT_ANGLED), (plain, SIMPLIFIED)):
        if len(polygon) == len(points) and _agrees(polygon, mask, cell, params) and sound(polygon):
            return [ring + origin for ring in polygon], kind
    return [corners(ring) + origin for ring in around], OF_CELLS


def _agrees(polygon: list[Ring], mask: Cells, cell: float, params: FootprintParams) -> bool:
    """Whether the polygon covers what the cells do, by intersection over union, and nowhere ends far from them."""
    far = math.ceil(max(params.furthest / cell, 2.0 * params.tolerance))
    mask = np.pad(mask, far + 1)
    moved = [ring + (far + 1.0) for ring in polygon]
    corner = np.concatenate(moved)
    if (corner < 0.0).any() or (corner > mask.shape[::-1]).any():
        return False
    inside = cover(moved, mask.shape)
    if (inside & ~scipy.ndimage.binary_dilation(mask, EIGHT, far)).any():
        return False
    if (mask & ~scipy.ndimage.binary_dilation(inside, EIGHT, far)).any():
        return False
    return bool((inside & mask).sum() >= params.agreement * (inside | mask).sum())
