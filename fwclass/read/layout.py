"""The order of packets in their pulse, and which of them are one segment."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fwclass.read.packet_kernels import join_segments

SLACK = 0.5
"""Segments continue each other, or touch, within this many samples: stored locations jitter by as much."""


@dataclass(frozen=True)
class Layout:
    """Order and joining of the packets of a span.

    Attributes
    ----------
    order : packets by pulse, then by time along the beam.
    row : row of every packet (in the given, not the sorted order).
    head : per row its first packet.
    start : per row the time of its first sample after the first sample of its pulse's first segment [ns].
    shift : per packet (given order) the time of its first sample after that of its **pulse** [ns].
    skip : per packet (given order) its first samples that the packets before it have already.
    """

    order: NDArray[np.int64]
    row: NDArray[np.int64]
    head: NDArray[np.int64]
    start: NDArray[np.float64]
    shift: NDArray[np.float64]
    skip: NDArray[np.int64]


def lay_out(
    pulse: NDArray[np.int64],
    place: NDArray[np.float64],
    step: NDArray[np.float64],
    location: NDArray[np.float64],
    lasts: NDArray[np.float64],
    spacing: NDArray[np.float64],
    saturation: NDArray[np.float32],
) -> Layout:
    """Put packets in order, and join those that continue each other, or hold the same samples where they overlap.

    Parameters
    ----------
    pulse : per packet its pulse; packets of a pulse need not be adjacent.
    place, location : per packet the place of its anchor return [m] and the return's location in it [ns].
    step : beam vector [m/ns].
    lasts : samples x spacing of the packet [ns].
    spacing, saturation : [ns], [DN]; only packets alike in both are joined.
    """
    n = len(pulse)
    plain = np.arange(n)
    if (np.diff(pulse) > 0).all():
        return Layout(plain, plain, plain, np.zeros(n), np.zeros(n), np.zeros(n, np.int64))
    first = _first_of(pulse)
    up = step[first]
    squared = (up**2).sum(axis=1)
    begin = -((place - place[first]) * up).sum(axis=1) / squared - (location - location[first])
    begin, skip = _clear_of_overlaps(pulse, begin, lasts, spacing, saturation)
    if not skip.any():
        return join_rows(pulse, begin, lasts, spacing, saturation)
    layout = join_rows(pulse, begin, lasts - skip * spacing, spacing, saturation)
    return replace(layout, shift=layout.shift - skip * spacing, skip=skip)


def _clear_of_overlaps(
    pulse: NDArray[np.int64],
    begin: NDArray[np.float64],
    lasts: NDArray[np.float64],
    spacing: NDArray[np.float64],
    saturation: NDArray[np.float32],
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """`begin` of packets without the samples that those before them have, and how many these are. Packets of a pulse
    that overlaps lie whole samples apart; those of others keep their `begin`."""
    skip = np.zeros(len(pulse), np.int64)
    order = np.lexsort((begin, pulse))
    one, two = order[:-1], order[1:]
    alike = (pulse[one] == pulse[two]) & (spacing[one] == spacing[two]) & (saturation[one] == saturation[two])
    over = alike & (begin[one] + lasts[one] - begin[two] > SLACK * spacing[two])
    if not over.any():
        return begin, skip
    begin = begin.copy()
    for chain in np.split(order, np.flatnonzero(~over) + 1):
        if len(chain) == 1:
            continue
        chain = np.sort(chain)
        step, origin = spacing[chain[0]], begin[chain[0]]
        later = np.maximum(np.rint(np.diff(begin[chain]) / step), 0)
        first = np.concatenate([[0], np.cumsum(later)]).astype(np.int64)
        last = np.maximum.accumulate(first + np.rint(lasts[chain] / step).astype(np.int64))
        skip[chain[1:]] = np.maximum(last[:-1] - first[1:], 0)
        begin[chain] = origin + (first + skip[chain]) * step
    return begin, skip


def join_rows(
    pulse: NDArray[np.int64],
    begin: NDArray[np.float64],
    lasts: NDArray[np.float64],
    spacing: NDArray[np.float64],
    saturation: NDArray[np.float32],
) -> Layout:
    """As `lay_out`, of segments whose first sample is at `begin` [ns] from an origin of their pulse."""
    n = len(pulse)
    order = np.lexsort((begin, pulse))
    row, head = np.empty(n, np.int64), np.empty(n, np.int64)
    start, shift = np.empty(n), np.empty(n)
    rows = int(join_segments(order, pulse, begin, lasts, spacing, saturation, SLACK, row, head, start, shift))
    return Layout(order, row, head[:rows], start[:rows], shift, np.zeros(n, np.int64))


def _first_of(pulse: NDArray[np.int64]) -> NDArray[np.int64]:
    """Per packet the first packet of its pulse."""
    _, first, inverse = np.unique(pulse, return_index=True, return_inverse=True)
    return np.asarray(first[inverse], np.int64)
