"""Counter-based random numbers: a number depends on what it is for, never on the order of the work."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.kernel import inlined

GOLDEN = 0x9E3779B97F4A7C15
_MASK = (1 << 64) - 1
_STEP = np.uint64(GOLDEN)
_FIRST, _SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_A, _B, _C, _HALF = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(32)


def mix(z: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Finaliser of splitmix64 (Steele, Lea and Flood 2014): a one-to-one map of 64-bit numbers."""
    z = (z ^ (z >> _A)) * _FIRST
    z = (z ^ (z >> _B)) * _SECOND
    return z ^ (z >> _C)


def seed_for(seed: int, *counters: int) -> int:
    """A 64-bit number for (seed, counters…), such as (seed, tree)."""
    state = 0
    for word in (seed, *counters):
        state = int(mix(np.array([(state + word + GOLDEN) & _MASK], np.uint64))[0])
    return state


def hash_keys(seed: int, keys: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """A random number for every key, one-to-one for a given seed: unique keys never tie."""
    return mix(np.asarray(keys, np.uint64) + np.array([seed_for(seed)], np.uint64))


@inlined
def below(state, n):  # type: ignore[no-untyped-def]
    """A whole number in [0, n), n < 2^32; moves on the generator whose state is ``state[0]``."""
    state[0] += _STEP
    z = state[0]
    z = (z ^ (z >> _A)) * _FIRST
    z = (z ^ (z >> _B)) * _SECOND
    return np.int64(((z >> _HALF) * np.uint64(n)) >> _HALF)
