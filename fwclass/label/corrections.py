"""Labels by echo identity: which echo a label is of, and which labels are of none any more."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import ConfigError
from fwclass.grid import Box, millimetres
from fwclass.model import ClassDef
from fwclass.schema import Table, canonical_key

COLUMNS = ("strip", "pulse", "echo_number", "x", "y", "z", "label_code")
"""A label by echo as a table; those that were taken back are not in it."""


def last_of_each(table: Table) -> Table:
    """The last row of every echo, by echo."""
    key = canonical_key(table)
    order = np.argsort(key, kind="stable")
    last = np.ones(len(key), bool)
    last[:-1] = key[order][1:] != key[order][:-1]
    return table.take(order[last])


def match_labels(echoes: Table, labels: Table, reach: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows of `echoes` that have a label, and the rows of `labels` that are theirs.

    A label is an echo's where strip, pulse and number are the same, and the echo lies at most `reach` [m] from where it
    lay when it was labelled: another run of the decomposition may have given the number to another echo.

    Parameters
    ----------
    echoes, labels : strip, pulse, echo_number, x, y, z [m]; at most one row of an echo in `labels`.
    """
    key = canonical_key(labels)
    order = np.argsort(key)
    keys = canonical_key(echoes)
    at = np.searchsorted(key[order], keys)
    at[at == len(key)] = 0
    rows = np.flatnonzero(key[order][at] == keys) if len(key) else np.empty(0, np.int64)
    own = order[at[rows]]
    far = np.zeros(len(rows))
    for axis in "xyz":
        far += (millimetres(echoes[axis][rows]) - millimetres(labels[axis][own])).astype(np.float64) ** 2
    near = far <= round(1000 * reach) ** 2
    return rows[near], own[near]


def far_from_labels(
    x: NDArray[np.float64], y: NDArray[np.float64], labels: Table, gap: float, among: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """bool (rows,): further than `gap` [m] from every label, along x or along y, as a box grown by it; of the rows
    `among` alone, the others are False."""
    far = among.copy()
    rows = np.flatnonzero(among)
    if not len(rows) or not labels.rows or gap <= 0:
        return far
    from scipy.spatial import cKDTree

    places = np.unique(np.stack([millimetres(labels["x"]), millimetres(labels["y"])], axis=1), axis=0)
    asked = np.stack([millimetres(x[rows]), millimetres(y[rows])], axis=1)
    distance, _ = cKDTree(places).query(asked, p=np.inf, distance_upper_bound=1000 * gap + 1)
    far[rows] = distance > 1000 * gap
    return far


def outside(labels: Table, boxes: Sequence[Box]) -> NDArray[np.bool_]:
    """bool (rows,): the label lies in none of `boxes`."""
    inside = np.zeros(labels.rows, bool)
    for box in boxes:
        inside |= box.contains(labels["x"], labels["y"])
    return ~inside


def reference_codes(code: NDArray[np.int16], classes: Sequence[ClassDef], where: object) -> NDArray[np.int16]:
    """int16 (echoes,): delivered class codes `code` (echoes,) as codes of the reference; 0, no class, stays.

    `ConfigError` for codes that no class is delivered as, or counts.
    """
    code_of = {0: 0, **{c: c for one in classes for c in one.codes}}
    code_of |= {c.code: c.code if c.code in c.codes else c.codes[0] for c in classes if c.codes}
    unknown = sorted(set(np.unique(code).tolist()) - code_of.keys())
    if unknown:
        raise ConfigError(
            "corrections have codes that no class of the survey has",
            where=where,
            expected=", ".join(f"{c.code} ({c.name})" for c in classes) + ", or 0 for no class",
            got=", ".join(f"{v} ({int((code == v).sum()):,} rows)" for v in unknown),
            do="add the class to survey.classes, or take these corrections back",
        )
    table = np.zeros(256, np.int16)
    for given, own in code_of.items():
        table[given] = own
    return np.asarray(table[code])
