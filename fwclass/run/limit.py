"""The longest that a part may take: a worker is ended by the system then, whatever it does; the plain loop says so."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from fwclass.run.part import Name

_lock = threading.Lock()
_deadlines: dict[object, float] = {}


@contextmanager
def ended_after(seconds: float) -> Iterator[None]:
    """End this process by SIGALRM, which nobody handles, if the block takes longer.

    The system does it: a kernel or a library that never returns to Python cannot keep it from that. Of several blocks
    at a time, in a worker with threads, the one that is over first counts. Where the system has no such clock
    (Windows) nothing happens.
    """
    if not hasattr(signal, "setitimer"):
        yield
        return
    own = object()
    _set(own, time.monotonic() + seconds)
    try:
        yield
    finally:
        _set(own, None)


def _set(own: object, deadline: float | None) -> None:
    with _lock:
        if deadline is None:
            _deadlines.pop(own, None)
        else:
            _deadlines[own] = deadline
        first = min(_deadlines.values(), default=None)
        signal.setitimer(signal.ITIMER_REAL, 0.0 if first is None else max(0.001, first - time.monotonic()))


@contextmanager
def warned_after(seconds: float, name: Name, say: Callable[[str], None]) -> Iterator[None]:
    """Say that the part `name` takes longer, if it does."""
    text = (
        f"{'/'.join(name)} has taken longer than run.part_hours ({seconds / 3600:g} h), and goes on: a worker would be "
        "ended (--workers 1)"
    )
    timer = threading.Timer(seconds, say, (text,))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
