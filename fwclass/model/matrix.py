"""The sample matrix that every model decides by."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from fwclass.schema import Table, require


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
