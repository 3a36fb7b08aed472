"""Objects of a class: what hangs together of it in the reference and in the answer, and what was made of each.

An object is a group of cells of the global grid, each with an echo of the class, that touch by a side or a corner, in
plan: an airborne beam leaves few echoes on walls, poles and towers, and cells of a volume would cut these.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from fwclass.assess.confusion import align, percent
from fwclass.assess.params import ObjectParams
from fwclass.grid import Box, TileGrid, Window
from fwclass.model import ClassDef, class_index, code_index
from fwclass.pieces import pieces_of

COUNTED = ("reference", "found", "split", "predicted", "correct", "merged")
"""What is counted of objects, by class and size; the first three of the reference's, the others of the answer's."""

_BUILDING, _BUILT, _OWN = 6, (13, 14, 15, 16, 17, 19), 64
"""Codes of LAS 1.4 that are things to be counted, and the first that a user gives a meaning to."""


def object_classes(classes: Sequence[ClassDef], names: Sequence[str] | None) -> tuple[int, ...]:
    """Indices of the classes whose objects are judged: those of `names`; of None buildings, wires, towers, bridges, and
    classes of a user's own codes."""
    if names is not None:
        return tuple(k for k, c in enumerate(classes) if c.name in names)
    return tuple(k for k, c in enumerate(classes) if c.code in (_BUILDING, *_BUILT) or c.code >= _OWN)


SPARSE = 0.25
"""Share of the tested echoes that lie in sparser blocks than the one that decides how wide cells are: where strips
overlap and where a pulse has many echoes they lie closer than on a roof beside, which narrow cells would cut."""


def cells_across(blocks: NDArray[np.int64], edge: float, params: ObjectParams) -> int:
    """How many cells of `params.step` make the edge of one that objects hang together by: `params.spacings` mean
    spacings of the tested echoes in sparse blocks, and `params.cell` at least. `blocks` int64 (blocks, classes,
    classes + 1) are the counts of `BlockCounts` of edge `edge` [m]."""
    echoes = np.sort(blocks.sum(axis=(1, 2)))
    below = np.cumsum(echoes)
    least = round(params.cell / params.step)
    if not len(echoes) or not below[-1]:
        return least
    density = int(echoes[np.searchsorted(below, SPARSE * below[-1])]) / edge**2
    return max(least, math.ceil(params.spacings / density**0.5 / params.step - 1e-9))


