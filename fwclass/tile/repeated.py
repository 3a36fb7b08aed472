"""Echoes that stand in the survey twice: files with a common rim, or one file under two names."""

from __future__ import annotations

import numpy as np

from fwclass.grid import millimetres
from fwclass.hashing import mix
from fwclass.schema import Table


def repeats(table: Table) -> list[list[int]]:
    """How many echoes have place (to the millimetre) and GPS time of another, by pairs of strips.

    Parameters
    ----------
    table : x, y, z [m], gps_time [s] (NaN: one that is not known is like another) and strip.

    Returns
    -------
    [strip, strip of the repetition, echoes] in rising order; of n echoes in one place n - 1 are repetitions, in the
    order of their strips.
    """
    key = np.zeros(table.rows, np.uint64)
    time = np.where(np.isfinite(table["gps_time"]), table["gps_time"], -1.0)
    for values in (*(millimetres(table[n]).astype(np.int64) for n in "xyz"), time.astype(np.float64)):
        key = mix(key ^ values.view(np.uint64))
    again = np.sort(key)
    again = again[1:][again[1:] == again[:-1]]
    if not len(again):
        return []
    rows = np.flatnonzero(np.isin(key, again))
    rows = rows[np.lexsort((table["strip"][rows], key[rows]))]
    same = key[rows[1:]] == key[rows[:-1]]
    strips = table["strip"][rows].astype(np.int64)
    first = np.maximum.accumulate(np.where(np.append(False, same), 0, np.arange(len(rows))))
    pairs = np.stack([strips[first[1:]], strips[1:]], axis=1)[same]
    kinds, counts = np.unique(pairs, axis=0, return_counts=True)
    return [[int(a), int(b), int(n)] for (a, b), n in zip(kinds, counts, strict=True)]
