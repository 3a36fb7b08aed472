"""The rows that train: of every class those with the smallest hashes, so tiling cannot change the choice."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fwclass.classes import counterparts
from fwclass.errors import InputError
from fwclass.hashing import hash_keys
from fwclass.model import ClassDef, class_index, sample_matrix
from fwclass.schema import Table

FIRST_BASE_KEY = 1 << 63
"""Keys of a base model's rows begin here; those of a survey's echoes are smaller (`schema.canonical_key`)."""

FIRST = np.uint64(1 << 32)
"""Hashes below are of rows that are corrected."""

_ARRAYS = ("X", "y", "key", "hash", "eligible", "bare", "place")


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
    bare : int64 (classes,), labelled rows without any feature value, which never train; empty where not counted.
    place : int64 (rows, 2), x and y in whole millimetres; (0, 2) where not known.
    """

    features: tuple[str, ...]
    X: NDArray[np.float32]
    y: NDArray[np.uint8]
    key: NDArray[np.uint64]
    hash: NDArray[np.uint64]
    eligible: NDArray[np.int64]
    bare: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    place: NDArray[np.int64] = field(default_factory=lambda: np.empty((0, 2), np.int64))

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.y)

    @property
    def counts(self) -> NDArray[np.int64]:
        """int64 (classes,), rows of every class."""
        return np.bincount(self.y, minlength=len(self.eligible)).astype(np.int64)

    @property
    def digest(self) -> str:
        """SHA-256 of the names, keys, classes and values of the rows; where they lie follows from the keys."""
        sha = hashlib.sha256("\n".join(self.features).encode())
        for array in (self.key, self.y, self.X):
            sha.update(np.ascontiguousarray(array).astype(array.dtype.newbyteorder("<")).tobytes())
        return sha.hexdigest()

    def arrays(self) -> dict[str, NDArray]:
        """The arrays (rows, …) that a store keeps; `from_arrays` makes the sample again."""
        return {n: getattr(self, n) for n in _ARRAYS}

    @classmethod
    def from_arrays(cls, features: Sequence[str], arrays: Mapping[str, NDArray]) -> Sample:
        """The sample whose `arrays` (rows, …) these are."""
        return cls(tuple(features), *(arrays[n] for n in _ARRAYS))

    def without_values(self) -> Sample:
        """The same rows by their keys alone: values and places are where they were drawn from."""
        return replace(self, features=(), X=self.X[:, :0], place=self.place[:0])

    def take(self, rows: NDArray) -> Sample:
        """The same sample with only `rows`, int64 (some,) or bool (rows,)."""
        drawn = (self.X[rows], self.y[rows], self.key[rows], self.hash[rows])
        place = self.place[rows] if len(self.place) else self.place
        return Sample(self.features, *drawn, self.eligible, self.bare, place)


def draw(
    features: Table,
    reference: NDArray[np.uint8],
    key: NDArray[np.uint64],
    inside: NDArray[np.bool_],
    classes: Sequence[ClassDef],
    per_class: int,
    seed: int,
    place: NDArray[np.int64] | None = None,
    first: NDArray[np.bool_] | None = None,
) -> Sample:
    """Of every class the `per_class` labelled rows inside the training areas with the smallest hashes.

    Rows whose code no class counts, and rows without any feature value, never train. `first`: bool (rows,), rows whose
    hashes are made smaller than `FIRST`, as of others one in 2^32 is; of both kinds `per_class` are drawn.
    """
    index = class_index(reference, classes)
    names = tuple(features)
    rows = np.flatnonzero(np.asarray(inside, bool) & (index >= 0))
    some = np.zeros(len(rows), bool)
    for name in names:  # a matrix of all rows is never made: only of those that are kept
        some |= np.isfinite(np.asarray(features[name])[rows])
    bare = np.bincount(index[rows[~some]], minlength=len(classes)).astype(np.int64)
    rows = rows[some]
    y = index[rows].astype(np.uint8)
    eligible = np.bincount(y, minlength=len(classes)).astype(np.int64)
    key = np.asarray(key, np.uint64)[rows]
    drawn = hash_keys(seed, key)
    if first is not None:
        drawn = np.where(first[rows], drawn >> np.uint64(32), drawn)
    smallest = _smallest_of_both(y, drawn, len(classes), per_class)
    X = sample_matrix(features.take(rows[smallest]), names, "training rows")
    there = np.empty((0, 2), np.int64) if place is None else place[rows[smallest]]
    return _sort(Sample(names, X, y[smallest], key[smallest], drawn[smallest], eligible, bare, there))


