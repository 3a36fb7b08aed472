"""An area of interest: the tiles that its polygons share area with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError, several
from fwclass.formats.crs import crs_of_wkt
from fwclass.grid import Box
from fwclass.survey.files import box_text
from fwclass.survey.layout import Layout

if TYPE_CHECKING:
    from fwclass.formats.wkb import Shapes
    from fwclass.read.polygons import PolygonLayer


@dataclass(frozen=True)
class Area:
    """The polygons of a file (GeoParquet, GeoPackage, GeoJSON, Shapefile), in any coordinate system that it names."""

    path: Path

    def check(self) -> None:
        """`InputError` for a file that holds no polygon, before anything is computed."""
        from fwclass.read.polygons import open_polygons, read_polygons

        opened = open_polygons(self.path)
        self._some(opened, read_polygons(opened, None)[1])

    def _some(self, opened: PolygonLayer, shapes: Shapes) -> None:
        if not shapes.parts:
            raise InputError(
                "the area of interest has no polygon",
                where=self.path,
                expected="at least one",
                got=f"{opened.features} features",
                do="check the export of the polygons",
            )

    def tiles(self, layout: Layout, crs: str | None, say: Callable[[str], None] | None = None) -> frozenset[str]:
        """Keys of the tiles of `layout` that share area with a polygon; `crs` is the survey's (WKT). Polygons that lie
        outside of the survey are told by `say`.

        `InputError`: no polygons, an unknown system, or nothing of the survey in them.
        """
        from fwclass.read.polygons import open_polygons, read_polygons, reproject, source_crs

        opened = open_polygons(self.path)
        _, shapes = read_polygons(opened, None)
        self._some(opened, shapes)
        survey = crs_of_wkt(crs)
        do = "export them with their system: GeoPackage and GeoParquet keep it"
        own = source_crs(opened, None, survey, do, say)
        if own is not None and survey is not None:
            shapes, _ = reproject(shapes, own, survey, self.path, do)
        a, b = edges(shapes.x, shapes.y, shapes.ring_start)
        chosen = frozenset(t.key for t in layout.tiles if shares_area(t.box, a, b))
        if not chosen:
            system = f" ({survey.name})" if survey is not None else ""
            reach = Box(*(float(f(v)) for f in (np.min, np.max) for v in (shapes.x, shapes.y)))
            raise InputError(
                "no tile of the survey lies in the area of interest",
                where=self.path,
                expected=f"polygons that meet {box_text(layout.box)}{system}",
                got=box_text(reach),
                do="check the polygons, and the coordinate system that their file names"
                + (f" ({own.name})" if own is not None else ""),
            )
        if say is not None and (outside := _outside(shapes, layout.box)):
            say(
                f"remark           {outside} of {several(shapes.parts, 'polygon')} of {self.path} outside of the survey"
            )
        return chosen


def _outside(shapes: Shapes, box: Box) -> int:
    """How many polygons lie outside of `box`, by their extents."""
    ends = shapes.ring_start[shapes.part_start[:-1]]
    least = np.minimum.reduceat(shapes.x, ends), np.minimum.reduceat(shapes.y, ends)
    most = np.maximum.reduceat(shapes.x, ends), np.maximum.reduceat(shapes.y, ends)
    apart = (most[0] < box.xmin) | (least[0] > box.xmax) | (most[1] < box.ymin) | (least[1] > box.ymax)
    return int(apart.sum())


def edges(
    x: NDArray[np.float64], y: NDArray[np.float64], ring_start: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """First and second corner, shape (n, 2) each, of every edge of closed rings."""
    last = np.zeros(len(x), bool)
    last[ring_start[1:] - 1] = True
    at = np.flatnonzero(~last)
    corners = np.column_stack([x, y])
    return corners[at], corners[at + 1]


def shares_area(box: Box, a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    """`box` and the polygons with edges `a` to `b` share area; a common border is none. Holes count as outside."""
    centre = np.array([box.xmin + box.xmax, box.ymin + box.ymax]) / 2
    half = np.array([box.xmax - box.xmin, box.ymax - box.ymin]) / 2
    reach, middle = np.abs(b - a) / 2, (a + b) / 2 - centre
    near = (np.abs(middle) < half + reach).all(axis=1)
    turned = np.abs((b - a)[:, 0] * middle[:, 1] - (b - a)[:, 1] * middle[:, 0])
    if (near & (turned < half[0] * 2 * reach[:, 1] + half[1] * 2 * reach[:, 0])).any():
        return True  # an edge goes through it; without one it is all inside or all outside
    over = (a[:, 1] > centre[1]) != (b[:, 1] > centre[1])
    p, q = a[over], b[over]
    crossing = p[:, 0] + (centre[1] - p[:, 1]) / (q[:, 1] - p[:, 1]) * (q[:, 0] - p[:, 0])
    return bool((crossing > centre[0]).sum() % 2)
