"""How wide the recorded outgoing pulses are, to hold the system pulse of the echoes against."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.waveforms import Waveforms

FOOT = 3
"""Samples at the start that tell the level."""

DISAGREE = 1.15
"""From this ratio of the widths on, either way, one of the two is not the system's pulse."""


def recorded_widths(waves: Waveforms, pulses: NDArray[np.integer]) -> NDArray[np.float64]:
    """Full width at half maximum [ns] of the recorded outgoing pulses of `pulses`; those without both flanks, or with
    samples at the digitiser's limit, have none."""
    found = []
    wanted = np.isin(waves.pulses["pulse"], pulses) & (np.diff(waves.outgoing_offsets) > FOOT)
    spacing, limit = (waves.pulses[name].astype(np.float64) for name in ("sample_spacing", "saturation"))
    for row in np.flatnonzero(wanted & np.isfinite(spacing) & (spacing > 0.0)):
        y = waves.outgoing[waves.outgoing_offsets[row] : waves.outgoing_offsets[row + 1]].astype(np.float64)
        top, level = int(y.argmax()), float(np.median(y[:FOOT]))
        half = 0.5 * (y[top] + level)
        before, after = np.flatnonzero(y[:top] < half), np.flatnonzero(y[top:] < half)
        if not len(before) or not len(after) or y[top] >= limit[row]:
            continue
        a, b = int(before[-1]), top + int(after[0])
        rise, fall = (half - y[a]) / (y[a + 1] - y[a]), (y[b - 1] - half) / (y[b - 1] - y[b])
        found.append((b - 1 + fall - a - rise) * spacing[row])
    return np.array(found)


def disagree(fwhm: float, recorded: float | None) -> bool:
    """Whether a system pulse of `fwhm` [ns] is not the one that was `recorded` as it left; False where none was."""
    return recorded is not None and not recorded / DISAGREE <= fwhm <= recorded * DISAGREE
