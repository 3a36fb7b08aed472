"""Random numbers by counter: the same pulse draws the same numbers in whatever chunk it is traced."""

from __future__ import annotations

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from fwclass.kernel import kernel

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_A = np.uint64(0xBF58476D1CE4E5B9)
_MIX_B = np.uint64(0x94D049BB133111EB)
_S27, _S30, _S31, _S11, _S40 = (np.uint64(s) for s in (27, 30, 31, 11, 40))
_UNIT = 2.0**-53

NORMAL_BITS = 12
NORMAL_SHIFT = np.uint64(64 - NORMAL_BITS)
"""A random number shifted right by this is a place in `normal_table`."""

SHOT_STREAM, CLOCK_STREAM, NOISE_STREAM = (1 << 24) - 1, (1 << 24) - 2, 1 << 24
"""Numbers in a pulse's stream of its energy, its clock and its samples; those below belong to its rays."""


@kernel
def mix(value):  # type: ignore[no-untyped-def]
    """uint64 of 64 well-mixed bits of a uint64, any shape: the finaliser of SplitMix64 (Steele 2014)."""
    value = (value ^ (value >> _S30)) * _MIX_A
    value = (value ^ (value >> _S27)) * _MIX_B
    return value ^ (value >> _S31)


@kernel
def draw(key, counter):  # type: ignore[no-untyped-def]
    """64 random bits, number `counter` (any integer) of the stream `key` (uint64)."""
    return mix(key + np.uint64(counter) * GOLDEN)


@kernel
def uniform(key, counter):  # type: ignore[no-untyped-def]
    """Number `counter` of the stream `key`, uniform in the open interval (0, 1)."""
    return (np.float64(draw(key, counter) >> _S11) + 0.5) * _UNIT


@kernel
def pulse_key(seed, strip, pulse):  # type: ignore[no-untyped-def]
    """The stream (uint64) that belongs to one pulse of one strip."""
    first = mix(np.uint64(seed) * GOLDEN + np.uint64(strip))
    return mix(first ^ (np.uint64(pulse) * GOLDEN) ^ (np.uint64(strip) << _S40))


def normal_table() -> NDArray[np.float64]:
    """float64 (4096,): equally likely values of a standard normal variate, of exactly unit variance."""
    count = 1 << NORMAL_BITS
    values = scipy.special.ndtri((np.arange(count) + 0.5) / count)
    return np.ascontiguousarray(values / values.std())


@kernel
def clock_errors(normal, seed, strip, first, out):  # type: ignore[no-untyped-def]
    """Fills in `out` float (pulses,): one standard normal number for each pulse from number `first` on, the jitter of
    its clock in units of its deviation; `normal` is the table of `normal_table`."""
    for p in range(len(out)):
        bits = draw(pulse_key(seed, strip, first + p), CLOCK_STREAM)
        out[p] = normal[bits >> NORMAL_SHIFT]
