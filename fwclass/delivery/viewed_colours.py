"""Colours that stand for kinds of echoes: their names, and the kind of every echo of a tile."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.delivery.echoes import table_columns
from fwclass.schema import IDENTITY, Table, canonical_key, lie_apart
from fwclass.view.blocks import NO_VALUE

RIGHT, DIFFERS, CORRECTED = "right_or_wrong", "differs", "corrected"

MEANING: Mapping[str, str] = {
    RIGHT: "the delivered class beside the reference's, training areas too",
    DIFFERS: "the class beside that of the same echo in the other run",
    CORRECTED: "echoes that were corrected, and whether this delivery gives them that class by itself",
}

_KINDS: Mapping[str, Sequence[tuple[str, str]]] = {
    RIGHT: (("no reference", "#b8bec3"), ("right", "#2f7d46"), ("wrong", "#c8102e")),
    DIFFERS: (("not in the other run", "#b8bec3"), ("same class", "#7fa7b5"), ("another class", "#c8102e")),
    CORRECTED: (
        ("not corrected", "#b8bec3"),
        ("corrected, delivered as such", "#2f7d46"),
        ("corrected, delivered as another", "#c8102e"),
    ),
}
_STRIPS = ("#009ea3", "#c44e8c", "#f0c43c", "#566ebe", "#8c563c", "#5fa83c", "#e2782a", "#7a4fb0")
"""In turn, then lighter and darker."""


def kinds(part: str, files: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]] | None:
    """Code, name and colour of the kinds that a column has; None for a column of numbers.

    `files`: strip and path of every file of the survey.
    """
    if part == "strip":
        names = {int(f["strip"]): str(f["path"]) for f in files}
        codes = {n: k % NO_VALUE for k, n in enumerate(sorted(names))}  # other numbers are any up to 65 535
        ordered = sorted(names, key=lambda n: (names[n], n))[:NO_VALUE]
        return [_kind(codes[n], names[n], _strip_colour(k)) for k, n in enumerate(ordered)]
    if part not in _KINDS:
        return None
    return [_kind(code, *kind) for code, kind in enumerate(_KINDS[part])]


def compare_classes(tile: Path, others: Iterable[Path]) -> NDArray[np.uint8]:
    """0 for an echo that none of the other run's tiles `others` has, 1 where the classes are the same, 2 where not."""
    columns = (*IDENTITY, *"xyz", "classification")
    mine = table_columns(tile, columns)
    out, who = np.zeros(len(mine["strip"]), np.uint8), identity_keys(mine)
    for other in others:
        theirs = table_columns(other, columns)
        _, here, there = np.intersect1d(who, identity_keys(theirs), assume_unique=True, return_indices=True)
        same = ~lie_apart(mine, here, theirs, there)
        here, there = here[same], there[same]
        out[here] = np.where(mine["classification"][here] == theirs["classification"][there], 1, 2)
    return out


def verdicts(
    given: NDArray[np.uint8], reference: NDArray[Any], classes: Sequence[Mapping[str, Any]]
) -> NDArray[np.uint8]:
    """0 without a reference, 1 right, 2 wrong; of a code that no class counts there is no verdict."""
    counted = np.zeros(256, np.int64)
    for one in classes:
        counted[list(one["codes"])] = one["code"]
    known = counted[reference]
    return np.where(known == 0, 0, np.where(known == given, 1, 2)).astype(np.uint8)


def compare_corrections(
    given: NDArray[np.uint8], shown: NDArray[np.uint8], rows: NDArray[np.int64]
) -> NDArray[np.uint8]:
    """0 for echoes that were not corrected; of `rows`, which were, 1 where that is the delivered class, 2 where not."""
    out = np.zeros(len(given), np.uint8)
    out[rows] = np.where(given[rows] == shown[rows], 1, 2)
    return out


def identity_keys(columns: Mapping[str, NDArray]) -> NDArray[np.uint64]:
    """uint64 (echoes,): a number of its own for every echo, from its columns `IDENTITY`."""
    return canonical_key(Table({n: columns[n] for n in IDENTITY}))


def _strip_colour(number: int) -> str:
    turn, k = divmod(number, len(_STRIPS))
    rgb = [int(_STRIPS[k][at : at + 2], 16) for at in (1, 3, 5)]
    mixed = [(v, (v + 255) // 2, v * 3 // 5)[turn % 3] for v in rgb]
    return "#{:02x}{:02x}{:02x}".format(*mixed)


def _kind(code: int, name: str, colour: str) -> dict[str, Any]:
    return {"code": code, "name": name, "colour": colour}
