"""The order of packets in their pulse, and which of them are one segment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.read.packet_kernels import join_segments

SLACK = 0.5
"""Segments continue each other, or touch, within this many samples: stored locations jitter by as much."""


@dataclass(frozen=True)
class Layout:
    """Order and joining of the packets of a chunk.

    Attributes
    ----------
    order : packets by pulse, then by time along the beam.
    row : row of every packet (in the given, not the sorted order).
    head : per row its first packet.
    start : per row the time of its first sample after the first sample of its pulse's first segment [ns].
    shift : per packet (given order) the time of its first sample after that of its **pulse** [ns].
    """

    order: NDArray[np.int64]
    row: NDArray[np.int64]
    head: NDArray[np.int64]
    start: NDArray[np.float64]
    shift: NDArray[np.float64]


def lay_out(
    pulse: NDArray[np.int64],
    place: NDArray[np.float64],
    step: NDArray[np.float64],
    location: NDArray[np.float64],
    lasts: NDArray[np.float64],
    spacing: NDArray[np.float64],
    saturation: NDArray[np.float32],
) -> Layout:
    """Put packets in order, and join those that continue each other.

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
        return Layout(plain, plain, plain, np.zeros(n), np.zeros(n))
    first = _first_of(pulse)
    up = step[first]
    squared = (up**2).sum(axis=1)
    begin = -((place - place[first]) * up).sum(axis=1) / squared - (location - location[first])
    return join_rows(pulse, begin, lasts, spacing, saturation)


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
    return Layout(order, row, head[:rows], start[:rows], shift)


def _first_of(pulse: NDArray[np.int64]) -> NDArray[np.int64]:
    """Per packet the first packet of its pulse."""
    _, first, inverse = np.unique(pulse, return_index=True, return_inverse=True)
    return np.asarray(first[inverse], np.int64)
