"""Models of two layers, models of other kinds, each with arrays and a card of its own; and the one whose second layer
answers again where two classes of the first meet."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from fwclass.model.base import Model

LAYERS = ("coarse", "fine")


@dataclass(frozen=True, eq=False)
class Layered(Model):
    """A model of two layers.

    Attributes
    ----------
    coarse, fine : the layers, the first and the second.
    card : the first one's, and besides ``layers`` (digest of each) and what a kind has.
    """

    layout: ClassVar[Mapping[str, tuple[str, int]]] = {}

    coarse: Model
    fine: Model
    card: Mapping[str, Any]

    def check(self, where: object = "model") -> None:
        """`InputError` unless both layers are sound and fit together."""
        self.coarse.check(where)
        self.fine.check(where)
        super().check(where)

    def _fault(self) -> str:
        if isinstance(self.coarse, Layered) or isinstance(self.fine, Layered):
            return "a layer has layers of its own"
        if self.features != self.coarse.features or self.classes != self.coarse.classes:
            return "its card has other features or classes than its first layer"
        return self._layer_fault()

    def _layer_fault(self) -> str:
        """What is wrong between the layers; "" if nothing is."""
        raise NotImplementedError


class TwoLayer(Layered):
    """`fine` tells the two classes between which it decides, and nothing else.

    The card has besides ``refine`` (what `RefineParams` says).
    """

    kind = "two-layer"

    @property
    def pair(self) -> tuple[int, int]:
        """Class codes of the two classes."""
        a, b = (int(c) for c in self.fine.codes)
        return a, b

    @property
    def within(self) -> float:
        """An echo is at the boundary if the other class is as near as this [m]."""
        return float(self.card["refine"]["within"])

    @property
    def wide(self) -> tuple[str, ...]:
        """Features of the second layer that the first one lacks."""
        return tuple(n for n in self.fine.features if n not in self.coarse.features)

    def _layer_fault(self) -> str:
        unknown = [c.name for c in self.fine.classes if c not in self.coarse.classes]
        if unknown or len(self.fine.codes) != 2:
            names = ", ".join(unknown or (c.name for c in self.fine.classes))
            return f"its second layer decides between two classes of the first, and names {names}"
        try:
            within = self.within
        except (KeyError, TypeError, ValueError, OverflowError) as fault:
            return f"its card does not say how near a boundary is ({type(fault).__name__}: {fault})"
        return "" if math.isfinite(within) and 0 < within <= 100 else f"a boundary within {within} m is none"
