"""Memory that a part frees is kept for the next one, as far as the process stays small.

The C library gives every array above 128 KiB back to the system when it is freed, and Dask has it give back all the
rest: the next array faults each page in again. That was a quarter of a run's processor time.
"""

from __future__ import annotations

import ctypes
import os
import re
from functools import cache
from pathlib import Path

from fwclass.units import MIB

_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8
"""Of mallopt(3)."""

LARGEST = 32 << 20
"""Bytes of the largest array whose memory is kept: glibc takes no more."""

KEPT = 640 << 20
"""Bytes that a process may hold between two parts without giving back what it has freed; half of that is its code."""


@cache
def _library() -> ctypes.CDLL | None:
    """The C library, None where it is not GNU's."""
    try:
        library = ctypes.CDLL(None)
        return library if hasattr(library, "mallopt") and hasattr(library, "malloc_trim") else None
    except (OSError, TypeError):
        return None


@cache
def keep_freed() -> None:
    """Let this process keep what it frees; where the user has set malloc's own variables, these hold."""
    library = _library()
    if library is None or any(n.startswith("MALLOC_") and n != "MALLOC_TRIM_THRESHOLD_" for n in os.environ):
        return
    library.mallopt(_ARENA_MAX, 1)  # the memory of one thread is not the next one's
    library.mallopt(_MMAP_THRESHOLD, LARGEST)
    library.mallopt(_TRIM_THRESHOLD, KEPT)


def give_back(most: int | None) -> None:
    """Return freed memory to the system where the process holds more than `KEPT`, or half of the `most` that it may
    have [bytes]: the next part needs the room."""
    library = _library()
    if library is not None and resident_bytes() > min(KEPT, most // 2 if most else KEPT):
        library.malloc_trim(0)


def resident_bytes() -> int:
    """Bytes of this process in memory, 0 where the system does not tell."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return 0


def peak_mib() -> float:
    """Highest resident memory of this process so far [MiB]; where the system does not tell, the present one.

    Not `getrusage`: a process begins there with the peak of the one that started it, so that the workers of a large
    program would all look large.
    """
    try:
        peak = re.search(r"^VmHWM:\s+(\d+) kB$", Path("/proc/self/status").read_text(), re.MULTILINE)
    except OSError:
        peak = None
    if peak:
        return int(peak[1]) / 1024
    import psutil  # not every command has a use for it

    memory = psutil.Process(os.getpid()).memory_info()
    return float(getattr(memory, "peak_wset", memory.rss)) / MIB