@dataclass(frozen=True)
class ObjectCells:
    """Cells with a tested echo of a judged class, in order.

    Attributes
    ----------
    place : int64 (cells, 3), index of the class, row and column in the global grid.
    counts : int64 (cells, 3), echoes of the class in the reference, in the answer, and in both.
    """

    place: NDArray[np.int64]
    counts: NDArray[np.int64]

    @classmethod
    def of(
        cls,
        xy: tuple[NDArray[np.float64], NDArray[np.float64]],
        reference: NDArray[np.uint8],
        predicted: NDArray[np.uint8],
        classes: Sequence[ClassDef],
        judged: Sequence[int],
        cell: float,
    ) -> ObjectCells:
        """Of echoes at `xy` [m], in cells of edge `cell` [m]; rows without a reference class are left out."""
        truth, answer = class_index(reference, classes), code_index(predicted, classes)
        col, row = TileGrid(cell).indices(*xy)
        parts = []
        for k in judged:
            is_so, is_said = truth == k, (answer == k) & (truth >= 0)
            rows = np.flatnonzero(is_so | is_said)
            place = np.stack([np.full(len(rows), k), row[rows], col[rows]], axis=1)
            counts = np.stack([is_so[rows], is_said[rows], (is_so & is_said)[rows]], axis=1)
            parts.append(cls(place, counts.astype(np.int64)))
        return cls.merged(parts)

    @classmethod
    def merged(cls, parts: Iterable[ObjectCells]) -> ObjectCells:
        """The same cells added up: tiles may cut one."""
        everything = [cls(np.empty((0, 3), np.int64), np.empty((0, 3), np.int64)), *parts]
        place = np.concatenate([p.place for p in everything])
        order = np.lexsort(place.T[::-1])
        place = place[order]
        first = np.flatnonzero((np.diff(place, axis=0, prepend=place[:1] - 1) != 0).any(axis=1))
        counts = np.concatenate([p.counts for p in everything])[order]
        return cls(place[first], np.add.reduceat(counts, first, axis=0) if len(first) else counts)

    def coarser(self, times: int) -> ObjectCells:
        """By cells that are so many times as wide."""
        return ObjectCells.merged([replace(self, place=self.place // (1, times, times))])

    def take(self, rows: NDArray[np.bool_]) -> ObjectCells:
        """The cells of `rows`, bool (cells,)."""
        return ObjectCells(self.place[rows], self.counts[rows])

    def parted(self, box: Box, cell: float) -> tuple[ObjectCells, ObjectCells]:
        """Of a tile with edges `box` [m], in cells of `cell` [m]: those whose objects lie in it whole, and those that
        hang together, by objects of the reference and the answer, with cells that may touch another tile's."""
        tile = Window.covering(box, cell)
        near = (self.place[:, 1:] <= (tile.row + 1, tile.col + 1)) | (
            self.place[:, 1:] >= (tile.row + tile.nrows - 2, tile.col + tile.ncols - 2)
        )
        open_ = np.zeros(len(self.place), bool)
        for k in np.unique(self.place[:, 0]):
            mine = self.place[:, 0] == k
            piece = pieces_of(*self.place[mine, 1:].T)
            reaching = np.zeros(len(piece), bool)
            reaching[piece[near[mine].any(axis=1)]] = True
            open_[mine] = reaching[piece]
        return self.take(~open_), self.take(open_)


def count_objects(cells: ObjectCells, classes: int, cell: float, params: ObjectParams) -> NDArray[np.int64]:
    """int64 (classes, sizes, `COUNTED`): objects by class and size, sizes as `params.sizes` begins them [m²].

    `cells` of edge `cell` [m] hold every object whole; counts of cells apart add up. An object of fewer echoes than
    `params.echoes`, or smaller than the first size, is none. An object of the reference is *found* where a share of at
    least `params.overlap` of its echoes has its class, one of the answer *correct* where as large a share of its echoes
    has it in the reference (Rutzinger, Rottensteiner and Pfeifer 2009: an overlap of 50 %). It is *split* where two
    objects of the answer or more hold a share of `params.piece` of its echoes each; one of the answer is *merged* where
    it holds such a share of two objects of the reference or more, by the echoes of each.
    """
    counts = np.zeros((classes, len(params.sizes), len(COUNTED)), np.int64)
    for k in np.unique(cells.place[:, 0]):
        own = cells.take(cells.place[:, 0] == k)
        (truth, so), (answer, said) = (_objects(own, which, cell, params) for which in (0, 1))
        both = scipy.sparse.coo_array((own.counts[:, 2], (truth, answer)), (len(so.echoes) + 1, len(said.echoes) + 1))
        shared = both.tocsr()[:-1, :-1].tocoo()  # the last is no object
        held = shared.data >= params.piece * so.echoes[shared.row]
        held &= so.large[shared.row] & said.large[shared.col]
        split = np.bincount(shared.row[held], minlength=len(so.echoes)) > 1
        merged = np.bincount(shared.col[held], minlength=len(said.echoes)) > 1
        for first, objects, more in ((0, so, split), (3, said, merged)):
            for at, some in enumerate((objects.large, objects.large & objects.hit, objects.large & more)):
                counts[k, :, first + at] = np.bincount(objects.size[some], minlength=len(params.sizes))
    return counts


def object_figures(
    counts: NDArray[np.int64], names: Sequence[str], cell: float, params: ObjectParams
) -> dict[str, Any]:
    """What is told of objects: their cells' edge ``cell`` [m] and, of every class of `names` with an object, the counts
    of `COUNTED` and three figures, of all sizes and by ``sizes``. `counts` int64 (names, sizes, `COUNTED`)."""
    return {
        "cell": cell,
        "classes": [
            {"name": name, **_figures_of(by_size.sum(axis=0))}
            | {"sizes": [{"from": size, **_figures_of(row)} for size, row in zip(params.sizes, by_size, strict=True)]}
            for name, by_size in zip(names, counts, strict=True)
            if by_size.any()
        ],
    }


def _figures_of(row: NDArray[np.int64]) -> dict[str, Any]:
    """The counts, and the completeness and correctness of objects and the quality that both make, 1 / (1 / completeness
    + 1 / correctness - 1) (Rutzinger, Rottensteiner and Pfeifer 2009, equations 1 to 3); None where an object of either
    kind is lacking."""
    row_figures: dict[str, Any] = dict(zip(COUNTED, row.tolist(), strict=True))
    complete = row_figures["found"] / row_figures["reference"] if row_figures["reference"] else None
    correct = row_figures["correct"] / row_figures["predicted"] if row_figures["predicted"] else None
    if complete is None or correct is None:
        quality = None
    else:
        quality = 1.0 / (1.0 / complete + 1.0 / correct - 1.0) if complete and correct else 0.0
    return {**row_figures, "completeness": complete, "correctness": correct, "quality": quality}


def describe_objects(objects: Mapping[str, Any] | None) -> str:
    """What `object_figures` tells as a table for a terminal, sizes as areas that they begin with; empty without
    objects."""
    if not objects or not objects["classes"]:
        return ""
    figures = ("completeness", "correctness", "quality")
    rows = [["objects", "m²", *COUNTED, *(f"{n} %" for n in figures)]]
    for one in objects["classes"]:
        for name, size, row in ((one["name"], "all", one), *(("", f"{r['from']:g}+", r) for r in one["sizes"])):
            if any(row[n] for n in COUNTED):
                rows.append(
                    [
                        name,
                        size,
                        *(f"{row[n]:,}".replace(",", " ") for n in COUNTED),
                        *(percent(row[n]) for n in figures),
                    ]
                )
    return "\n".join(align(rows))


@dataclass(frozen=True)
class _Objects:
    """Of every object: its echoes, whether enough of them have the class in the other too, whether it is large enough
    to be one, and its size's index."""

    echoes: NDArray[np.int64]
    hit: NDArray[np.bool_]
    large: NDArray[np.bool_]
    size: NDArray[np.int64]


def _objects(cells: ObjectCells, which: int, cell: float, params: ObjectParams) -> tuple[NDArray[np.int64], _Objects]:
    """Of one class: the object of every cell, -1 for none, and the objects of the reference (`which` 0) or answer
    (1)."""
    there = cells.counts[:, which] > 0
    piece = pieces_of(*cells.place[there, 1:].T)
    number = int(piece.max(initial=-1)) + 1
    echoes, both = np.zeros(number, np.int64), np.zeros(number, np.int64)
    np.add.at(echoes, piece, cells.counts[there, which])
    np.add.at(both, piece, cells.counts[there, 2])
    area = np.bincount(piece, minlength=number) * cell**2
    size = np.searchsorted(params.sizes, area + 1e-9, side="right") - 1
    large = (size >= 0) & (echoes >= params.echoes)
    of_cell = np.full(len(there), number, np.int64)
    of_cell[there] = piece
    return of_cell, _Objects(echoes, both >= params.overlap * echoes, large, np.maximum(size, 0))
