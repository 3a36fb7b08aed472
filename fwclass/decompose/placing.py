"""From fitted times to places: along the beam, from the pulse's anchor, after its outgoing pulse."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.channel_rows import channel_rows
from fwclass.decompose.fitted_echoes import OVERLAPPING
from fwclass.decompose.fitting import Fits, fit_waveforms
from fwclass.decompose.params import DecomposeParams
from fwclass.decompose.placement import Placement, offsets_of, phases_of
from fwclass.decompose.pulse_sample import outgoing_of
from fwclass.decompose.shapes import height_error
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.waveforms import Waveforms


def outgoing_times(waves: Waveforms, params: DecomposeParams, pulse: SystemPulse) -> NDArray[np.float64]:
    """When every row's recorded outgoing pulse left, after the pulse's time origin [ns]; 0 where none is recorded.

    The outgoing pulse is fitted like an echo; of several the highest counts.
    """
    late = np.zeros(waves.pulses.rows)
    rows = np.flatnonzero(np.diff(waves.outgoing_offsets) > 0)
    if len(rows) == 0:
        return late
    fits = fit_waveforms(outgoing_of(waves, rows), params, pulse)
    order = np.lexsort((fits.amplitude, fits.row))
    fitted, last = np.unique(fits.row[order][::-1], return_index=True)
    highest = order[::-1][last]
    start = waves.pulses["outgoing_start"].astype(np.float64)[rows[fitted]]
    late[rows[fitted]] = np.nan_to_num(start + fits.time[highest])
    return late


PHASE_REACH = 0.65
"""Samples that a location without the phase of the digitiser's clock is off by at most, the fit's error included."""


def origins_of(
    waves: Waveforms, params: DecomposeParams, pulse: SystemPulse, placement: Placement
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """When every row's time begins to count, after the pulse's time origin [ns], for its place and for its distance
    from the sensor: at its outgoing pulse, or 0.

    An anchor without a fixed distance from the sensor has nothing to do with when the outgoing pulse left.
    """
    nothing = np.zeros(waves.pulses.rows)
    if not (placement.from_outgoing or placement.range_from_outgoing):
        return nothing, nothing
    late = outgoing_times(waves, params, pulse)
    if params.outgoing_time == "auto":
        late = np.where(np.isnan(waves.pulses["anchor_range"]), 0.0, late)
    return late if placement.from_outgoing else nothing, late if placement.range_from_outgoing else nothing


def from_anchor(
    fits: Fits, waves: Waveforms, late: NDArray[np.float64], params: DecomposeParams, placement: Placement
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """How long after its anchor every echo is [ns], and which echoes are far from what the vendor has.

    What the strip's curve says of the vendor's locations is taken off. Where locations lack the phase of the
    digitiser's clock, the row is shifted so that the echo nearest to its return falls on it; where the strip has too
    few returns to tell, too, within `register_within` and by no echo that overlaps others, as the vendor may have seen
    several as one. Elsewhere the vendor's location holds for the strip, not for the row.
    Where the anchor is at the sensor, `late` is the time origin.
    """
    after = fits.time - offsets_of(fits, waves.pulses, placement)
    after -= (waves.pulses["anchor_time"].astype(np.float64) + late)[fits.row]
    shift, gap = row_shifts(fits, after, waves, params, placement)
    if waves.returns.rows == 0:  # such a format has the sensor, or a point beside it, for anchor
        return after, np.zeros(len(after), bool)
    far = gap > params.vendor_tolerance
    return after - shift[fits.row], far[fits.row]


def row_shifts(
    fits: Fits, after: NDArray[np.float64], waves: Waveforms, params: DecomposeParams, placement: Placement
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What is taken off `after`, the time of every echo after its anchor, in each row, and how far the row's nearest
    echo is from its anchor [ns]; infinite without one."""
    pulses, distance = waves.pulses, np.abs(after)
    gap = np.full(pulses.rows, np.inf)
    np.minimum.at(gap, fits.row, distance)
    nearest = np.flatnonzero(distance == gap[fits.row])[::-1]  # of two equally near ones the first is written last
    shift = np.zeros(pulses.rows)
    lacking, unknown = phases_of(pulses, placement)
    alone = (fits.flags[nearest] & OVERLAPPING) == 0
    shift[fits.row[nearest]] = after[nearest] * (alone | lacking[fits.row[nearest]])
    phase = PHASE_REACH * pulses["sample_spacing"] * (params.register_within > 0.0)
    shift[gap > np.where(lacking, phase, np.where(unknown, params.register_within, 0.0))] = 0.0
    return shift, gap


def detection_limits(waves: Waveforms, params: DecomposeParams, pulse: SystemPulse) -> NDArray[np.float64]:
    """Lowest amplitude that every row's channel can tell from noise [DN]; NaN where the channel is not known.

    The height at which the matched filter reaches `detection`; from the channel's noise, the same for all its pulses.
    """
    limits = [params.detection * c.noise * height_error(pulse.of(c), c) for c in pulse.channels]
    return np.array([*limits, np.nan])[channel_rows(pulse.channels, waves.pulses)]


def beams(waves: Waveforms) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Unit vector from sensor to target, shape (rows, 3), and speed along the beam [m/ns] of every row."""
    step = np.stack([waves.pulses[f"step_{axis}"] for axis in "xyz"], axis=1)
    speed = np.sqrt((step**2).sum(axis=1))
    return -step / speed[:, None], speed
