"""The rows that train: of every class those with the smallest hashes, so tiling cannot change the choice."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.hashing import hashed
from fwclass.model import ClassDef, class_index, sample_matrix
from fwclass.schema import Table


@dataclass(frozen=True)
class Sample:
    """Training rows, sorted by key.

    Attributes
    ----------
    features : names of the columns of `X`.
    X : float32 (rows, features), NaN where a feature has no value.
    y : uint8 (rows,), index of the class.
    key : uint64 (rows,), `schema.canonical_key`.
    hash : uint64 (rows,), random number of the key; the smallest of a class are kept.
    eligible : int64 (classes,), labelled rows that the sample was drawn from.
    """

    features: tuple[str, ...]
    X: NDArray[np.float32]
    y: NDArray[np.uint8]
    key: NDArray[np.uint64]
    hash: NDArray[np.uint64]
    eligible: NDArray[np.int64]

    @property
    def rows(self) -> int:
        return len(self.y)

    @property
    def counts(self) -> NDArray[np.int64]:
        """int64 (classes,), rows of every class."""
        return np.bincount(self.y, minlength=len(self.eligible)).astype(np.int64)

    @property
    def digest(self) -> str:
        """SHA-256 of the names, keys, classes and values of the rows."""
        made = hashlib.sha256("\n".join(self.features).encode())
        for array in (self.key, self.y, self.X):
            made.update(np.ascontiguousarray(array).astype(array.dtype.newbyteorder("<")).tobytes())
        return made.hexdigest()

    def arrays(self) -> dict[str, NDArray]:
        """The arrays that a store keeps; `from_arrays` makes the sample again."""
        return {"X": self.X, "y": self.y, "key": self.key, "hash": self.hash, "eligible": self.eligible}

    @classmethod
    def from_arrays(cls, features: Sequence[str], arrays: Mapping[str, NDArray]) -> Sample:
        return cls(tuple(features), *(arrays[n] for n in ("X", "y", "key", "hash", "eligible")))

    def take(self, rows: NDArray) -> Sample:
        """The same sample with only `rows` (index or mask)."""
        return Sample(self.features, self.X[rows], self.y[rows], self.key[rows], self.hash[rows], self.eligible)


def draw(
    features: Table,
    reference: NDArray[np.uint8],
    key: NDArray[np.uint64],
    inside: NDArray[np.bool_],
    classes: Sequence[ClassDef],
    per_class: int,
    seed: int,
) -> Sample:
    """Of every class the `per_class` labelled rows inside the training areas with the smallest hashes.

    Rows whose code no class counts, and rows without any feature value, never train.
    """
    index = class_index(reference, classes)
    rows = np.flatnonzero(np.asarray(inside, bool) & (index >= 0))
    X = sample_matrix(features.take(rows), features, "training rows")
    some = ~np.isnan(X).all(axis=1)
    rows, X = rows[some], X[some]
    y = index[rows].astype(np.uint8)
    eligible = np.bincount(y, minlength=len(classes)).astype(np.int64)
    key = np.asarray(key, np.uint64)[rows]
    return _thinned(Sample(tuple(features), X, y, key, hashed(seed, key), eligible), per_class)


def join(samples: Iterable[Sample], per_class: int) -> Sample:
    """One sample of the union of the rows that `samples` were drawn from, whatever their order or number."""
    parts = list(samples)
    if not parts:
        raise ValueError("nothing to merge")
    for part in parts[1:]:
        if part.features != parts[0].features or len(part.eligible) != len(parts[0].eligible):
            raise ValueError(f"samples differ: {parts[0].features} and {part.features}")
    joined = Sample(
        parts[0].features,
        np.concatenate([p.X for p in parts]),
        np.concatenate([p.y for p in parts]),
        np.concatenate([p.key for p in parts]),
        np.concatenate([p.hash for p in parts]),
        np.sum([p.eligible for p in parts], axis=0),
    )
    return _thinned(joined, per_class)


def _thinned(sample: Sample, per_class: int) -> Sample:
    keep = []
    for c in range(len(sample.eligible)):
        rows = np.flatnonzero(sample.y == c)
        if len(rows) > per_class:
            rows = rows[np.argpartition(sample.hash[rows], per_class - 1)[:per_class]]
        keep.append(rows)
    chosen = np.concatenate(keep)
    chosen = chosen[np.argsort(sample.key[chosen], kind="stable")]
    key = sample.key[chosen]
    if (key[1:] == key[:-1]).any():
        raise ValueError("an echo occurs twice in the training rows; only core rows of a tile may train")
    return sample.take(chosen)


def review(sample: Sample, classes: Sequence[ClassDef]) -> tuple[str, ...]:
    """Remarks on a merged sample, for the user; `InputError` where a forest cannot be trained on it."""
    counts = {one.name: int(n) for one, n in zip(classes, sample.counts, strict=True)}
    listed = ", ".join(f"{name} {n}" for name, n in counts.items())
    lacking = [name for name, n in counts.items() if n == 0]
    if lacking:
        raise InputError(
            f"no training rows of class {', '.join(map(repr, lacking))}",
            where="training areas",
            expected="labelled echoes of every class",
            got=listed,
            do="label some in the training areas, check the class's reference codes, or take the class out",
        )
    if len(counts) < 2:
        raise InputError(
            "a forest tells classes apart, and there is only one",
            where="classes",
            got=listed,
            do="add a class",
        )
    notes = [f"class {name!r} has one training row" for name, n in counts.items() if n == 1]
    for k, name in enumerate(sample.features):
        values = sample.X[:, k]
        known = values[~np.isnan(values)]
        if len(known) == 0:
            raise InputError(
                f"feature {name!r} has no value in any training row",
                where="training areas",
                got=f"{sample.rows} rows without value",
                do=f"take {name!r} out of survey.features, or see why the stage that computes it found nothing",
            )
        if known.min() == known.max():
            notes.append(f"feature {name!r} is {known[0]:g} in every training row that has it")
    return tuple(notes)
