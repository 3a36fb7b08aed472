"""What every trained model is: arrays and a card of plain data, checked before anything follows them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fwclass.classes import MOST_LETTERS, ClassDef
from fwclass.errors import InputError, visible
from fwclass.schema import Table, require

LEAF = 65535
"""Value of `feature` in a leaf; no model has so many features."""

LARGEST = 1e100
"""What a model's numbers may be at most: of float32 samples no sum of products with them is infinite."""

FORMAT = 2
"""Version of the layout of models; raised when it changes."""


class Model:
    """A trained model: the arrays that `layout` names, and its card.

    Attributes
    ----------
    kind : what it is, as the card's ``kind`` says.
    layout : dtype and dimensions of every array, by name.
    card : plain data for JSON: ``format, kind, features (names in order), classes (`ClassDef.plain`), params,
        samples (rows per class), training (digest of the training rows), fwclass (version)``; as written, ``digest``
        (of the arrays and of what in the card decides); and, where known,
        ``computed (parameters that its features were computed with), eligible, notes, out_of_bag`` and what a kind
        has besides.
    """

    kind: ClassVar[str]
    layout: ClassVar[Mapping[str, tuple[str, int]]]
    card: Mapping[str, Any]

    @property
    def features(self) -> tuple[str, ...]:
        """Names of the columns of the sample matrix, in their order."""
        return tuple(self.card["features"])

    @property
    def deciding(self) -> tuple[str, ...]:
        """Names of all that it is asked with: the features, and with context the neighbours' shares."""
        return self.features

    @property
    def codes(self) -> NDArray[np.uint8]:
        """uint8 (classes,): ASPRS class code of every class, in the order of the shares."""
        return np.array([c["code"] for c in self.card["classes"]], np.uint8)

    @property
    def classes(self) -> tuple[ClassDef, ...]:
        """The classes that it was trained for."""
        return tuple(ClassDef.of(c) for c in self.card["classes"])

    def check(self, where: object = "model") -> None:
        """`InputError` unless every array has its layout and whatever follows it stays inside.

        A model comes from outside: its indices are followed by compiled code without bounds.
        """
        fault = self._card_fault() or self._array_fault() or self._fault()
        if fault:
            raise InputError(f"the model is damaged: {fault}", where=where, do="train it again, or fetch a whole copy")

    def _card_fault(self) -> str:
        try:
            if self.card["format"] != FORMAT:
                return f"its layout is {self.card['format']!r}, this program reads {FORMAT}"
            if self.card.get("kind", self.kind) != self.kind:
                return f"its card says that it is {self.card['kind']!r}, not {self.kind!r}"
            if not 1 <= len(self.features) < LEAF or not all(isinstance(n, str) for n in self.features):
                return f"its card names {len(self.features)} features"
            if not 1 <= len(self.codes) <= 256 or len(self.classes) != len(self.codes):
                return f"its card names {len(self.codes)} classes"
            numbers = [code for c in self.classes for code in (c.code, *c.codes)]
            if any(type(code) is not int for code in numbers):
                return "its card names class codes that are no whole numbers"
            if not isinstance(self.card.get("computed", {}), Mapping):
                return "its card does not say how its features were computed"
            if any(visible(c.name) != c.name or len(c.name) > MOST_LETTERS for c in self.classes):
                return "its card names a class by characters that cannot be seen, or by too many"
            if any(c.legacy_code is not None and not 0 <= c.legacy_code < 32 for c in self.classes):
                return "its card names a legacy code beyond 31"
        except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as fault:
            return f"its card cannot be read ({type(fault).__name__}: {fault})"
        return ""

    def _array_fault(self) -> str:
        for name, (dtype, dimensions) in self.layout.items():
            array = getattr(self, name)
            if array.dtype != np.dtype(dtype) or array.ndim != dimensions:
                return f"array {name!r} is {array.dtype} of shape {array.shape}, not {dtype} of {dimensions} dimensions"
        return ""

    def _fault(self) -> str:
        """What is wrong beyond card and layout; "" if nothing is."""
        raise NotImplementedError


def bounded(array: NDArray[np.float64]) -> bool:
    """Whether no value of `array` is NaN or beyond `LARGEST`."""
    return bool((np.abs(array) <= LARGEST).all())


def sample_matrix(features: Table, names: Iterable[str], where: object = "features") -> NDArray[np.float32]:
    """Columns `names` of `features` as float32 (rows, names), in C order; infinite values become NaN.

    `InputError` naming the first column that is missing.
    """
    names = tuple(names)
    require(features, names, where)
    out = np.empty((features.rows, len(names)), np.float32)
    for k, name in enumerate(names):
        out[:, k] = features[name]
    out[np.isinf(out)] = np.nan
    return out
