"""Reading the extents of a file that are asked for: where a file is cut off while it is mapped, the process ends by a
signal."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fwclass.formats.checks import cut_off
from fwclass.paths import open_regular

NEAR = 512
"""Bytes between extents that are read along with them: reading once more would take as long."""

_MOST = 1 << 30
"""Bytes that are asked for at once; systems give 2 GiB at most."""


class Extents(NamedTuple):
    """Bytes of a file: ``begin[i]`` of what was asked for is ``data[place[i]]``, and what follows it in the file
    follows it in `data` up to ``data[end[i]]``."""

    data: NDArray[np.uint8]
    place: NDArray[np.int64]
    end: NDArray[np.int64]


def read_extents(path: Path, begin: NDArray[np.int64], end: NDArray[np.int64], least: int) -> Extents:
    """The bytes ``[begin[i], end[i])`` of a file, those that several ask for once: never more than the file has.

    `begin`, `end`: (n,), from 0 to `least`. `least`: bytes that the file had when the places in it were checked.

    `InputError`: it is a pipe, a device or a socket, or has fewer than `least` bytes, also while it is read. `OSError`:
    as `open`.
    """
    order = np.argsort(begin, kind="stable")
    starts, reached = begin[order], np.maximum.accumulate(np.maximum(begin, end)[order])
    fresh = np.ones(len(order), np.bool_)
    fresh[1:] = starts[1:] > reached[:-1] + NEAR
    first, last = np.flatnonzero(fresh), np.flatnonzero(np.roll(fresh, -1))
    ends = np.cumsum(reached[last] - starts[first])
    data = np.empty(int(ends[-1]) if len(ends) else 0, np.uint8)
    shift = ends - reached[last]
    with open_regular(path) as file:
        if (size := os.fstat(file.fileno()).st_size) < least:
            raise cut_off(path, least, size)
        room = data.data
        for at, to, by in zip(starts[first].tolist(), reached[last].tolist(), shift.tolist(), strict=True):
            while at < to:
                count = os.preadv(file.fileno(), [room[at + by : min(to, at + _MOST) + by]], at)
                if count == 0:
                    raise cut_off(path, least, os.fstat(file.fileno()).st_size)
                at += count
    data.flags.writeable = False
    run = np.empty(len(order), np.int64)
    run[order] = np.cumsum(fresh) - 1
    return Extents(data, begin + shift[run], ends[run])


def read_extent(path: Path, begin: int, end: int, least: int) -> NDArray[np.uint8]:
    """The bytes ``[begin, end)`` of a file, as `read_extents`."""
    return read_extents(path, np.array([begin], np.int64), np.array([end], np.int64), least).data
