"""Rasters of parts: written with their window, laid together into larger ones."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Tile, Window, whole_millimetres
from fwclass.run.inputs import PartInputs
from fwclass.store.arrays import write_arrays

RASTERS = "rasters"


def window_of(attributes: Mapping[str, Any]) -> Window:
    """The window that a raster part was written for."""
    return Window(float(attributes["cell"]), *(int(attributes[n]) for n in ("col", "row", "ncols", "nrows")))


def write_rasters(directory: Path, arrays: Mapping[str, NDArray], window: Window) -> None:
    """Rasters of a part with the window they cover."""
    about = {n: getattr(window, n) for n in ("cell", "col", "row", "ncols", "nrows")}
    write_arrays(directory / RASTERS, arrays, about)


class Mosaic:
    """Rasters of a stage's `blocks`, laid into one window after the other.

    Each block covers its box, in cells of `cell`; of a cell that two blocks share, the later one's counts. `empty`
    gives name, value and dtype where no block has cells. A block's rasters are read once if the windows come in order:
    they are kept while the next window has cells of them too.
    """

    def __init__(
        self, inputs: PartInputs, stage: str, blocks: Sequence[Tile], cell: float, empty: Mapping[str, np.generic]
    ) -> None:
        self.cell = cell
        self._inputs, self._stage, self._empty = inputs, stage, empty
        self._keys = [b.key for b in blocks]
        windows = [Window.covering(b.box, cell) for b in blocks]
        low = np.array([(w.row, w.col) for w in windows], np.int64).reshape(-1, 2)
        self._low, self._high = low, low + np.array([w.shape for w in windows], np.int64).reshape(-1, 2)
        self._held: dict[str, tuple[dict[str, NDArray], Window]] = {}

    def touches(self, window: Window) -> bool:
        """Whether any block has cells of `window`."""
        return bool(self._within(window).size)

    def laid(self, window: Window) -> dict[str, NDArray]:
        """The rasters in `window`, row 0 in the south."""
        keys = [self._keys[k] for k in self._within(window)]
        self._held = {k: self._held[k] for k in keys if k in self._held}
        out = {n: np.full(window.shape, value, value.dtype) for n, value in self._empty.items()}
        for key in keys:
            arrays, own = self._block(key)
            shared = window.common(own)
            if shared is not None:
                for name, raster in out.items():
                    raster[shared.within(window)] = arrays[name][shared.within(own)]
        return out

    def thinned(self, window: Window, step: int) -> dict[str, NDArray]:
        """As ``raster[::step, ::step]`` of each of the rasters in `window`, without holding them: block by block."""
        shape = (-(-window.nrows // step), -(-window.ncols // step))
        out = {n: np.full(shape, value, value.dtype) for n, value in self._empty.items()}
        for k in self._within(window):
            arrays, own = self._read(self._keys[k])
            shared = window.common(own)
            if shared is None:
                continue
            row, col = -(-(shared.row - window.row) // step), -(-(shared.col - window.col) // step)
            first_r, first_c = window.row + row * step - own.row, window.col + col * step - own.col
            for name, raster in out.items():
                rows, cols = shared.within(own)
                piece = arrays[name][first_r : rows.stop : step, first_c : cols.stop : step]
                raster[row : row + piece.shape[0], col : col + piece.shape[1]] = piece
        return out

    def _within(self, window: Window) -> NDArray[np.int64]:
        low, high = (window.row, window.col), (window.row + window.nrows, window.col + window.ncols)
        return np.flatnonzero(((self._low < high) & (self._high > low)).all(axis=1))

    def _block(self, key: str) -> tuple[dict[str, NDArray], Window]:
        if key not in self._held:
            self._held[key] = self._read(key)
        return self._held[key]

    def _read(self, key: str) -> tuple[dict[str, NDArray], Window]:
        arrays, attributes = self._inputs.arrays(self._stage, key, RASTERS, tuple(self._empty))
        return arrays, window_of(attributes)


def stripes(window: Window, rows: int) -> Iterator[Window]:
    """`window` in stripes of `rows` rows over its whole width, from the north; the last one may be narrower."""
    top = window.row + window.nrows
    for north in range(0, window.nrows, rows):
        height = min(rows, window.nrows - north)
        yield Window(window.cell, window.col, top - north - height, window.ncols, height)


def owned(block: Tile, cell: float) -> Window:
    """The cells of the global grid whose south-west corner lies in a block."""
    mm = whole_millimetres(cell, "cell")
    low_x, low_y, high_x, high_y = (round(v * 1000) for v in block.box.bounds)
    col, row = -(-low_x // mm), -(-low_y // mm)
    return Window(cell, col, row, -(-high_x // mm) - col, -(-high_y // mm) - row)
