"""Points that a LAS header counts, in all and by return number, against those that there are."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np

MOST = 16
"""Return numbers that are told apart; LAS has no more than 15."""

Stated = tuple[tuple[int, ...], ...]
"""Points in all, then those of return 1, 2 and so on: as the header counts them, and, where LAS 1.4 has two such
counts, as the fields of older versions do."""


def stated_counts(head: bytes, newer: bool) -> Stated:
    """Of a public header block, of which a `newer` one has the fields of LAS 1.4."""
    older = struct.unpack_from("<6I", head, 107)
    if not newer:
        return (older,)
    counts = struct.unpack_from("<16Q", head, 247)
    return (counts, older) if counts[0] else (older,)


def count_faults(stated: Sequence[Sequence[int]], numbers: Sequence[int]) -> list[str]:
    """What of `stated` is not so, by the points of each return number from 0 on, (`MOST`,); 0 may count as 1."""
    (points, *by_return), *others = stated
    faults = []
    for older_points, *older_by_return in others:
        if older_points and [older_points, *older_by_return] != [points, *by_return[: len(older_by_return)]]:
            faults.append(
                "the header's fields of older versions count other points than those of LAS 1.4"
                f" ({older_points:,} and {points:,}, by return {_first(older_by_return)} and {_first(by_return)})"
            )
    there = np.array(numbers[1 : 1 + len(by_return)])
    as_first = there.copy()
    as_first[:1] += numbers[0]
    if sum(numbers) and not any(np.array_equal(by_return, counted) for counted in (there, as_first)):
        said = "are all 0" if not any(by_return) else f"begin with {_first(by_return)}"
        faults.append(f"the header's counts of points by return {said}: there are {_first(there.tolist())}")
    return faults


def _first(counts: Sequence[int]) -> str:
    """The first few of counts by return."""
    return ", ".join(f"{n:,}" for n in list(counts)[:3])
