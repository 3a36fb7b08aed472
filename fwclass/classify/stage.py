"""Classification: what a model says of every row, how sure it is, and how the classes share it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from fwclass.classify.shares import answer, entropy, fitting
from fwclass.classify.vote import count, walkable
from fwclass.model import Forest, Machine, Model, sample_matrix
from fwclass.schema import Table
from fwclass.stage import Computation


def votes(X: NDArray[np.float32], forest: Forest) -> NDArray[np.uint16]:
    """Votes of every tree: uint16 (rows, classes), each row sums to the number of trees.

    X is float32 (rows, features), columns in the order of ``forest.features``; a row with NaN still gets
    votes (NaN goes right at every node). `InputError` if the matrix does not fit the forest or the forest
    is damaged.
    """
    laid_out = walkable(forest)
    return count(fitting(X, forest), laid_out)


def classify(X: NDArray[np.float32] | Table, model: Model, probabilities: bool = False) -> Table:
    """Class, confidence and entropy of every row, and with `probabilities` the share of every class.

    X is a table that has the model's features (others are ignored; `InputError` naming the one that is
    missing) or a matrix (rows, features). Every row gets a class; what a missing value (NaN) does is the model's:
    in a forest it goes right at every node, in boosting to the side learned, a machine takes the median of its
    training rows for it (`count_filled` counts them).

    Returns
    -------
    Table with ``classification`` (class code), ``confidence`` (share of that class), ``entropy`` (of the shares, 0 to
    1) and ``probability_<code>`` where asked; shares as in `answer`.
    """
    if isinstance(X, Table):
        X = sample_matrix(X, model.features, "classify")
    winner, shares = answer(X, model)
    columns: dict[str, NDArray] = {
        "classification": model.codes[winner],
        "confidence": np.take_along_axis(shares, winner[:, None], axis=1)[:, 0],
        "entropy": entropy(shares),
    }
    if probabilities:
        columns |= {name: shares[:, k] for k, name in enumerate(probability_columns(model.codes))}
    return Table(columns)


def probability_columns(codes: Iterable[int]) -> tuple[str, ...]:
    """Names of the columns with the share of every class."""
    return tuple(f"probability_{int(code)}" for code in codes)


def count_filled(X: NDArray[np.float32], model: Model) -> int:
    """Number of missing values (NaN) in X that the model replaces by what it knows from training."""
    return int(np.isnan(X).sum()) if isinstance(model, Machine) else 0


CLASSIFY = Computation(name="classify", version=3, writes=("classification", "confidence", "entropy"))
