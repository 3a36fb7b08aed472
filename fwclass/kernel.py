"""The one decorator of every numeric kernel.

A kernel is arrays in, arrays out. It releases the GIL, is cached on disk for all workers, divides as
IEEE 754 says, and keeps NaN (`fastmath` would delete it, and NaN is "no value" here). It is never parallel
inside: parts are what runs in parallel.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from types import CodeType
from typing import Any

_REORDER = {"reassoc", "contract", "nsz", "arcp"}


class Kernel:
    """A function that becomes numba's when it is called first: a process that only plans never loads the compiler."""

    def __init__(self, function: Callable[..., Any], **options: Any) -> None:
        functools.update_wrapper(self, function)
        self._function, self._options = function, options
        self._compiled: Callable[..., Any] | None = None

    def __call__(self, *args: Any) -> Any:
        return (self._compiled or self.compiled())(*args)

    def compiled(self) -> Callable[..., Any]:
        """numba's function. It calls no `Kernel`, so those that this one names are put into its module as numba's."""
        if self._compiled is None:
            import numba

            self._compiled = numba.njit(nogil=True, cache=True, error_model="numpy", **self._options)(self._function)
            names = self._function.__globals__
            for name in _names(self._function.__code__):
                if isinstance(names.get(name), Kernel):
                    names[name] = names[name].compiled()
        return self._compiled


def _names(code: CodeType) -> set[str]:
    """Names of the module that `code` reads, with the functions and comprehensions inside it."""
    inner = (_names(c) for c in code.co_consts if isinstance(c, CodeType))
    return set(code.co_names).union(*inner)


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile `function` with the house's options."""
    return Kernel(function)


def vectorised(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `kernel`, and sums may be taken in another order, so that they run several samples at a time.

    NaN and infinity keep their meaning. The last bits may differ between two kinds of processor, never between two
    runs, workers or ways to cut the work on one kind.
    """
    return Kernel(function, fastmath=_REORDER)


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `kernel`, inlined by the compiler where it is called."""
    return Kernel(function, inline="always")
