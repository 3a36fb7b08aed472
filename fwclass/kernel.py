"""The one decorator of every numeric kernel.

A kernel is arrays in, arrays out. It releases the GIL, is cached on disk for all workers, divides as
IEEE 754 says, and keeps NaN (`fastmath` would delete it, and NaN is "no value" here). It is never parallel
inside: parts are what runs in parallel.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba

_REORDER = {"reassoc", "contract", "nsz", "arcp"}


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile `function` with the house's options."""
    return numba.njit(nogil=True, cache=True, error_model="numpy")(function)


def vectorised(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `kernel`, and sums may be taken in another order, so that they run several samples at a time.

    NaN and infinity keep their meaning. The last bits may differ between two kinds of processor, never between two
    runs, workers or ways to cut the work on one kind.
    """
    return numba.njit(nogil=True, cache=True, error_model="numpy", fastmath=_REORDER)(function)


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `kernel`, inlined by the compiler where it is called."""
    return numba.njit(nogil=True, cache=True, error_model="numpy", inline="always")(function)
