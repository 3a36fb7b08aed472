"""Places whose labels teach a model most: mixed ones of which it is unsure."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Box, whole_millimetres
from fwclass.label.params import SuggestParams

WIDEST = 1000.0
"""m, edge of the widest place."""

PARTS = 1_000_000
"""Of an entropy of 1: sums of whole numbers do not depend on the order of what is added."""


@dataclass(frozen=True)
class SuggestedPlace:
    """Attributes
    ----------
    box : the square.
    echoes : classified ones in it.
    z : their mean height [m].
    entropy : their mean, 0 to 1.
    mixture : entropy of the shares of the classes that they were given, 0 (one class) to 1 (as many of each).
    classes : (code, echoes), the most frequent first.
    """

    box: Box
    echoes: int
    z: float
    entropy: float
    mixture: float
    classes: tuple[tuple[int, int], ...]

    @property
    def score(self) -> float:
        """What the places are ranked by, 0 to 1."""
        return self.entropy * self.mixture


class PlaceCounts:
    """Counts classified echoes, added tile by tile, in squares of a global grid with edge `size` [m].

    What `suggest` gives follows from the echoes alone, not from tiles or their order; memory is that of the squares.
    """

    def __init__(self, size: float) -> None:
        self.size, self._edge = size, whole_millimetres(size, "--size (suggest.size)")
        self._keys = np.empty((0, 3), np.int64)  # column, row, class code; each once, in this order
        self._sums = np.empty((0, 3), np.int64)  # echoes, entropies [1/PARTS], heights [mm]

    def add(
        self,
        x: NDArray[np.int64],
        y: NDArray[np.int64],
        z: NDArray[np.int64],
        code: NDArray[np.uint8],
        entropy: NDArray[np.float32],
    ) -> None:
        """Echoes: places [mm], class codes, entropies; those without an entropy (NaN) were not classified."""
        known = np.isfinite(entropy)
        squares = np.stack([x[known] // self._edge, y[known] // self._edge, code[known]], axis=1)
        parts = np.rint(entropy[known].astype(np.float64) * PARTS).astype(np.int64)
        self._join(*_summed(squares, np.stack([np.ones_like(parts), parts, z[known]], axis=1)))

    def widened(self, echoes: int) -> PlaceCounts:
        """The same counts in squares so wide, by doubling, that half of those with echoes have so many; of 1 km at
        most."""
        wide = self
        while 2 * wide.size <= WIDEST and wide.middling < echoes:
            twice = PlaceCounts(2 * wide.size)
            twice._join(wide._keys // (2, 2, 1), wide._sums)
            wide = twice
        return wide

    @property
    def middling(self) -> float:
        """Median of the echoes of the squares [echoes]; 0.0 where there is none."""
        first = self._first()
        return float(np.median(np.add.reduceat(self._sums[:, 0], first))) if len(first) else 0.0

    def places(self) -> list[SuggestedPlace]:
        """All squares with classified echoes, by column and row."""
        first, classes = self._first(), len(np.unique(self._keys[:, 2]))
        return [self._place(a, b, classes) for a, b in pairwise([*first.tolist(), len(self._keys)])]

    def useful(self, params: SuggestParams) -> list[SuggestedPlace]:
        """The mixed places with enough echoes."""
        least = params.least * self.middling
        return [p for p in self.places() if p.echoes >= least and p.score > 0]

    def suggest(self, params: SuggestParams, without: Callable[[SuggestedPlace], bool]) -> list[SuggestedPlace]:
        """The places that teach most, the best first; none `without` labels to give.

        One that touches another is put off until the best of the others has less than `params.apart` of its score.
        """
        ranked = sorted(self.useful(params), key=lambda p: (-p.score, p.box.bounds))
        free = deque(p for p in ranked if not without(p))
        touching: deque[SuggestedPlace] = deque()
        squares: set[tuple[int, int]] = set()
        chosen: list[SuggestedPlace] = []
        while len(chosen) < params.places and (free or touching):
            while free and self._around(free[0]) & squares:
                touching.append(free.popleft())
            waits = bool(free) and not (touching and free[0].score < params.apart * touching[0].score)
            place = (free if waits else touching).popleft()
            squares.add(self._square(place))
            chosen.append(place)
        return chosen

    def _join(self, keys: NDArray[np.int64], sums: NDArray[np.int64]) -> None:
        self._keys, self._sums = _summed(np.concatenate([self._keys, keys]), np.concatenate([self._sums, sums]))

    def _first(self) -> NDArray[np.int64]:
        """int64 (squares,): index of the first key of every square."""
        squares = self._keys[:, :2]
        return np.flatnonzero(np.append(True, (squares[1:] != squares[:-1]).any(axis=1))[: len(squares)])

    def _square(self, place: SuggestedPlace) -> tuple[int, int]:
        return round(place.box.xmin / self.size), round(place.box.ymin / self.size)

    def _around(self, place: SuggestedPlace) -> set[tuple[int, int]]:
        i, j = self._square(place)
        return {(i + a, j + b) for a in (-1, 0, 1) for b in (-1, 0, 1)}

    def _place(self, start: int, end: int, classes: int) -> SuggestedPlace:
        i, j = self._keys[start, :2].tolist()
        echoes, codes = self._sums[start:end, 0], self._keys[start:end, 2]
        n, parts, height = self._sums[start:end].sum(axis=0).tolist()
        share = echoes / n
        mixture = float(-(share * np.log(share)).sum() / np.log(classes)) if classes > 1 else 0.0
        ordered = sorted(zip(codes.tolist(), echoes.tolist(), strict=True), key=lambda c: (-c[1], c[0]))
        edge = self._edge / 1000
        box = Box(i * edge, j * edge, (i + 1) * edge, (j + 1) * edge)
        return SuggestedPlace(box, n, height / n / 1000, parts / n / PARTS, max(0.0, mixture), tuple(ordered))


def _summed(keys: NDArray[np.int64], values: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Every key (rows, 3) once, in their order, and the sums of its values (rows, 3)."""
    order = np.lexsort((keys[:, 2], keys[:, 1], keys[:, 0]))
    keys, values = keys[order], values[order]
    first = np.flatnonzero(np.append(True, (keys[1:] != keys[:-1]).any(axis=1))[: len(keys)])
    return keys[first], np.add.reduceat(values, first, axis=0) if len(first) else values
