"""How much of the area that was to be flown is covered, and where its gaps are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.graph.raster_outputs import check_cells
from fwclass.graph.rasters import Mosaic, stripes
from fwclass.grid import Box, Window, millimetres
from fwclass.label.polygons import NONE, Polygons, owners
from fwclass.publish.cog import STRIPE
from fwclass.quality.voids import LISTED, CellGroups, Void
from fwclass.survey.shape_files import read_shapes

COLUMNS = 4096
"""Cells of a stripe that are asked at once where they lie, so that wide areas take no more memory."""


def read_area(path: Path, crs: str | None, layer: str, own_crs: str | None) -> Polygons:
    """Polygons of a file in the survey's system `crs` (WKT), in whole millimetres, all of one group."""
    shapes = read_shapes(path, crs, layer, own_crs)
    same = np.zeros(1 + int(shapes.feature.max(initial=0)), np.int16)
    return Polygons.of(shapes, same, same, path)


def area_coverage(counted: Mosaic, area: Polygons, least: float) -> tuple[dict[str, Any], list[Void]]:
    """Figures of the cells of `counted` whose middles lie in `area`, and its gaps from `least` [m²] on.

    A gap is a group of cells without a pulse that hang together by their sides; unlike a void it may reach the
    outside. Smaller ones are chance: the pulses' spacing leaves them anywhere.
    """
    low_x, low_y, high_x, high_y = area.bounds
    west, south, east, north = (float(v) / 1000.0 for v in (low_x.min(), low_y.min(), high_x.max(), high_y.max()))
    box = Box(west, south, east, north).grown(counted.cell)  # so that no gap reaches the window's edge
    window, cells = Window.covering(box, counted.cell), 0
    check_cells(window, box)
    empty = CellGroups(window)
    for stripe in stripes(window, STRIPE):
        inside = _inside(area, stripe)
        cells += int(inside.sum())
        empty.add(stripe, inside & (counted.laid(stripe)["pulses"] == 0) if counted.touches(stripe) else inside)
    gaps, total = empty.voids(least), cells * counted.cell**2
    uncovered = sum(g.area for g in gaps)
    return {
        "area": total,
        "share": (total - uncovered) / total if total else None,
        "gaps": len(gaps),
        "largest": [{"area": g.area, "bounds": list(g.box.bounds)} for g in gaps[:LISTED]],
    }, gaps


def _inside(area: Polygons, window: Window) -> NDArray[np.bool_]:
    """bool, shape of `window`: the middle of the cell lies in the area."""
    pieces = (
        Window(window.cell, window.col + k, window.row, min(COLUMNS, window.ncols - k), window.nrows)
        for k in range(0, window.ncols, COLUMNS)
    )
    return np.concatenate([_inside_piece(area, piece) for piece in pieces], axis=1)


def _inside_piece(area: Polygons, window: Window) -> NDArray[np.bool_]:
    x, y = (
        millimetres(np.asarray((first + np.arange(n) + 0.5) * window.cell, np.float64))
        for first, n in ((window.col, window.ncols), (window.row, window.nrows))
    )
    wide, high = np.meshgrid(x, y)
    return (owners(wide.ravel(), high.ravel(), area)[1] != NONE).reshape(window.shape)
