"""The forest: trees that vote."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fwclass.model.base import Model
from fwclass.model.trees import node_fault, offsets_fault, threshold_fault

Tree = tuple[NDArray[np.uint16], NDArray[np.float32], NDArray[np.uint32]]
"""(feature, threshold, child) of one tree, as in `Forest`."""


@dataclass(frozen=True, eq=False)
class Forest(Model):
    """Trees as flat arrays.

    Attributes
    ----------
    feature : uint16 (nodes,), column of the sample matrix that a node asks for; `LEAF` in a leaf.
    threshold : float32 (nodes,), a sample goes left where value < threshold, else right (NaN goes right).
        Infinite where it divides those with a value from those without.
    child : uint32 (nodes,), left child, counted from the tree's first node; the right child is the next one.
        Both come after the node itself. In a leaf: the index of the class.
    offsets : int64 (trees + 1,); tree t is nodes ``offsets[t]:offsets[t + 1]``.
    card : see `Model`.
    """

    kind = "forest"
    layout: ClassVar[Mapping[str, tuple[str, int]]] = {
        "feature": ("u2", 1),
        "threshold": ("f4", 1),
        "child": ("u4", 1),
        "offsets": ("i8", 1),
    }

    feature: NDArray[np.uint16]
    threshold: NDArray[np.float32]
    child: NDArray[np.uint32]
    offsets: NDArray[np.int64]
    card: Mapping[str, Any]

    @property
    def trees(self) -> int:
        """Number of trees."""
        return len(self.offsets) - 1

    def _fault(self) -> str:
        nodes = len(self.feature)
        if not len(self.threshold) == len(self.child) == nodes:
            return f"{nodes} features, {len(self.threshold)} thresholds and {len(self.child)} children"
        return (
            offsets_fault(self.offsets, nodes)
            or node_fault(self.feature, self.child, self.offsets, len(self.features), len(self.codes))
            or threshold_fault(self.feature, self.threshold)
        )


def assemble(trees: Iterable[Tree], card: Mapping[str, Any]) -> Forest:
    """Forest of `trees` in the given order, nodes joined to (nodes,) with offsets; `ValueError` for none."""
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
        {**card, "kind": Forest.kind},
    )
    forest.check("newly grown trees")
    return forest
