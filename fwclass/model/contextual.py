"""A model of two layers: the second answers for every echo again, by the first one's answers around it."""

from __future__ import annotations

import math
from collections.abc import Iterable

from fwclass.model.layered import Layered

WHOLE = 255
"""What shares of the first layer count in: a byte holds them."""

MOST_CELLS = 10
"""Sizes of cells at most."""

MOST_WEIGHT = 10.0
"""What a class's share is multiplied by at most, where another's is by 1."""

WIDEST = 20.0
"""m, edge of a cell at most: a box of five is as wide as a feature may reach."""


class Contextual(Layered):
    """Both layers tell all classes; the answer is the mean of their shares, weighed by class.

    The card's ``context`` has ``cells``, the edges of the cells that neighbours are counted in [m], and where classes
    do not weigh the same, ``weights``: what each one's share is multiplied by.
    """

    kind = "contextual"

    @property
    def cells(self) -> tuple[float, ...]:
        """Edges of the cells [m]."""
        return tuple(float(c) for c in self.card["context"]["cells"])

    @property
    def weights(self) -> tuple[float, ...] | None:
        """What the share of every class is multiplied by, (classes,); None where all weigh the same."""
        weights = self.card["context"].get("weights")
        return None if weights is None else tuple(float(w) for w in weights)

    @property
    def deciding(self) -> tuple[str, ...]:
        """The first layer's features, and the context."""
        return self.fine.features

    def _layer_fault(self) -> str:
        try:
            cells, weights = self.cells, self.weights
        except (AttributeError, KeyError, TypeError, ValueError, OverflowError) as fault:
            return (
                f"its card does not say how wide its cells are, or what classes weigh ({type(fault).__name__}: {fault})"
            )
        if not 1 <= len(cells) <= MOST_CELLS or not all(math.isfinite(c) and 0 < c <= WIDEST for c in cells):
            return f"cells of {', '.join(f'{c:g}' for c in cells[:MOST_CELLS])} m are none"
        if any(abs(1000 * c - round(1000 * c)) > 1e-6 or round(1000 * c) < 1 for c in cells):
            return "its cells are no whole millimetres"
        if weights and not (len(weights) == len(self.classes) and all(1 <= w <= MOST_WEIGHT for w in weights)):
            return f"weights of {', '.join(f'{w:g}' for w in weights[:MOST_CELLS])} are none of its classes"
        if self.fine.classes != self.coarse.classes:
            return "its layers tell other classes"
        if self.fine.features != (*self.features, *context_names((c.code for c in self.classes), cells)):
            return "its second layer decides by other features than the first one's and their context"
        return ""


def context_names(codes: Iterable[int], cells: Iterable[float]) -> tuple[str, ...]:
    """Names of the features that the second layer has besides: the own shares of every class, and for cells of every
    edge [m] their means in plan (`c`) and in space (`v`), by the edge in millimetres."""
    codes = tuple(int(code) for code in codes)
    own = tuple(f"share_{code}" for code in codes)
    boxes = ((kind, round(1000 * edge)) for edge in cells for kind in "cv")
    return (*own, *(f"share_{code}_{kind}{edge}" for kind, edge in boxes for code in codes))
