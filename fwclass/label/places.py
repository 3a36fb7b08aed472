"""Places whose labels teach a model most: mixed ones of which it is unsure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Box, whole_millimetres
from fwclass.label.params import SuggestParams

WIDEST = 1000.0
"""m, edge of the widest place."""

PARTS = 1_000_000
"""Of an entropy of 1: sums of whole numbers do not depend on the order of what is added."""


@dataclass(frozen=True)
class Place:
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
        self.size, self._edge = size, whole_millimetres(size, "suggest.size")
        self._counts: dict[tuple[int, int, int], NDArray[np.int64]] = {}

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
        keys, number = np.unique(squares, axis=0, return_inverse=True)
        parts = np.rint(entropy[known].astype(np.float64) * PARTS).astype(np.int64)
        sums = np.zeros((len(keys), 3), np.int64)
        np.add.at(sums, number.ravel(), np.stack([np.ones_like(parts), parts, z[known]], axis=1))
        for key, row in zip(map(tuple, keys.tolist()), sums, strict=True):
            self._counts[key] = self._counts.get(key, 0) + row

    def widened(self, echoes: int) -> PlaceCounts:
        """The same counts in squares so wide, by doubling, that half of those with echoes have so many; of 1 km at
        most."""
        wide = self
        while 2 * wide.size <= WIDEST and wide.middling < echoes:
            twice = PlaceCounts(2 * wide.size)
            for (i, j, code), sums in wide._counts.items():
                key = i // 2, j // 2, code
                twice._counts[key] = twice._counts.get(key, 0) + sums
            wide = twice
        return wide

    @property
    def middling(self) -> float:
        """Median of the echoes of the squares [echoes]; 0.0 where there is none."""
        squares: dict[tuple[int, int], int] = {}
        for (i, j, _), sums in self._counts.items():
            squares[i, j] = squares.get((i, j), 0) + int(sums[0])
        return float(np.median(list(squares.values()))) if squares else 0.0

    def places(self) -> list[Place]:
        """All squares with classified echoes, by column and row."""
        squares: dict[tuple[int, int], dict[int, NDArray[np.int64]]] = {}
        for (i, j, code), sums in sorted(self._counts.items()):
            squares.setdefault((i, j), {})[code] = sums
        classes = len({code for _, _, code in self._counts})
        return [self._place(i, j, by_code, classes) for (i, j), by_code in squares.items()]

    def suggest(self, params: SuggestParams, without: Callable[[Place], bool]) -> list[Place]:
        """The places that teach most, the best first: no two touch, unless there are no others; none `without` labels
        to give."""
        least = params.least * self.middling
        useful = (p for p in self.places() if p.echoes >= least and p.score > 0 and not without(p))
        ranked = sorted(useful, key=lambda p: (-p.score, p.box.bounds))
        taken: set[tuple[int, int]] = set()
        apart: list[Place] = []
        touching: list[Place] = []
        for place in ranked:
            i, j = round(place.box.xmin / self.size), round(place.box.ymin / self.size)
            near = any((i + a, j + b) in taken for a in (-1, 0, 1) for b in (-1, 0, 1))
            (touching if near else apart).append(place)
            if not near:
                taken.add((i, j))
        return (apart + touching)[: params.places]

    def _place(self, i: int, j: int, by_code: dict[int, NDArray[np.int64]], classes: int) -> Place:
        n, parts, height = np.sum(list(by_code.values()), axis=0).tolist()
        share = np.array([sums[0] for sums in by_code.values()]) / n
        mixture = float(-(share * np.log(share)).sum() / np.log(classes)) if classes > 1 else 0.0
        ordered = sorted(((code, int(sums[0])) for code, sums in by_code.items()), key=lambda c: (-c[1], c[0]))
        edge = self._edge / 1000
        box = Box(i * edge, j * edge, (i + 1) * edge, (j + 1) * edge)
        return Place(box, n, height / n / 1000, parts / n / PARTS, max(0.0, mixture), tuple(ordered))
