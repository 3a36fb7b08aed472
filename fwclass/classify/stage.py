"""Classification: the majority vote of the forest, and its share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.classify.vote import count, walkable
from fwclass.errors import InputError
from fwclass.model import Forest, sample_matrix
from fwclass.schema import Table
from fwclass.stage import Params, Stage


class ClassifyParams(Params):
    """Classification has no number of its own: everything comes from the forest."""


def votes(X: NDArray[np.float32], forest: Forest) -> NDArray[np.uint16]:
    """Votes of every tree: uint16 (rows, classes), each row sums to the number of trees.

    X is float32 (rows, features), columns in the order of ``forest.features``; a row with NaN still gets
    votes (NaN goes right at every node). `InputError` if the matrix does not fit the forest or the forest
    is damaged.
    """
    laid_out, X = walkable(forest), np.asarray(X)
    if X.ndim != 2 or X.shape[1] != len(forest.features):
        raise InputError(
            "the samples do not fit the forest",
            expected=f"{len(forest.features)} columns: {', '.join(forest.features)}",
            got=f"shape {X.shape}",
            do="compute the features that the forest was trained with",
        )
    return count(X, laid_out)


def classify(X: NDArray[np.float32] | Table, forest: Forest) -> Table:
    """`classification` (class code with most votes, the first class on a tie) and `confidence` (its share).

    X is a table that has the forest's features (others are ignored; `InputError` naming the one that is
    missing) or a matrix as for `votes`. Every row gets a class.
    """
    forest.check()
    if isinstance(X, Table):
        X = sample_matrix(X, forest.features, "classify")
    counted = votes(X, forest)
    winner = counted.argmax(axis=1)
    top = np.take_along_axis(counted, winner[:, None], axis=1)[:, 0]
    return Table({"classification": forest.codes[winner], "confidence": top / np.float32(forest.trees)})


CLASSIFY = Stage(
    name="classify",
    version=1,
    kind="tile",
    function=classify,
    params=ClassifyParams,
    writes=("classification", "confidence"),
)
