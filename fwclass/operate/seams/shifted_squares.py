"""Borders of squares, the bands along them, and the shifted squares that hold them inside."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import ConfigError
from fwclass.grid import Box, Tile, TileGrid, draw_order, whole_millimetres


@dataclass(frozen=True)
class ShiftedSquare:
    """A square of the shifted grid with the borders inside it.

    `bands`: what lies as near to a border as is asked for; `length`: of the borders [m].
    """

    tile: Tile
    bands: tuple[Box, ...]
    length: float

    def holds(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Points that lie in a band."""
        inside = np.zeros(len(x), bool)
        for band in self.bands:
            inside |= band.contains(x, y)
        return inside


def shift_of(text: str | None, size: float) -> tuple[float, float]:
    """``dx,dy`` [m] as typed; None: half a tile either way. `ConfigError` for what leaves the grid where it is."""
    if text is None:
        return TileGrid(size).halfway().origin
    try:
        dx, dy = (round(float(word), 3) for word in text.split(","))
        moved = [round(1000 * v) % whole_millimetres(size, "tile.size") for v in (dx, dy)]
    except (ValueError, OverflowError):
        moved = []
    if not any(moved):
        raise ConfigError(
            "not a shift of the grid",
            where="--shift",
            expected=f"dx,dy in metres, not both multiples of {size:g}",
            got=text,
            do=f"leave it out for {size / 2:g},{size / 2:g}",
        )
    return dx, dy


def shifted_squares(keys: Iterable[str], size: float, shift: tuple[float, float], width: float) -> list[ShiftedSquare]:
    """Squares of the shifted grid that hold a border between two of the squares `keys` (edge `size` [m])."""
    whole_millimetres(width, "seams.width")
    bands: dict[Tile, list[tuple[Box, float]]] = {}
    grid = TileGrid(size, shift)
    for band, upright in _bands(keys, size, width):
        for tile in grid.touching(band):
            piece = band.common(tile.box)
            if piece is not None:
                long = piece.ymax - piece.ymin if upright else piece.xmax - piece.xmin
                bands.setdefault(tile, []).append((piece, long))
    return [ShiftedSquare(t, tuple(b for b, _ in some), sum(n for _, n in some)) for t, some in sorted(bands.items())]


def _bands(keys: Iterable[str], size: float, width: float) -> Iterator[tuple[Box, bool]]:
    """What lies within `width` of every border between two squares; whether the border runs north."""
    here, grid = frozenset(keys), TileGrid(size)
    for tile in sorted(grid.tile(k) for k in here):
        b = tile.box
        if f"{tile.ix + 1}_{tile.iy}" in here:
            yield Box(b.xmax - width, b.ymin, b.xmax + width, b.ymax), True
        if f"{tile.ix}_{tile.iy + 1}" in here:
            yield Box(b.xmin, b.ymax - width, b.xmax, b.ymax + width), False


def choose_squares(
    candidates: Sequence[ShiftedSquare], share: float, length: float | None, seed: int
) -> list[ShiftedSquare]:
    """Places drawn until they have `share` of all borders, or `length` [m] of them; at least one if there is one."""
    most = share * sum(p.length for p in candidates) if length is None else length
    squares: list[ShiftedSquare] = []
    have = 0.0
    for k in draw_order([p.tile for p in candidates], seed):
        if squares and have >= most:
            break
        squares.append(candidates[k])
        have += candidates[k].length
    return sorted(squares, key=lambda p: p.tile)
