"""Polygons and points with attributes as tables: one row an object, and one row a corner."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fwclass.schema import Table
from fwclass.vectors.outline import Ring

CORNERS = ("component", "ring", "x", "y")


@dataclass(frozen=True)
class Shapes:
    """Objects of one kind.

    Attributes
    ----------
    rows : a row an object.
    corners : `CORNERS` of their polygons; `component` is the object's row, `ring` 0 its outline, others its holes.
    """

    rows: Table
    corners: Table

    @classmethod
    def of(cls, rows: Table, polygons: Sequence[Sequence[Ring]]) -> Shapes:
        """One polygon a row."""
        parts = [(k, n, ring) for k, polygon in enumerate(polygons) for n, ring in enumerate(polygon)]
        if not parts:
            return cls(rows, Table.empty(CORNERS))
        lengths = [len(ring) for _, _, ring in parts]
        points = np.concatenate([ring for _, _, ring in parts])
        object_of, ring_of = (np.repeat([part[k] for part in parts], lengths) for k in (0, 1))
        return cls(rows, Table({"component": object_of, "ring": ring_of, "x": points[:, 0], "y": points[:, 1]}))

    @classmethod
    def together(cls, parts: Sequence[Shapes]) -> Shapes:
        """All objects of `parts`, at least one, in their order."""
        first, corners = 0, []
        for part in parts:
            corners.append(part.corners.with_columns({"component": part.corners["component"] + np.uint32(first)}))
            first += part.rows.rows
        return cls(Table.concat(p.rows for p in parts), Table.concat(corners))

    def polygons(self) -> list[list[Ring]]:
        """The rings of every object, in the order of the rows."""
        out: list[list[Ring]] = [[] for _ in range(self.rows.rows)]
        points = np.stack([self.corners["x"], self.corners["y"]], axis=1)
        which, ring = self.corners["component"], self.corners["ring"]
        new = (np.diff(which, prepend=np.uint32(0)) != 0) | (np.diff(ring, prepend=np.uint32(0)) != 0)
        ends = [0, *(np.flatnonzero(new[1:]) + 1).tolist(), len(which)]
        for first, last in pairwise(ends):
            if last > first:
                out[int(which[first])].append(points[first:last])
        return out

    def ordered(self, order: NDArray[np.integer]) -> Shapes:
        """The objects by their indices `order`, int (objects,): in another order, or some of them."""
        polygons = self.polygons()
        return Shapes.of(self.rows.take(order), [polygons[k] for k in order])
