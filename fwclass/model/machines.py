"""Support vector machines, linear and with Gaussian kernel, and how their samples are prepared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fwclass.model.base import LARGEST, Model, bounded
from fwclass.model.boosted import scores_of


@dataclass(frozen=True)
class Preparation:
    """What becomes of a sample before a machine sees it: gaps are filled, then (value - shift) / scale.

    Attributes
    ----------
    fill : float64 (features,), stands for a missing value (NaN): the median of the training rows.
    shift, scale : float64 (features,).
    """

    fill: NDArray[np.float64]
    shift: NDArray[np.float64]
    scale: NDArray[np.float64]

    def __call__(self, X: NDArray[np.float32]) -> NDArray[np.float64]:
        """(rows, features) as a machine sees them."""
        wide = np.asarray(X, np.float64)
        return (np.where(np.isnan(wide), self.fill, wide) - self.shift) / self.scale

    def plain(self) -> dict[str, list[float]]:
        """``fill``, ``shift``, ``scale`` as lists (features,), for the card."""
        return {n: [float(v) for v in getattr(self, n)] for n in ("fill", "shift", "scale")}


class Machine(Model):
    """A model that needs its samples prepared; the card's ``preparation`` says how."""

    @property
    def preparation(self) -> Preparation:
        """How samples are prepared: arrays float64 (features,) of the card."""
        arrays = self.card["preparation"]
        return Preparation(*(np.array(arrays[n], np.float64) for n in ("fill", "shift", "scale")))

    def _preparation_fault(self) -> str:
        try:
            preparation = self.preparation
        except (KeyError, TypeError, ValueError, OverflowError) as fault:
            return f"its card does not say how samples are prepared ({type(fault).__name__}: {fault})"
        for name in ("fill", "shift", "scale"):
            values = getattr(preparation, name)
            if values.shape != (len(self.features),) or not bounded(values):
                return f"its card's {name!r} is not a number for every feature"
        if (preparation.scale < 1 / LARGEST).any():
            return "its card scales a feature by nothing"
        if len(self.codes) < 2:
            return "it tells only one class"
        return ""


@dataclass(frozen=True, eq=False)
class LinearMachine(Machine):
    """One plane per score: score = weights . sample + bias; the largest score wins.

    With two classes there is one score, positive for the second.

    Attributes
    ----------
    weights : float64 (scores, features).
    bias : float64 (scores,).
    card : see `Model`; ``preparation`` besides.
    """

    kind = "linear-svm"
    layout: ClassVar[Mapping[str, tuple[str, int]]] = {"weights": ("f8", 2), "bias": ("f8", 1)}

    weights: NDArray[np.float64]
    bias: NDArray[np.float64]
    card: Mapping[str, Any]

    def _fault(self) -> str:
        scores = scores_of(len(self.codes))
        if self.weights.shape != (scores, len(self.features)) or self.bias.shape != (scores,):
            return f"its weights have shape {self.weights.shape}, not {(scores, len(self.features))}"
        if not bounded(self.weights) or not bounded(self.bias):
            return f"its weights are no numbers up to {LARGEST:g}"
        return self._preparation_fault()


@dataclass(frozen=True, eq=False)
class KernelMachine(Machine):
    """One machine per pair of classes on a common list of support vectors (libsvm's layout); every pair votes.

    The decision of pair (i, j), i < j, is the sum over the support vectors s of class i of ``dual[j - 1, s] k(s, x)``,
    over those of class j of ``dual[i, s] k(s, x)``, and ``bias`` of the pair, with k = exp(-gamma |s - x|^2); positive
    votes for i, else j.

    Attributes
    ----------
    vectors : float64 (vectors, features), prepared, sorted by class.
    dual : float64 (classes - 1, vectors).
    bias : float64 (pairs,), pairs in the order (0, 1), (0, 2), ... (1, 2), ...
    counts : int64 (classes,), support vectors of every class.
    gamma : float64 (1,).
    card : see `Model`; ``preparation`` besides.

    Source: Chang and Lin 2011, LIBSVM.
    """

    kind = "rbf-svm"
    layout: ClassVar[Mapping[str, tuple[str, int]]] = {
        "vectors": ("f8", 2),
        "dual": ("f8", 2),
        "bias": ("f8", 1),
        "counts": ("i8", 1),
        "gamma": ("f8", 1),
    }

    vectors: NDArray[np.float64]
    dual: NDArray[np.float64]
    bias: NDArray[np.float64]
    counts: NDArray[np.int64]
    gamma: NDArray[np.float64]
    card: Mapping[str, Any]

    def _fault(self) -> str:
        n, rows = len(self.codes), len(self.vectors)
        if self.vectors.shape[1] != len(self.features) or self.dual.shape != (n - 1, rows):
            return f"its {rows} support vectors have {self.vectors.shape[1]} features and weights {self.dual.shape}"
        if self.bias.shape != (n * (n - 1) // 2,) or self.counts.shape != (n,):
            return f"it has {len(self.bias)} pairs and {len(self.counts)} counts for {n} classes"
        if (self.counts < 0).any() or (self.counts > rows).any() or self.counts.sum() != rows:
            return f"its counts do not add up to its {rows} support vectors"
        if self.gamma.shape != (1,) or not all(map(bounded, (self.vectors, self.dual, self.bias, self.gamma))):
            return f"its numbers are none up to {LARGEST:g}"
        return "its gamma is negative" if self.gamma[0] < 0 else self._preparation_fault()
