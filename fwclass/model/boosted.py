"""Boosted trees: every tree adds to the score of one class."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fwclass.model.base import LARGEST, Model, bounded
from fwclass.model.trees import node_fault, offsets_fault, threshold_fault


@dataclass(frozen=True, eq=False)
class Boosted(Model):
    """Trees as flat arrays, in the order they were grown.

    With three classes or more there is one score per class and the probabilities are its softmax; with two there is
    one score, the logit of the second class. Tree t adds to score ``t % scores``.

    Attributes
    ----------
    feature, child, offsets : as in `Forest`; `child` is 0 in a leaf.
    threshold : float32 (nodes,), a sample goes left where value < threshold, else right.
    missing_left : uint8 (nodes,), 1 where a sample without a value (NaN) goes left, else 0.
    value : float64 (nodes,), what a leaf adds to the score; 0 elsewhere.
    baseline : float64 (scores,), what the scores begin with.
    card : see `Model`.
    """

    kind = "boosting"
    layout: ClassVar[Mapping[str, tuple[str, int]]] = {
        "feature": ("u2", 1),
        "threshold": ("f4", 1),
        "child": ("u4", 1),
        "missing_left": ("u1", 1),
        "value": ("f8", 1),
        "offsets": ("i8", 1),
        "baseline": ("f8", 1),
    }

    feature: NDArray[np.uint16]
    threshold: NDArray[np.float32]
    child: NDArray[np.uint32]
    missing_left: NDArray[np.uint8]
    value: NDArray[np.float64]
    offsets: NDArray[np.int64]
    baseline: NDArray[np.float64]
    card: Mapping[str, Any]

    @property
    def trees(self) -> int:
        """Number of trees."""
        return len(self.offsets) - 1

    def _fault(self) -> str:
        nodes, scores = len(self.feature), scores_of(len(self.codes))
        for name in ("threshold", "child", "missing_left", "value"):
            if len(getattr(self, name)) != nodes:
                return f"array {name!r} has {len(getattr(self, name))} values for {nodes} nodes"
        if len(self.baseline) != scores or not bounded(self.baseline) or not bounded(self.value):
            return f"its scores are not {scores} numbers up to {LARGEST:g}"
        fault = offsets_fault(self.offsets, nodes)
        if not fault and self.trees % scores:
            fault = f"its {self.trees} trees do not share out among {scores} scores"
        return (
            fault
            or node_fault(self.feature, self.child, self.offsets, len(self.features), 1)
            or threshold_fault(self.feature, self.threshold)
        )


def scores_of(classes: int) -> int:
    """Scores that tell so many classes apart: one for two classes, else one each."""
    return 1 if classes == 2 else classes
