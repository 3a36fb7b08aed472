"""What models of two layers share: two models of other kinds, each with arrays and a card of its own."""

from __future__ import annotations

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
