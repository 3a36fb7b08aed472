"""The one decorator of every numeric kernel.

A kernel is arrays in, arrays out. It releases the GIL, is cached on disk for all workers, divides as
IEEE 754 says, and keeps NaN (`fastmath` would delete it, and NaN is "no value" here). It is never parallel
inside: parts are what runs in parallel.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

_REORDER = {"reassoc", "contract", "nsz", "arcp"}

_stamps: dict[Callable[..., Any], str] = {}
"""Digests of functions and of all that they read (`Kernel.stamp`)."""


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

            from fwclass.compiling import attach

            # What is not said, fastmath too, a kernel takes from whichever caller it is compiled for first.
            options = {"nogil": True, "error_model": "numpy", "fastmath": False, "no_cfunc_wrapper": True}
            self._compiled = numba.njit(**options | self._options)(self._function)
            if not getattr(self._compiled, "targetoptions", {"boundscheck": True}).get("boundscheck"):  # else a test
                attach(self._compiled, f"{self._function.__module__}.{self._function.__qualname__}", self.stamp())
            names = self._function.__globals__
            for name in _names(self._function.__code__):
                if isinstance(names.get(name), Kernel):
                    names[name] = names[name].compiled()
        return self._compiled

    def stamp(self) -> str:
        """Digest of the function, its options, and all kernels, functions and constants that it reads, wherever they
        stand: what was compiled holds as long as it is the same."""
        options = {name: sorted(v) if isinstance(v, set) else v for name, v in self._options.items()}
        return _stamp_of(self._function, repr(sorted(options.items())))


def _stamp_of(function: Callable[..., Any], options: str = "") -> str:
    if function not in _stamps:
        _stamps[function] = ""  # one that calls itself adds nothing
        state = hashlib.blake2b(options.encode(), digest_size=16)
        if function.__defaults__:
            state.update(repr(function.__defaults__).encode())
        _add_code(state, function.__code__, function.__globals__)
        _stamps[function] = state.hexdigest()
    return _stamps[function]


def _add_code(state: Any, code: CodeType, names: dict[str, Any]) -> None:
    """Add to `state` what a function does, and what the global `names` that it reads mean."""
    state.update(code.co_code + repr((code.co_names, code.co_varnames, code.co_freevars)).encode())
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            _add_code(state, constant, names)
        else:
            state.update(repr(constant).encode())
    for name in sorted(set(code.co_names) & names.keys()):
        state.update(f"{name}={_meaning(names[name])}\n".encode())


def _meaning(value: Any) -> str:
    """What a global value is to compiled code, the same text in every process."""
    function = getattr(value, "py_func", value)  # of a kernel that numba has already
    if isinstance(value, Kernel):
        return value.stamp()
    if isinstance(function, FunctionType):
        return _stamp_of(function)
    if isinstance(value, ModuleType):
        own = value.__name__.partition(".")[0] == __name__.partition(".")[0]
        return Path(str(value.__file__)).read_text() if own else value.__name__
    if isinstance(value, type):
        return repr((value.__qualname__, getattr(value, "_fields", ())))
    if hasattr(value, "tobytes") and hasattr(value, "dtype"):
        return repr((value.dtype.str, value.shape, value.tobytes()))
    return repr(value)


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
