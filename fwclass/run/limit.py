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
_warnings: dict[object, tuple[float, Callable[[str], None], str]] = {}
_watcher: threading.Thread | None = None
_looks_at = 0.0
_sooner = threading.Event()

IDLE = 3600.0
"""Seconds between two looks where no part is under way."""


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
    own = object()
    with _lock:
        _warnings[own] = time.monotonic() + seconds, say, text
        _watch(_warnings[own][0])
    try:
        yield
    finally:
        with _lock:
            _warnings.pop(own, None)


def _watch(deadline: float) -> None:
    """Have `_watcher` look at this time or before: one thread for all parts, as a thread takes longer to begin than
    many a part."""
    global _watcher, _looks_at
    if _watcher is None or not _watcher.is_alive():
        _looks_at = deadline
        _watcher = threading.Thread(target=_warn, name="part-limit", daemon=True)
        _watcher.start()
    elif deadline < _looks_at:
        _sooner.set()


def _warn() -> None:
    global _looks_at
    while True:
        now = time.monotonic()
        with _lock:
            over = [own for own, (deadline, _, _) in _warnings.items() if deadline <= now]
            warned = [_warnings.pop(own) for own in over]
            _looks_at = min((deadline for deadline, _, _ in _warnings.values()), default=now + IDLE)
            _sooner.clear()
        for _, say, text in warned:
            say(text)
        _sooner.wait(max(0.0, _looks_at - time.monotonic()))
