"""Height rasters of two deliveries held against each other, cell by cell."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.publish.delivered_raster import delivered_raster

COMPARED = ("dtm.tif", "dsm.tif")
"""Terrain and surface; the others are made of them, or of classes."""

DIFFERS = 0.01
"""m, from which a cell has another height: the millimetres of the coordinates, rounded to float32."""

ROWS = 512
"""Rows of a raster that are held at a time."""


def raster_changes(first: Path, second: Path) -> list[dict[str, Any]]:
    """What changed in the rasters that both directories have, site by site.

    Returns dicts with ``name``; ``cells`` that both have; ``only_first`` and ``only_second`` cells; and of the heights
    of the second less the first [m]: how many ``changed`` cells, the ``mean``, ``rmse``, ``lowest`` and ``highest`` of
    all, None without a cell. ``why`` instead of all figures where cells do not lie on each other.
    """
    names = sorted(
        str(path.relative_to(first))
        for name in COMPARED
        for path in first.rglob(name)
        if (second / path.relative_to(first)).is_file()
    )
    return [{"name": name, **_compare(first / name, second / name)} for name in names]


def _compare(first: Path, second: Path) -> dict[str, Any]:
    with delivered_raster(first) as a, delivered_raster(second) as b:
        cells = [(f.transform.a, -f.transform.e) for f in (a, b)]
        column, row = ((b.transform.c - a.transform.c) / cells[0][0], (a.transform.f - b.transform.f) / cells[0][1])
        if cells[0] != cells[1] or abs(column - round(column)) > 1e-6 or abs(row - round(row)) > 1e-6:
            return {"why": f"cells of {cells[0][0]:g} m and {cells[1][0]:g} m do not lie on each other"}
        known = [sum(int(np.isfinite(v).sum()) for v in _rows(f)) for f in (a, b)]
        both, changed, total, squares, lowest, highest = 0, 0, 0.0, 0.0, math.inf, -math.inf
        for before, after in _common(a, b, round(column), round(row)):
            off = (after.astype(np.float64) - before)[np.isfinite(before) & np.isfinite(after)]
            if len(off):
                both, changed = both + len(off), changed + int((np.abs(off) > DIFFERS).sum())
                total, squares = total + float(off.sum()), squares + float((off**2).sum())
                lowest, highest = min(lowest, float(off.min())), max(highest, float(off.max()))
    counts = {"cells": both, "only_first": known[0] - both, "only_second": known[1] - both, "changed": changed}
    if not both:
        return {**counts, "mean": None, "rmse": None, "lowest": None, "highest": None}
    heights = {"mean": total / both, "rmse": math.sqrt(squares / both), "lowest": lowest, "highest": highest}
    return {**counts, **heights}


def _rows(file: Any, first: int = 0, last: int | None = None, columns: slice | None = None) -> Iterator[NDArray]:
    """Heights of stripes of a file, NaN where there are none."""
    columns = columns or slice(0, file.width)
    for row in range(first, file.height if last is None else last, ROWS):
        rows = min(ROWS, (file.height if last is None else last) - row)
        values = file.read(1, window=((row, row + rows), (columns.start, columns.stop)))
        yield np.where(values == file.nodata, np.nan, values) if file.nodata is not None else values


def _common(a: Any, b: Any, column: int, row: int) -> Iterator[tuple[NDArray, NDArray]]:
    """Stripes of what both files cover; `column`, `row` of the first that the second begins at."""
    left, right = max(0, column), min(a.width, column + b.width)
    top, bottom = max(0, row), min(a.height, row + b.height)
    if left >= right or top >= bottom:
        return
    yield from zip(
        _rows(a, top, bottom, slice(left, right)),
        _rows(b, top - row, bottom - row, slice(left - column, right - column)),
        strict=True,
    )
