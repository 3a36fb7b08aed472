"""`fwclass compile`: all kernels, for all types of arguments that the program calls them with, before anyone waits.

They are listed in ``conf/kernels.json``, which ``tests/kernels/record.py`` writes: one line for each kernel and its
types. A type is a scalar's name; an array's, with dimensions and layout; ``[class, field, …]`` of a named tuple,
without class of a plain one; or ``{"dtype": …, "array": …}`` of an array of records.
"""

from __future__ import annotations

import importlib
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from fwclass import compiling
from fwclass.conf.files import conf_directory
from fwclass.errors import StoreError
from fwclass.isolation import faults_of_cache, kernel_cache
from fwclass.kernel import Kernel

LIST = "kernels.json"


def compile_all(tell: Callable[[str], None] = lambda text: None) -> dict[str, Any]:
    """Compile what the cache lacks; how many kernels and seconds, which do not fit their list, and where they lie, as
    plain data.

    `tell` is called now and then with how far it is.

    `StoreError`: what is compiled cannot be kept; nothing more is compiled then.
    """
    began, wanted = time.perf_counter(), listed_kernels()
    before, spoke, left = compiling.count(), began, list[str]()
    directory, faults = kernel_cache(), len(compiling.not_kept)
    if faults_of_cache:
        raise _not_kept(*faults_of_cache[-1])
    for number, (kernel, types) in enumerate(wanted):
        try:
            kernel.compiled().compile(tuple(map(_type, types)))  # type: ignore[attr-defined]
        except TypeError as fault:
            left.append(f"{kernel.__name__}: {fault}")  # type: ignore[attr-defined]
        if len(compiling.not_kept) > faults:
            raise _not_kept(directory, compiling.not_kept[-1])
        if time.perf_counter() - spoke > 10.0:
            spoke = time.perf_counter()
            tell(f"{number + 1} of {len(wanted)}")
    return {
        "listed": len(wanted),
        "compiled": compiling.count() - before,
        "left_out": left,
        "seconds": round(time.perf_counter() - began, 1),
        "directory": str(directory),
    }


def _not_kept(directory: Path, why: str) -> StoreError:
    return StoreError(
        "compiled code cannot be kept, so that nothing is won by compiling ahead",
        where=directory,
        expected="a directory that this user can write to, with some 20 MB free",
        got=why,
        do="mend that, or name another directory in NUMBA_CACHE_DIR",
    )


def listed_kernels() -> list[tuple[Kernel, list[Any]]]:
    """Every kernel of the list, and the types of its arguments, as text."""
    rows = json.loads((conf_directory() / LIST).read_text(encoding="utf-8"))
    return [(_named(name), types) for name, *types in rows]


def _named(name: str) -> Any:
    module, _, own = name.rpartition(".")
    return getattr(importlib.import_module(module), own)


def _type(type_: Any) -> Any:
    """numba's type."""
    from numba import types
    from numba.np.numpy_support import from_dtype

    if isinstance(type_, dict):
        return _array(from_dtype(np.dtype([tuple(field) for field in type_["dtype"]])), type_["array"].split())
    if isinstance(type_, list):
        kind, *fields = type_
        inner = [_type(field) for field in fields]
        if not kind:
            return types.Tuple(inner)
        own = _named(kind)
        if len(inner) != len(own._fields):
            raise TypeError(f"{kind} has {len(own._fields)} fields, the list {len(inner)}")
        return types.NamedTuple(inner, own)
    scalar, *rest = type_.split()
    scalar_type = types.none if scalar == "none" else getattr(types, scalar)
    return _array(scalar_type, rest) if rest else scalar_type


def _array(kind: Any, words: list[str]) -> Any:
    from numba import types

    ndim, layout, *more = words
    return types.Array(kind, int(ndim), layout, readonly="readonly" in more, aligned="unaligned" not in more)


def lines(kernels: list[tuple[str, Any]]) -> Iterator[str]:
    """Of `compiling.asked`, as the list has them."""
    for name, types in kernels:
        yield json.dumps([name, *map(_text, types)])


def _text(kind: Any) -> Any:
    """A type as `_type` reads it."""
    from numba import types
    from numba.np.numpy_support import as_dtype

    if isinstance(kind, types.Array):
        words = [str(kind.ndim), kind.layout, *([] if kind.mutable else ["readonly"])]
        words += [] if kind.aligned else ["unaligned"]
        if isinstance(kind.dtype, types.Record):
            return {"dtype": [list(field) for field in as_dtype(kind.dtype).descr], "array": " ".join(words)}
        return " ".join([str(kind.dtype), *words])
    if isinstance(kind, types.BaseTuple):
        own = getattr(kind, "instance_class", None)
        return [f"{own.__module__}.{own.__qualname__}" if own else "", *map(_text, kind.types)]
    return str(kind)