def kept_sample(
    features: Sequence[str],
    X: NDArray[np.float32],
    codes: NDArray[np.uint8],
    theirs: Sequence[ClassDef],
    classes: Sequence[ClassDef],
    seed: int,
) -> Sample:
    """The rows that a model of classes `theirs` keeps, X (rows, features) and its codes (rows,), as a sample beside a
    survey's own: those that mean one of `classes` (`counterparts`), by keys that no echo has, at no place."""
    means = np.full(256, -1, np.int64)
    means[[one.code for one in theirs]] = counterparts(theirs, classes)
    rows = np.flatnonzero(means[codes] >= 0)
    key = rows.astype(np.uint64) + np.uint64(FIRST_BASE_KEY)
    none = np.zeros(len(classes), np.int64)
    own, drawn = means[codes[rows]].astype(np.uint8), hash_keys(seed, key)
    return Sample(tuple(features), X[rows], own, key, drawn, none, none, np.zeros((len(rows), 2), np.int64))


def join(samples: Iterable[Sample], per_class: int, first_share: float = 1.0) -> Sample:
    """One sample of the union of the rows that `samples` were drawn from, whatever their order or number.

    Of every class at most `per_class` rows (rows,); those that were drawn `first` are at most the share `first_share`
    of them, and more where others do not suffice. `ValueError` where there is no sample, or they have other features.
    """
    parts: list[Sample] = []
    rows = 0
    for part in samples:
        if parts and (part.features != parts[0].features or len(part.eligible) != len(parts[0].eligible)):
            raise ValueError(f"samples differ: {parts[0].features} and {part.features}")
        parts.append(part)
        rows += part.rows
        if rows > 6 * per_class * len(part.eligible):  # memory stays that of a few samples, however many tiles
            whole = _union(parts)
            parts = [whole.take(_smallest_of_both(whole.y, whole.hash, len(whole.eligible), per_class))]
            rows = parts[0].rows
    if not parts:
        raise ValueError("nothing to merge")
    whole = _union(parts)
    keep = []
    for y in range(len(whole.eligible)):
        rows_of = [np.flatnonzero((whole.y == y) & first) for first in (whole.hash < FIRST, whole.hash >= FIRST)]
        most = max(round(first_share * per_class), per_class - len(rows_of[1]))
        firsts = _smallest(rows_of[0], whole.hash, most)
        keep += [firsts, _smallest(rows_of[1], whole.hash, per_class - len(firsts))]
    return _sort(whole.take(np.concatenate(keep)))


def _union(parts: Sequence[Sample]) -> Sample:
    return Sample(
        parts[0].features,
        np.concatenate([p.X for p in parts]),
        np.concatenate([p.y for p in parts]),
        np.concatenate([p.key for p in parts]),
        np.concatenate([p.hash for p in parts]),
        np.sum([p.eligible for p in parts], axis=0),
        np.sum([p.bare for p in parts], axis=0),
        np.concatenate([p.place for p in parts]),
    )


def _smallest_of_both(
    y: NDArray[np.uint8], drawn: NDArray[np.uint64], n_classes: int, per_class: int
) -> NDArray[np.int64]:
    """Index of the `per_class` rows of every class with the smallest random numbers, of those below `FIRST` and of
    others."""
    below = drawn < FIRST
    kinds = [np.flatnonzero((y == c) & kind) for c in range(n_classes) for kind in (below, ~below)]
    return np.concatenate([_smallest(rows, drawn, per_class) for rows in kinds])


def _smallest(rows: NDArray[np.int64], drawn: NDArray[np.uint64], most: int) -> NDArray[np.int64]:
    """Of `rows` the `most` with the smallest random numbers."""
    return rows if len(rows) <= most else rows[np.argpartition(drawn[rows], max(most - 1, 0))[:most]]


def thin(sample: Sample, per_class: int) -> Sample:
    """Of every class the `per_class` rows with the smallest hashes, in the order of their keys."""
    return join((sample,), per_class)


def _sort(sample: Sample) -> Sample:
    """The sample in the order of its keys."""
    order = np.argsort(sample.key, kind="stable")
    key = sample.key[order]
    if (key[1:] == key[:-1]).any():
        raise ValueError("an echo occurs twice in the training rows; only core rows of a tile may train")
    return sample.take(order)


UNEVEN = 20
"""Remarked: a class with so many times the training rows of another."""

ONE_PLACE = 1000
"""Millimetres: a class whose rows lie closer together has been seen once."""


TELLING = 0.5
"""Difference of the shares of rows without a value, of two classes, from which it is said."""


