"""What follows what, in order: links between things become chains and rings."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Chains(NamedTuple):
    """Things in the order of their chains.

    Attributes
    ----------
    order : (n,) every thing once, chain after chain; the chains by their first thing.
    first : (chains + 1,) where each begins in `order`.
    closed : (chains,) the last thing leads to the first one, which is the lowest of its ring.
    """

    order: NDArray[np.int64]
    first: NDArray[np.int64]
    closed: NDArray[np.bool_]


def chains(after: NDArray[np.int64]) -> Chains:
    """Chains of things of which each has at most one `after` it, int64 (things,), -1 for none, and is after at most
    one."""
    n, here = len(after), np.arange(len(after))
    rounds = max(1, n).bit_length()
    lowest, jump = here.copy(), np.where(after < 0, here, after)
    for _ in range(rounds):
        lowest = np.minimum(lowest, lowest[jump])
        jump = jump[jump]
    ring = after[jump] >= 0  # there is no end to come to
    cut = after.copy()
    cut[ring & (after == lowest)] = -1  # rings begin at their lowest
    before = np.full(n, -1, np.int64)
    before[cut[cut >= 0]] = here[cut >= 0]
    place, head = (before >= 0).astype(np.int64), np.where(before < 0, here, before)
    for _ in range(rounds):
        place += place[head]
        head = head[head]
    order = np.lexsort((place, head))
    starts = np.flatnonzero(place[order] == 0)
    return Chains(order, np.append(starts, n), ring[order[starts]])
