"""Which channel of a receiver recorded a waveform."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fwclass.schema import Table


class OfChannel(Protocol):
    """What tells a channel: sample spacing [ns], saturation [DN], and its receivers where others share these two; of
    channels alike in both, one names no receivers and has all that the others do not name."""

    @property
    def sample_spacing(self) -> float:
        """Time between samples [ns]."""

    @property
    def saturation(self) -> float:
        """Highest value that can be recorded [DN]."""

    @property
    def receivers(self) -> tuple[int, ...]:
        """Numbers of the waveform descriptors; none: all that no other channel names."""


def channel_rows(channels: Sequence[OfChannel], pulses: Table) -> NDArray[np.int64]:
    """Index of the channel that recorded every row of `pulses`, int64 (rows,), by the row's ``sample_spacing``,
    ``saturation`` and ``receiver``; ``len(channels)`` where none did."""
    spacing = pulses["sample_spacing"].astype(np.float64)
    top = pulses["saturation"].astype(np.float64)
    top = np.where(np.isnan(top), np.inf, top)
    index = np.full(pulses.rows, len(channels), np.int64)
    for i, c in sorted(enumerate(channels), key=lambda one: len(one[1].receivers) > 0):
        mine = np.isclose(spacing, c.sample_spacing, rtol=1e-6, atol=0.0) & (top == c.saturation)
        if c.receivers:
            mine &= np.isin(pulses["receiver"], c.receivers)
        index[mine] = i
    return index