def check_counts(counts: Mapping[str, int]) -> None:
    """`InputError` where a class, by its name, has no training rows."""
    if lacking := [name for name, n in counts.items() if n == 0]:
        raise InputError(
            f"no training rows of class {', '.join(map(repr, lacking))}",
            where="training areas",
            expected="labelled echoes of every class",
            got=", ".join(f"{name} {n}" for name, n in counts.items()),
            do="label some in the training areas, check the class's reference codes, or take the class out",
        )


def review(sample: Sample, classes: Sequence[ClassDef]) -> tuple[str, ...]:
    """Remarks on a merged sample, for the user; `InputError` where a forest cannot be trained on it."""
    counts = {one.name: int(n) for one, n in zip(classes, sample.counts, strict=True)}
    if lacking := [name for name, n in counts.items() if n == 0]:
        _check_values(sample, lacking, classes)
    check_counts(counts)
    if len(counts) < 2:
        raise InputError(
            "a forest tells classes apart, and there is only one",
            where="classes",
            got=", ".join(f"{name} {n}" for name, n in counts.items()),
            do="add a class",
        )
    notes = [f"class {name!r} has one training row" for name, n in counts.items() if n == 1]
    notes += _balance(sample, counts)
    missing: NDArray[np.bool_] = np.isnan(sample.X)
    some_missing = np.any(missing, axis=0).tolist()
    least, greatest = np.fmin.reduce(sample.X, axis=0), np.fmax.reduce(sample.X, axis=0)  # NaN for no value at all
    for k, name in enumerate(sample.features):
        if np.isnan(least[k]):
            raise InputError(
                f"feature {name!r} has no value in any training row",
                where="training areas",
                got=f"{sample.rows} rows without value",
                do=f"take {name!r} out of survey.features, or see why the stage that computes it found nothing",
            )
        if least[k] == greatest[k]:
            notes.append(f"feature {name!r} is {least[k]:g} in every training row that has it")
        if some_missing[k]:
            notes += _missing_tells(name, missing[:, k], sample.y, classes)
    return tuple(notes)


def _missing_tells(
    name: str, missing: NDArray[np.bool_], y: NDArray[np.uint8], classes: Sequence[ClassDef]
) -> list[str]:
    """That a value is missing in one class and not in another, so that its absence tells them apart."""
    rows = np.bincount(y, minlength=len(classes))
    share = np.bincount(y, missing, minlength=len(classes)) / np.maximum(rows, 1)
    share = np.where(rows > 0, share, np.nan)
    most, least = int(np.nanargmax(share)), int(np.nanargmin(share))
    if share[most] - share[least] < TELLING:
        return []
    return [
        f"feature {name!r} has no value in {100 * share[most]:.0f} % of the rows of {classes[most].name}, and in "
        f"{100 * share[least]:.0f} % of {classes[least].name}: its absence tells them apart; is that so elsewhere?"
    ]


def _check_values(sample: Sample, lacking: Sequence[str], classes: Sequence[ClassDef]) -> None:
    """`InputError` where a class has labelled rows, and only features without a value keep them from training."""
    bare = {one.name: int(n) for one, n in zip(classes, sample.bare, strict=False) if n and one.name in lacking}
    if len(bare) < len(lacking):
        return
    one = len(sample.features) == 1
    what = f"feature {sample.features[0]!r} has" if one else "the features have"
    raise InputError(
        f"{what} no value in any labelled row of class {', '.join(map(repr, bare))}",
        where="training areas",
        expected="a value of " + ("it" if one else f"one of {', '.join(sample.features)}"),
        got=", ".join(f"{name} {n} rows without value" for name, n in bare.items()),
        do="take other features (survey.features), or see why the stage that computes them found nothing",
    )


def _balance(sample: Sample, counts: Mapping[str, int]) -> list[str]:
    """Remarks on classes of which only some rows train, on uneven ones, and on those of one place."""
    notes = [
        f"class {name!r}: {n:,} of {int(eligible):,} labelled rows train (train.samples_per_class)"
        for (name, n), eligible in zip(counts.items(), sample.eligible, strict=True)
        if n < eligible
    ]
    most, least = max(counts, key=lambda c: counts[c]), min(counts, key=lambda c: counts[c])
    if counts[most] > UNEVEN * counts[least]:
        notes.append(
            f"class {most!r} has {counts[most]} training rows and {least!r} {counts[least]}: the classifier will "
            f"rarely say {least!r}; train.class_weights: balanced gives both the same say, more labels are better"
        )
    for k, name in enumerate(counts):
        place = sample.place[sample.y == k] if len(sample.place) else sample.place
        if len(place) > 1 and (np.ptp(place, axis=0) < ONE_PLACE).all():
            notes.append(
                f"class {name!r}: all {counts[name]} training rows lie within {ONE_PLACE / 1000:g} m of each other: it "
                "is learned from one thing alone; label it in other places too"
            )
    return notes
