"""Classes, the sample matrix and the trained forest: arrays and a card without code, safe from a stranger."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import ConfigError, InputError
from fwclass.kernel import kernel
from fwclass.schema import Table, require

LEAF = 65535
"""Value of `feature` in a leaf."""

FORMAT = 1
"""Version of the layout below; raised when it changes."""

Tree = tuple[NDArray[np.uint16], NDArray[np.float32], NDArray[np.uint32]]
"""(feature, threshold, child) of one tree, as in `Forest`."""


@dataclass(frozen=True)
class ClassDef:
    """One class of a survey.

    Attributes
    ----------
    name : the word for it in reports.
    code : the ASPRS code that the forest writes.
    codes : the reference codes that count as this class.
    """

    name: str
    code: int
    codes: tuple[int, ...]


def class_index(codes: NDArray[np.uint8], classes: Sequence[ClassDef]) -> NDArray[np.int16]:
    """Index into `classes` of every reference code (any shape); -1 for a code that no class counts.

    `ConfigError` if a code is outside 0..255 or counts as two classes.
    """
    table = np.full(256, -1, np.int16)
    for index, one in enumerate(classes):
        for code in one.codes:
            _claim(table, code, index, classes)
    return table[np.asarray(codes, np.uint8)]


def code_index(codes: NDArray[np.uint8], classes: Sequence[ClassDef]) -> NDArray[np.int16]:
    """Index into `classes` of every code that a prediction holds; -1 for a code that means none of them.

    A class is known by the `code` that the forest writes; another program's prediction may also hold any of
    its reference `codes`, unless that is the `code` of another class.
    """
    table = np.full(256, -1, np.int16)
    for index, one in enumerate(classes):
        _claim(table, one.code, index, classes)
    reference = class_index(np.arange(256, dtype=np.uint8), classes)
    return np.where(table >= 0, table, reference)[np.asarray(codes, np.uint8)]


def _claim(table: NDArray[np.int16], code: int, index: int, classes: Sequence[ClassDef]) -> None:
    if not 0 <= code <= 255:
        raise ConfigError(
            f"class {classes[index].name!r} has an impossible code",
            expected="0 to 255",
            got=code,
            where="classes",
        )
    if table[code] not in (-1, index):
        raise ConfigError(
            f"code {code} stands for two classes",
            where="classes",
            got=f"{classes[table[code]].name!r} and {classes[index].name!r}",
            do="give every code to one class",
        )
    table[code] = index


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


@dataclass(frozen=True, eq=False)
class Forest:
    """Trees as flat arrays.

    Attributes
    ----------
    feature : uint16 (nodes,), column of the sample matrix that a node asks for; `LEAF` in a leaf.
    threshold : float32 (nodes,), a sample goes left where value < threshold, else right (NaN goes right).
    child : uint32 (nodes,), left child, counted from the tree's first node; the right child is the next one.
        Both come after the node itself. In a leaf: the index of the class.
    offsets : int64 (trees + 1,); tree t is nodes ``offsets[t]:offsets[t + 1]``.
    card : plain data for JSON: ``format, features (names in order), classes ([{name, code, codes}]), params,
        samples (rows per class), training (digest of the training rows), fwclass (version)`` and, where
        known, ``eligible, notes, out_of_bag``.
    """

    feature: NDArray[np.uint16]
    threshold: NDArray[np.float32]
    child: NDArray[np.uint32]
    offsets: NDArray[np.int64]
    card: Mapping[str, Any]

    @property
    def features(self) -> tuple[str, ...]:
        return tuple(self.card["features"])

    @property
    def codes(self) -> NDArray[np.uint8]:
        """ASPRS class code of every class, in the order of the votes."""
        return np.array([c["code"] for c in self.card["classes"]], np.uint8)

    @property
    def trees(self) -> int:
        return len(self.offsets) - 1

    def check(self, where: object = "model") -> None:
        """`InputError` unless every walk through every tree ends in a leaf of a known class.

        A model comes from outside: its indices are followed by compiled code without bounds.
        """
        fault = self._card_fault() or self._shape_fault() or self._node_fault()
        if fault:
            raise InputError(f"the model is damaged: {fault}", where=where, do="train it again, or fetch a whole copy")

    def _card_fault(self) -> str:
        try:
            if self.card["format"] != FORMAT:
                return f"its layout is {self.card['format']!r}, this program reads {FORMAT}"
            if not 1 <= len(self.features) < LEAF or not all(isinstance(n, str) for n in self.features):
                return f"its card names {len(self.features)} features"
            if not 1 <= len(self.codes) <= 256:
                return f"its card names {len(self.codes)} classes"
        except (KeyError, TypeError, ValueError, OverflowError) as fault:
            return f"its card cannot be read ({type(fault).__name__}: {fault})"
        return ""

    def _shape_fault(self) -> str:
        for name, dtype in (("feature", "u2"), ("threshold", "f4"), ("child", "u4"), ("offsets", "i8")):
            array = getattr(self, name)
            if array.dtype != np.dtype(dtype) or array.ndim != 1:
                return f"array {name!r} is {array.dtype} of shape {array.shape}, not one row of {dtype}"
        nodes = len(self.feature)
        if not len(self.threshold) == len(self.child) == nodes:
            return f"{nodes} features, {len(self.threshold)} thresholds and {len(self.child)} children"
        o = self.offsets
        if not 2 <= len(o) <= 65536:
            return f"it has {len(o) - 1} trees"
        if o[0] != 0 or o[-1] != nodes or (np.diff(o) < 1).any():
            return f"its trees do not fill its {nodes} nodes"
        return ""

    def _node_fault(self) -> str:
        fault = _first_fault(self.feature, self.child, self.offsets, len(self.features), len(self.codes))
        return _NODE_FAULTS[fault]


_NODE_FAULTS = (
    "",
    "a node asks for a feature that the card does not name",
    "a leaf gives a class that the card does not name",
    "a node's children do not come after it in its tree",
)


@kernel
def _first_fault(feature, child, offsets, n_features, n_classes):  # type: ignore[no-untyped-def]
    """Index into `_NODE_FAULTS`."""
    for t in range(len(offsets) - 1):
        first, size = offsets[t], offsets[t + 1] - offsets[t]
        for k in range(size):
            f, c = feature[first + k], np.int64(child[first + k])
            if f == LEAF:
                if c >= n_classes:
                    return 2
            elif f >= n_features:
                return 1
            elif c <= k or c + 1 >= size:
                return 3
    return 0


def assemble(trees: Iterable[Tree], card: Mapping[str, Any]) -> Forest:
    """Forest of `trees` in the given order."""
    parts = list(trees)
    if not parts:
        raise ValueError("a forest needs a tree")
    offsets = np.zeros(len(parts) + 1, np.int64)
    np.cumsum([len(p[0]) for p in parts], out=offsets[1:])
    forest = Forest(
        np.concatenate([p[0] for p in parts]),
        np.concatenate([p[1] for p in parts]),
        np.concatenate([p[2] for p in parts]),
        offsets,
        dict(card),
    )
    forest.check("newly grown trees")
    return forest
