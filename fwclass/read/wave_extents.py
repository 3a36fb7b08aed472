"""Reading of a Waves file what pulses need; none of them says how long its waves are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fwclass.formats.extents import Extents, read_extents
from fwclass.read.wave_kernels import UNREAD

FIRST_READ, MORE = 1024, 4
"""Bytes of every pulse that are read at first, and how many times as many at least where they are too few."""


def read_waves(
    path: Path,
    size: int,
    offset: NDArray[np.int64],
    asked: NDArray[np.bool_],
    look: Callable[[Extents], tuple[NDArray[np.int64], NDArray[np.int64]]],
) -> Extents:
    """What is read of a Waves file of `size` bytes, a row a pulse, once `look` needs no more of it.

    `offset`, `asked`: of every pulse, where its waves begin, and whether they are read; those of others are empty.
    `look`: gives what looking at every pulse ended in, and the byte of the file up to which it has to be read.

    `InputError` or `OSError`: as `read_extents`.
    """
    inside = asked & (offset >= 0) & (offset < size)
    begin = np.where(inside, offset, 0)
    room = np.full(len(offset), FIRST_READ, np.int64)
    upto = np.where(inside, np.minimum(begin + room, size), 0)
    while True:
        data, *places = read_extents(path, begin[inside], upto[inside], size)
        read = Extents(data, np.zeros(len(offset), np.int64), np.zeros(len(offset), np.int64))
        read.place[inside], read.end[inside] = places
        ends, reach = look(read)
        short = ends == UNREAD
        if not short.any():
            return read
        room[short] *= MORE
        upto[short] = np.minimum(np.maximum(reach, begin + room), size)[short]
