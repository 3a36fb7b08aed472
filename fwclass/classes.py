"""The classes of a survey, and which of them a code means."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import ConfigError, DamagedError

UNCLASSIFIED, GROUND, BUILDING, LOW_NOISE, WATER, HIGH_NOISE = 1, 2, 6, 7, 9, 18
"""Class codes of LAS 1.4 that the program itself gives or looks for."""

NOISE_CODES = (LOW_NOISE, HIGH_NOISE)

PLANTS = (3, 4, 5)
"""Codes of low, medium and high vegetation."""

WIRES = (13, 14)
"""Codes of guard wires and conductors."""

MOST_LETTERS = 100
"""Of a class's name."""

STANDARD: Mapping[int, str] = {
    0: "never classified",
    1: "unclassified",
    2: "ground",
    3: "low vegetation",
    4: "medium vegetation",
    5: "high vegetation",
    6: "building",
    7: "low noise",
    9: "water",
    10: "rail",
    11: "road surface",
    13: "wire guard",
    14: "wire conductor",
    15: "transmission tower",
    16: "wire connector",
    17: "bridge deck",
    18: "high noise",
    19: "overhead structure",
    20: "ignored ground",
    21: "snow",
    22: "temporal exclusion",
}
"""Names of codes in LAS 1.4 R15, table 17."""


def standard_name(code: int) -> str:
    """What the standard calls `code`, or the code itself."""
    return STANDARD.get(code, f"class {code}")


def counts_of(values: Any, shape: tuple[int, ...], what: str) -> NDArray[np.int64]:
    """Stored counts as an array of `shape`, int64; `DamagedError` where they are of another one: `what` was counted for
    other classes or areas than those of the run."""
    try:
        counts = np.array(values, np.int64)
    except (ValueError, OverflowError):  # rows of different lengths
        counts = np.zeros(0, np.int64)
    if counts.shape != shape and counts.size + math.prod(shape):
        raise DamagedError(
            f"{what} do not belong to the classes and areas of the run",
            expected=f"counts of shape {shape}",
            got=f"{counts.shape}",
            do="take another run directory",
        )
    return counts.reshape(shape)


@dataclass(frozen=True)
class ClassDef:
    """One class of a survey.

    Attributes
    ----------
    name : the word for it in reports.
    code : the ASPRS code that the classifier writes.
    codes : the reference codes that count as this class.
    legacy_code : what is written where points cannot hold `code` (LAS point formats 0 to 5); None if nothing is given.
    """

    name: str
    code: int
    codes: tuple[int, ...]
    legacy_code: int | None = None

    def plain(self) -> dict[str, Any]:
        """For the card of a model; `of` makes the class again."""
        facts: dict[str, Any] = {"name": self.name, "code": self.code, "codes": list(self.codes)}
        return facts if self.legacy_code is None else {**facts, "legacy_code": self.legacy_code}

    @classmethod
    def of(cls, card: Mapping[str, Any]) -> ClassDef:
        """The class that a model's card describes; `plain` writes the same."""
        code = card["code"]
        return cls(str(card.get("name", code)), code, tuple(card.get("codes", (code,))), card.get("legacy_code"))


def class_index(codes: NDArray[np.uint8], classes: Sequence[ClassDef]) -> NDArray[np.int16]:
    """Index into `classes` of every reference code (any shape); -1 for a code that no class counts.

    `ConfigError` if a code is outside 0..255 or counts as two classes.
    """
    table = np.full(256, -1, np.int16)
    for index, one in enumerate(classes):
        for code in one.codes:
            _claim(table, code, index, classes)
    return table[np.asarray(codes, np.uint8)]


def code_index(codes: NDArray[np.uint8], classes: Sequence[ClassDef]) -> NDArray[np.int16]:
    """Index into `classes` of every code that a prediction holds; -1 for a code that means none of them.

    A class is known by the `code` that the classifier writes; another program's prediction may also hold any of
    its reference `codes`, unless that is the `code` of another class.
    """
    table = np.full(256, -1, np.int16)
    for index, one in enumerate(classes):
        _claim(table, one.code, index, classes)
    reference = class_index(np.arange(256, dtype=np.uint8), classes)
    return np.where(table >= 0, table, reference)[np.asarray(codes, np.uint8)]


SEVERAL = -2


def counterparts(theirs: Sequence[ClassDef], ours: Sequence[ClassDef]) -> NDArray[np.int16]:
    """int16 (theirs,): of every class of another list, which of `ours` its code and its reference codes mean; -1 where
    none, `SEVERAL` where more than one. Names decide nothing: they are words of any language."""
    index = np.full(len(theirs), -1, np.int16)
    for k, one in enumerate(theirs):
        means = code_index(np.array([one.code, *one.codes], np.uint8), ours)
        several = np.unique(means[means >= 0])
        if len(several):
            index[k] = several[0] if len(several) == 1 else SEVERAL
    return index


def one_to_one(theirs: Sequence[ClassDef], ours: Sequence[ClassDef]) -> bool:
    """Whether every class of the one list means one of the other, and all are meant."""
    return sorted(counterparts(theirs, ours).tolist()) == list(range(len(ours)))


def _claim(table: NDArray[np.int16], code: int, index: int, classes: Sequence[ClassDef]) -> None:
    if not 0 <= code <= 255:
        raise ConfigError(
            f"class {classes[index].name!r} has an impossible code", expected="0 to 255", got=code, where="classes"
        )
    if table[code] not in (-1, index):
        raise ConfigError(
            f"code {code} stands for two classes",
            where="classes",
            got=f"{classes[table[code]].name!r} and {classes[index].name!r}",
            do="give every code to one class",
        )
    table[code] = index
