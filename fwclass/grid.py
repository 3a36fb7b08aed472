"""Tiles, blocks and rasters of one global grid with a fixed origin; checks of seams alone shift it.

Everything is decided in whole millimetres, so that a point on an edge has exactly one owner whatever the
size of the coordinates. Tiles and cells are half-open: [min, max).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import ConfigError
from fwclass.hashing import hash_keys
from fwclass.units import QUANTUM

_KEY = re.compile(r"(-?[0-9]{1,18})_(-?[0-9]{1,18})")

FURTHEST = 1e8
"""m, no coordinate system in metres has larger numbers on Earth (zones before the easting: 6e7); far beyond, whole
millimetres are no numbers of 64 bits any more."""


def millimetres(metres: NDArray[np.float64]) -> NDArray[np.int64]:
    """Coordinates [m] as whole millimetres, rounded to nearest."""
    return _round_millimetres(metres).astype(np.int64)


def quantise(metres: NDArray[np.float64]) -> NDArray[np.float64]:
    """Coordinates [m] on the millimetre grid; `millimetres` takes them back exactly."""
    out = _round_millimetres(metres)
    out *= QUANTUM
    return out


def _round_millimetres(metres: NDArray[np.float64]) -> NDArray[np.float64]:
    out = np.divide(metres, QUANTUM, dtype=np.float64)
    return np.rint(out, out=out) if isinstance(out, np.ndarray) else np.rint(out)


def whole_millimetres(length: float, name: str) -> int:
    """`length` [m] as a positive whole number of millimetres, or a `ConfigError` naming the setting."""
    mm = round(length / QUANTUM)
    if mm <= 0 or abs(mm * QUANTUM - length) > 1e-9 * max(1.0, abs(length)):
        raise ConfigError(
            f"{name} must be a positive whole number of millimetres",
            where=name,
            expected="for example 100.0 (metres)",
            got=length,
            do=f"change {name} in the configuration",
        )
    return mm


@dataclass(frozen=True)
class Box:
    """A half-open rectangle [xmin, xmax) × [ymin, ymax) [m]."""

    xmin: float
    ymin: float
    xmax: float
    ymax: float

    def grown(self, by: float) -> Box:
        """The box with `by` [m] more on every side."""
        return Box(self.xmin - by, self.ymin - by, self.xmax + by, self.ymax + by)

    def moved(self, dx: float, dy: float) -> Box:
        """The box shifted by (dx, dy) [m]."""
        return Box(self.xmin + dx, self.ymin + dy, self.xmax + dx, self.ymax + dy)

    def common(self, other: Box) -> Box | None:
        """The area [m] that both have, or None."""
        if not self.touches(other):
            return None
        low = max(self.xmin, other.xmin), max(self.ymin, other.ymin)
        return Box(*low, min(self.xmax, other.xmax), min(self.ymax, other.ymax))

    def contains(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
        """bool (points,): whether (x, y) [m] lie in the box, decided in whole millimetres; its edges in the south and
        west belong to it."""
        mx, my = millimetres(x), millimetres(y)
        low_x, low_y, high_x, high_y = (round(v / QUANTUM) for v in self.bounds)
        return (mx >= low_x) & (mx < high_x) & (my >= low_y) & (my < high_y)

    def touches(self, other: Box) -> bool:
        """Whether two boxes share area [m²]; edges that meet do not."""
        return self.xmin < other.xmax and other.xmin < self.xmax and self.ymin < other.ymax and other.ymin < self.ymax

    def holds(self, other: Box) -> bool:
        """Whether nothing of `other` lies outside, decided in whole millimetres."""
        low_x, low_y, high_x, high_y = (round(v / QUANTUM) for v in self.bounds)
        west, south, east, north = (round(v / QUANTUM) for v in other.bounds)
        return low_x <= west and low_y <= south and east <= high_x and north <= high_y

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(xmin, ymin, xmax, ymax) [m]."""
        return self.xmin, self.ymin, self.xmax, self.ymax

    @property
    def area(self) -> float:
        """Area [m²]."""
        return (self.xmax - self.xmin) * (self.ymax - self.ymin)


