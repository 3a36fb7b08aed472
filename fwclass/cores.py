"""Cores that the kernels of this process may use at the same time: one, as parts run beside one another in processes of
their own, unless a command that works on one file takes all there are."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")

_cores = 1


def use_all() -> None:
    """From now on this process has all cores that it may run on."""
    global _cores
    _cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def share_out(items: Sequence[T], begin: Callable[[], Callable[[T], None]]) -> None:
    """Do what `begin` returns, which has room of its own, for every item; the items' order means nothing.

    The work is to spend its time without the GIL. After a fault or an interrupt nothing more is begun.
    """
    left, own = iter(items), begin()
    for item in left:  # alone: the work may have to be compiled
        own(item)
        break

    def go_on(work: Callable[[T], None]) -> None:
        try:
            for item in left:
                work(item)
        finally:
            for _ in left:
                pass

    more = min(_cores, len(items) - 1) - 1
    with ThreadPoolExecutor(max(more, 1)) as pool:
        others = [pool.submit(lambda: go_on(begin())) for _ in range(more)]
        go_on(own)
        for other in others:
            other.result()
