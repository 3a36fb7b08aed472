"""Several receivers behind one sample spacing and one limit, which only their descriptors tell apart: a detector of
high and one of low gain, or two lasers. Where their bright echoes have another shape, or their noise another size, each
is a channel of its own."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating]
Shape = TypeVar("Shape")

NOISIER = 1.5
"""From this ratio of noise on two receivers are not one; descriptors of one receiver differ by 1.1 at most (Q680i)."""


def part_groups(
    group: NDArray[np.int64],
    receiver: NDArray[np.integer],
    bright: NDArray[np.bool_],
    noise: Floats,
    least: int,
    shape_of: Callable[[NDArray[np.int64]], Shape],
    alike: Callable[[Shape, Shape], bool],
) -> tuple[NDArray[np.int64], list[tuple[int, tuple[int, ...]]]]:
    """Channels with the receivers of one spacing and limit parted where they differ.

    Parameters
    ----------
    group : channel of every waveform by spacing and limit, int64 (waveforms,), -1 none.
    receiver, bright, noise : of every waveform its receiver, whether it has a bright single echo, and the standard
        deviation of its noise [DN], NaN unknown.
    least : bright echoes below which a receiver is taken for that with most.
    shape_of, alike : the shape of the bright echoes of some rows, and whether that of a receiver with more echoes
        describes those of another.

    Returns
    -------
    every waveform's channel, numbered anew, and of every channel the one of `group` that it was, and its receivers;
    that with most bright echoes names none, and has all with too few.
    """
    parted = np.full(len(group), -1)
    channels: list[tuple[int, tuple[int, ...]]] = []
    for k in range(group.max(initial=-1) + 1):
        mine = group == k
        kinds, count = np.unique(receiver[mine & bright], return_counts=True)
        order = np.argsort(-count, kind="stable")
        groups: list[tuple[list[int], float, Shape]] = []
        many = kinds[order[count[order] >= least]].tolist()
        for r in many if len(many) > 1 else ():
            rows = np.flatnonzero(mine & bright & (receiver == r))
            own, shape = float(np.median(noise[rows])), shape_of(rows)
            for members, usual, main in groups:
                if max(own, usual) < NOISIER * min(own, usual) and alike(main, shape):
                    members.append(r)
                    break
            else:
                groups.append(([r], own, shape))
        parted[mine] = len(channels)
        channels.append((k, ()))
        for members, *_ in groups[1:]:
            parted[mine & np.isin(receiver, members)] = len(channels)
            channels.append((k, tuple(sorted(members))))
    return parted, channels