@dataclass(frozen=True, order=True)
class Tile:
    """One square of a `TileGrid`; `key` is its name in the store, for example ``12_34``.

    `origin` [m] is (0, 0) for all that is stored; only checks of seams cut a survey another way.
    """

    ix: int
    iy: int
    size: float
    origin: tuple[float, float] = (0.0, 0.0)

    @property
    def key(self) -> str:
        """The tile's name, ``<column>_<row>``."""
        return f"{self.ix}_{self.iy}"

    @property
    def box(self) -> Box:
        """The area of the tile [m], half-open in the north and east: whole millimetres, the same numbers as coordinates
        on its edges have."""
        mm, (x, y) = round(self.size / QUANTUM), (round(o / QUANTUM) for o in self.origin)
        west, south = self.ix * mm + x, self.iy * mm + y
        return Box(*(v * QUANTUM for v in (west, south, west + mm, south + mm)))


@dataclass(frozen=True)
class TileGrid:
    """Squares of edge `size` [m] that tile the plane from `origin` [m] in the survey's CRS, whole millimetres."""

    size: float
    origin: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        whole_millimetres(self.size, "tile size")

    def halfway(self) -> TileGrid:
        """The same squares, each in the middle of four of these, to the millimetre [m]."""
        half = (whole_millimetres(self.size, "tile size") // 2) / 1000.0
        return TileGrid(self.size, (self.origin[0] + half, self.origin[1] + half))

    def indices(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Column and row, int64 (points,) each, of the tile that owns every point (x, y) [m]."""
        mm = whole_millimetres(self.size, "tile size")
        ox, oy = (round(v / QUANTUM) for v in self.origin)
        return (millimetres(x) - ox) // mm, (millimetres(y) - oy) // mm

    def keys(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> set[str]:
        """Keys of the tiles that own a point (x, y) [m]."""
        ix, iy = self.indices(x, y)
        both = np.unique((ix << 32) + iy)
        column = (both + (1 << 31)) >> 32
        return {f"{a}_{b}" for a, b in zip(column.tolist(), (both - (column << 32)).tolist(), strict=True)}

    def tile(self, key: str) -> Tile:
        """The tile of a key (``<column>_<row>``); `ConfigError` for what is no key."""
        match = _KEY.fullmatch(key)
        if match is None:
            raise ConfigError("not a tile key", where="tiles", expected="column_row, for example 12_34", got=key)
        return Tile(int(match[1]), int(match[2]), self.size, self.origin)

    def touching(self, box: Box) -> Iterator[Tile]:
        """Every tile that shares area with `box` [m], by column, then row."""
        columns, rows = self._touched(box)
        return (Tile(ix, iy, self.size, self.origin) for ix in columns for iy in rows)

    def keys_touching(self, box: Box) -> Iterator[str]:
        """The keys of the same tiles, in a fifth of the time: a wide halo touches hundreds of small tiles."""
        columns, rows = self._touched(box)
        return (f"{ix}_{iy}" for ix in columns for iy in rows)

    def _touched(self, box: Box) -> tuple[range, range]:
        """Columns and rows of the tiles that share area with `box` [m]."""
        mm = whole_millimetres(self.size, "tile size")
        ox, oy = self.origin
        low_x, low_y, high_x, high_y = (round(v / QUANTUM) for v in box.moved(-ox, -oy).bounds)
        return range(low_x // mm, (high_x - 1) // mm + 1), range(low_y // mm, (high_y - 1) // mm + 1)


def draw_order(tiles: Sequence[Tile], seed: int) -> list[int]:
    """Places in `tiles` in an order that only the seed and the tiles decide."""
    keys = np.array([((t.ix & 0xFFFFFFFF) << 32) | (t.iy & 0xFFFFFFFF) for t in tiles], np.uint64)
    return np.argsort(hash_keys(seed, keys), kind="stable").tolist()


def groups(tiles: Iterable[Tile]) -> tuple[tuple[Tile, ...], ...]:
    """Tiles of one grid that touch each other, by a side or a corner, directly or through others; all in order."""
    left = {(t.ix, t.iy): t for t in sorted(tiles)}
    out = []
    while left:
        first = next(iter(left))
        group, todo = [left.pop(first)], [first]
        while todo:
            ix, iy = todo.pop()
            near = [(ix + a, iy + b) for a in (-1, 0, 1) for b in (-1, 0, 1) if (ix + a, iy + b) in left]
            group += [left.pop(n) for n in near]
            todo += near
        out.append(tuple(sorted(group)))
    return tuple(out)


def joint_box(boxes: Iterable[Box]) -> Box:
    """The smallest box [m] that holds all `boxes`; `ValueError` for none."""
    low_x, low_y, high_x, high_y = zip(*(b.bounds for b in boxes), strict=True)
    return Box(min(low_x), min(low_y), max(high_x), max(high_y))


@dataclass(frozen=True)
class Window:
    """Cells [col, col + ncols) × [row, row + nrows) of the global raster of `cell` [m].

    Arrays of a window are indexed [row, column] with **row 0 in the south** and y growing with the row;
    `publish` turns them over for formats that start in the north.
    """

    cell: float
    col: int
    row: int
    ncols: int
    nrows: int

    @classmethod
    def covering(cls, box: Box, cell: float, margin: int = 0) -> Window:
        """The smallest window of cells of `cell` [m] that covers `box`, grown by `margin` cells on every side."""
        mm = whole_millimetres(cell, "cell")
        low_x, low_y, high_x, high_y = (round(v / QUANTUM) for v in box.bounds)
        col, row = low_x // mm - margin, low_y // mm - margin
        ncols = -(-high_x // mm) + margin - col
        nrows = -(-high_y // mm) + margin - row
        return cls(cell, col, row, ncols, nrows)

    @classmethod
    def of_points(cls, box: Box, cell: float) -> Window:
        """The smallest window of cells of `cell` [m] that holds points of the half-open `box` [m], its own upper edges
        included: points that lie exactly on these open no row and no column of cells."""
        high_x, high_y = (
            max(h - QUANTUM, low + QUANTUM) for low, h in zip(box.bounds[:2], box.bounds[2:], strict=True)
        )
        return cls.covering(Box(box.xmin, box.ymin, high_x, high_y), cell)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of the window's array."""
        return self.nrows, self.ncols

    @property
    def box(self) -> Box:
        """The area that the window covers [m]."""
        c = self.cell
        return Box(self.col * c, self.row * c, (self.col + self.ncols) * c, (self.row + self.nrows) * c)

    def within(self, outer: Window) -> tuple[slice, slice]:
        """The slices (rows, columns) of `outer`'s array that are this window; `ValueError` where it does not lie
        inside."""
        r, c = self.row - outer.row, self.col - outer.col
        inside = (
            r >= 0
            and c >= 0
            and r + self.nrows <= outer.nrows
            and c + self.ncols <= outer.ncols
            and math.isclose(self.cell, outer.cell)
        )
        if not inside:
            raise ValueError(f"window {self} does not lie inside {outer}")
        return slice(r, r + self.nrows), slice(c, c + self.ncols)

    def grown(self, margin: int) -> Window:
        """The window with `margin` [cells] more on every side."""
        n = 2 * margin
        return Window(self.cell, self.col - margin, self.row - margin, self.ncols + n, self.nrows + n)

    def common(self, other: Window) -> Window | None:
        """The cells that both windows have, or None; both of one grid."""
        col, row = max(self.col, other.col), max(self.row, other.row)
        ncols = min(self.col + self.ncols, other.col + other.ncols) - col
        nrows = min(self.row + self.nrows, other.row + other.nrows) - row
        return Window(self.cell, col, row, ncols, nrows) if ncols > 0 and nrows > 0 else None
