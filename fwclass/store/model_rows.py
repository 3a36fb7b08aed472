"""The rows that a model has learned from, kept beside it for models that learn further from them.

A model that decides in context keeps with them what its second layer has learned from.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.model import Contextual, Model
from fwclass.store.atomic import digest_of, file_digest
from fwclass.store.models import check_same, load_array, load_model, model_digest

ROWS, ROWS_DIGEST = "rows", "rows_digest"
_VALUES, _CODES, _CONTEXT = "X", "codes", "context"
_LAYOUT = {_VALUES: ("<f4", 2), _CODES: ("|u1", 1), _CONTEXT: ("|u1", 2)}


@dataclass(frozen=True)
class ModelRows:
    """Attributes
    ----------
    X : float32 (rows, features), in the order of the model's.
    codes : uint8 (rows,), class codes.
    context : uint8 (rows, context), `classify.context.context_of` [1/255]; (rows, 0) of a model that decides without.
    """

    X: NDArray[np.float32]
    codes: NDArray[np.uint8]
    context: NDArray[np.uint8]


def save_rows(directory: Path, rows: ModelRows) -> None:
    """Write training rows beside the model in `directory`."""
    target = directory / ROWS
    target.mkdir()
    arrays = {_VALUES: rows.X, _CODES: rows.codes} | ({_CONTEXT: rows.context} if rows.context.shape[1] else {})
    for name, array in arrays.items():
        np.save(target / f"{name}.npy", np.ascontiguousarray(array, _LAYOUT[name][0]), allow_pickle=False)


def rows_facts(rows: ModelRows) -> Mapping[str, Any]:
    """How many rows of every class code a model keeps, and the SHA-256 of their values, for its card."""
    sha = hashlib.sha256()
    for name, array in ((_VALUES, rows.X), (_CODES, rows.codes), (_CONTEXT, rows.context)):
        sha.update(f"{name} {array.shape}\n".encode())
        sha.update(np.ascontiguousarray(array, _LAYOUT[name][0]).tobytes())
    return {ROWS: _counts(rows.codes), ROWS_DIGEST: sha.hexdigest()}


def _counts(codes: NDArray[np.uint8]) -> dict[str, int]:
    return {str(c): int(n) for c, n in zip(*np.unique(codes, return_counts=True), strict=True)}


def load_rows(directory: Path) -> tuple[Model, ModelRows]:
    """A model and the rows that it keeps.

    `InputError`: it is no model, it keeps none, or they do not fit its card (which may be without their digest).
    """
    model = load_model(directory)
    _require_rows(directory, model.card)
    names = _names(model)
    try:
        arrays = {n: load_array(directory / ROWS / f"{n}.npy", *_LAYOUT[n]) for n in names}
    except (OSError, ValueError) as fault:
        gone = isinstance(fault, FileNotFoundError)
        raise InputError(
            f"the rows that a model keeps are {'not there' if gone else 'damaged'}",
            where=directory / ROWS,
            expected=" and ".join(f"{n}.npy" for n in names),
            got=f"{type(fault).__name__}: {fault}",
            do="copy the whole model directory, or train it again",
        ) from fault
    X, codes = arrays[_VALUES], arrays[_CODES]
    context = arrays.get(_CONTEXT, np.empty((len(codes), 0), np.uint8))
    features = len(model.deciding) if isinstance(model, Contextual) else len(model.features)
    fits = X.shape == (len(codes), len(model.features)) and context.shape == (len(codes), features - X.shape[1])
    rows = ModelRows(X, codes, context)
    facts = rows_facts(rows)
    wanted, has = "", ""
    if not fits or facts[ROWS] != model.card[ROWS]:
        wanted = f"{_listed(model.card[ROWS])} of {features} features"
        has = f"{_listed(facts[ROWS])} of {X.shape[1]} features and {context.shape[1]} of context, {X.shape[0]} rows"
    elif facts[ROWS_DIGEST] != model.card.get(ROWS_DIGEST, facts[ROWS_DIGEST]):
        wanted, has = f"values of the digest that its card has, {model.card[ROWS_DIGEST]}", facts[ROWS_DIGEST]
    elif np.isinf(X).any():
        wanted, has = "finite values, or none (NaN)", "an infinite one"
    if wanted:
        raise InputError(
            "the rows that a model keeps do not fit its card",
            where=directory / ROWS,
            expected=wanted,
            got=has,
            do="copy the whole model directory, or train it again",
        )
    return model, rows


def load_same_rows(directory: Path, digest: str) -> tuple[Model, ModelRows]:
    """As `load_rows`, of a model that has this `rows_digest` before and after; `InputError` for another."""
    check_same(directory, rows_digest(directory), digest)
    loaded = load_rows(directory)
    check_same(directory, rows_digest(directory), digest)
    return loaded


def _listed(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{n} rows of code {code}" for code, n in counts.items()) or "no row"


def rows_digest(directory: Path) -> str:
    """Digest of a model's files and of the rows that it keeps."""
    names = _names(load_model(directory))
    if not all((directory / ROWS / f"{n}.npy").is_file() for n in names):
        load_rows(directory)  # tells what is wrong
    return digest_of([model_digest(directory), *(file_digest(directory / ROWS / f"{n}.npy") for n in names)])


def _names(model: Model) -> tuple[str, ...]:
    return (_VALUES, _CODES, *((_CONTEXT,) if isinstance(model, Contextual) else ()))


def _require_rows(directory: Path, card: Mapping[str, Any]) -> None:
    kept = card.get(ROWS)
    if not isinstance(kept, Mapping) or not all(isinstance(n, int) for n in kept.values()):
        raise InputError(
            "this model keeps none of the rows that it has learned from",
            where=directory,
            expected="a model that `fwclass train --keep-rows` wrote",
            do="train it so, name another, or give it as survey.model, which classifies and learns nothing",
        )
