"""Class weights as whole numbers, so that sums of them are exact and do not depend on an order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import ConfigError, nearest

RESOLUTION = 1000
"""What the lightest class weighs; ratios of weights are met to half a part in so many."""

HEAVIEST = (1 << 31) - 1
"""Limit of a tree's total weight: its squares still sum exactly in 64 bits."""


def whole_weights(
    weights: str | Mapping[str, float], counts: NDArray[np.int64], names: Sequence[str]
) -> NDArray[np.int64]:
    """int64 (classes,): a weight for every class, in proportion to what is asked; all 1 where all are equal.

    `weights` is `none`, `balanced` or weights by class name, `counts` the rows of every class in the sample.
    `ConfigError` for an unknown name, or for weights so far apart that whole numbers cannot hold them.
    """
    weight = np.ones(len(counts))
    if weights == "balanced":
        weight = counts.sum() / (max(1, (counts > 0).sum()) * np.maximum(counts, 1))
    elif not isinstance(weights, str):
        for name, value in weights.items():
            if name not in names:
                raise ConfigError(
                    f"no class is called {name!r}",
                    where="train.class_weights",
                    expected=", ".join(names),
                    got=name,
                    do=nearest(name, names),
                )
            weight[list(names).index(name)] = value
    weight = weight / weight.min()
    if (weight == 1).all():
        return np.ones(len(counts), np.int64)
    unit = min(float(RESOLUTION), HEAVIEST / (float(counts @ weight) * 1.01))
    if unit < 1:
        raise ConfigError(
            "the class weights are too far apart for so many rows",
            where="train.class_weights",
            expected=f"rows times weight below {HEAVIEST}, the lightest class weighing 1",
            got=f"{float(counts @ weight):.3g}",
            do="lower train.samples_per_class, or bring the weights together",
        )
    return np.maximum(1, np.rint(np.minimum(weight * unit, HEAVIEST))).astype(np.int64)
