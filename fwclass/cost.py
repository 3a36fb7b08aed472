"""What the work of a part costs: seconds of reading and writing, processor time, page faults."""

from __future__ import annotations

import resource
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

_took: dict[str, float] = {"reading": 0.0, "writing": 0.0, "checking": 0.0}
_under = threading.local()


@contextmanager
def counted(kind: Literal["reading", "writing", "checking"]) -> Iterator[None]:
    """The seconds of the block count as `kind`; as a decorator, those of a function. Within another they count once."""
    if getattr(_under, "way", False):
        yield
        return
    _under.way = True
    began = time.perf_counter()
    try:
        yield
    finally:
        _under.way = False
        _took[kind] += time.perf_counter() - began


def cost_so_far() -> dict[str, float]:
    """What this process has spent so far.

    Returns a dict with ``reading`` and ``writing`` tables and arrays, and ``checking`` that files are what was written
    [s]; processor time of the program (``user``) and of the system in its name (``system``) [s], of all its threads;
    ``faults``, pages of memory that the system had to give.
    """
    used = resource.getrusage(resource.RUSAGE_SELF)
    return {**_took, "user": used.ru_utime, "system": used.ru_stime, "faults": float(used.ru_minflt)}


def since(before: dict[str, float]) -> dict[str, float]:
    """What was spent since `before`, to four digits behind the point."""
    return {name: round(value - before[name], 4) for name, value in cost_so_far().items()}
