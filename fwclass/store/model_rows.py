"""The rows that a model has learned from, kept beside it for models that learn further from them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.model import Model
from fwclass.store.atomic import digest_of, file_digest
from fwclass.store.models import load_array, load_model, model_digest

ROWS = "rows"
_VALUES, _CODES = "X", "codes"
_LAYOUT = {_VALUES: ("<f4", 2), _CODES: ("|u1", 1)}


def save_rows(directory: Path, X: NDArray[np.float32], codes: NDArray[np.uint8]) -> None:
    """Write training rows beside the model in `directory`: X (rows, features), class codes (rows,)."""
    place = directory / ROWS
    place.mkdir()
    for name, array in ((_VALUES, X), (_CODES, codes)):
        np.save(place / f"{name}.npy", np.ascontiguousarray(array, _LAYOUT[name][0]), allow_pickle=False)


def rows_fact(codes: NDArray[np.uint8]) -> Mapping[str, int]:
    """How many rows of every class code a model keeps, for its card."""
    return {str(c): int(n) for c, n in zip(*np.unique(codes, return_counts=True), strict=True)}


def load_rows(directory: Path) -> tuple[Model, NDArray[np.float32], NDArray[np.uint8]]:
    """A model and the rows that it keeps: values (rows, features), class codes (rows,).

    Raises
    ------
    InputError : it is no model, it keeps none, or they do not fit its card.
    """
    model = load_model(directory)
    _require_rows(directory, model.card)
    try:
        arrays = {n: load_array(directory / ROWS / f"{n}.npy", *of) for n, of in _LAYOUT.items()}
    except (OSError, ValueError) as fault:
        raise InputError(
            "the rows that a model keeps are damaged",
            where=directory / ROWS,
            expected=" and ".join(f"{n}.npy" for n in _LAYOUT),
            got=f"{type(fault).__name__}: {fault}",
            do="copy the whole model directory, or train it again",
        ) from fault
    X, codes = arrays[_VALUES], arrays[_CODES]
    if X.shape != (len(codes), len(model.features)) or np.isinf(X).any() or rows_fact(codes) != model.card[ROWS]:
        raise InputError(
            "the rows that a model keeps do not fit its card",
            where=directory / ROWS,
            expected=f"{sum(model.card[ROWS].values())} rows of {len(model.features)} features",
            got=f"{X.shape[0]} rows of {X.shape[1]} features, and {len(codes)} classes",
            do="copy the whole model directory, or train it again",
        )
    return model, X, codes


def rows_digest(directory: Path) -> str:
    """Digest of a model's files and of the rows that it keeps."""
    return digest_of([model_digest(directory), *(file_digest(directory / ROWS / f"{n}.npy") for n in _LAYOUT)])


def _require_rows(directory: Path, card: Mapping[str, Any]) -> None:
    kept = card.get(ROWS)
    if not isinstance(kept, Mapping) or not all(isinstance(n, int) for n in kept.values()):
        raise InputError(
            "this model keeps none of the rows that it has learned from",
            where=directory,
            expected="a model that `fwclass train --keep-rows` wrote",
            do="train it so, name another, or give it as survey.model, which classifies and learns nothing",
        )
