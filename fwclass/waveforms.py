"""Pulses with their returns and their waveforms: what reading gives and decomposition takes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fwclass.schema import IDENTITY, Table

PULSE_COLUMNS = (
    *("pulse", "gps_time"),
    *("anchor_x", "anchor_y", "anchor_z", "anchor_time"),
    *("step_x", "step_y", "step_z"),
    *("segment_start", "anchor_range", "outgoing_start", "sample_spacing", "saturation", "gain", "receiver"),
)
RETURN_COLUMNS = (
    *("pulse", "return_number", "number_of_returns"),
    *("x", "y", "z", "gps_time"),
    *("intensity", "source_class", "withheld", "location", "has_packet"),
    *("vendor_amplitude", "vendor_width", "vendor_deviation"),
)
ECHO_COLUMNS = (
    *IDENTITY,
    *("number_of_echoes", "origin"),
    *("x", "y", "z", "gps_time"),
    *("beam_x", "beam_y", "beam_z", "beam_range"),
    *("amplitude", "amplitude_db", "width", "energy", "time"),
    *("amplitude_sigma", "width_sigma", "range_sigma"),
    *("deviation", "baseline", "noise_level", "misfit", "fit_flags"),
    *("source_class", "intensity"),
)
"""Columns of the echoes that decomposition makes of them."""

BATHYMETRY_COLUMNS = ("water", "water_decay", "water_depth")
"""Columns besides, where the survey is asked for water (section `bathymetry`)."""

SATURATED = 1
"""Value of `fit_flags` of an echo whose samples reach the saturation or its channel's clip level."""

IMPLAUSIBLE = 128
"""Value of `fit_flags` of an echo that cannot be, that its source withholds, or calls noise and keeps; neither ground
filters nor terrain see it."""


@dataclass(frozen=True)
class Waveforms:
    """A span of consecutive pulses of one strip.

    Attributes
    ----------
    pulses : one row per **segment** of a pulse that has a usable packet, `PULSE_COLUMNS`, by ascending `pulse`,
        then `segment_start`. Segments that continue each other without a gap are one row; most pulses have one.
    returns : one row per point of the file, in file order, `RETURN_COLUMNS`. `pulse` counts every pulse of the strip,
        with or without packet; in files without packets every return is a pulse of its own, and its `location` is NaN.
    samples : all samples one after the other [DN], uint8 or uint16.
    offsets : int64, shape (pulses + 1,); waveform i is ``samples[offsets[i]:offsets[i + 1]]``.
    outgoing, outgoing_offsets : the same for the recorded outgoing pulses; a row without one is empty, and its
        `outgoing_start` is NaN. The outgoing pulse has the row's sample spacing and saturation.
    faults : counts of bad data met, by name, for example ``{"packet past the end": 3}``.
    scan_angle : of every return, from the vertical [degrees], float32 (returns,); None where the file tells none.
    """

    pulses: Table
    returns: Table
    samples: NDArray[np.uint8] | NDArray[np.uint16]
    offsets: NDArray[np.int64]
    faults: Mapping[str, int] = field(default_factory=dict)
    outgoing: NDArray[np.uint8] | NDArray[np.uint16] = field(default_factory=lambda: np.empty(0, np.uint8))
    outgoing_offsets: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    scan_angle: NDArray[np.float32] | None = None

    @property
    def wide(self) -> NDArray[np.uint16]:
        """`samples` [counts] as kernels take them: of one kind, so that these are not compiled for each."""
        return self.samples.astype(np.uint16, copy=False)

    def __post_init__(self) -> None:
        if len(self.outgoing_offsets) == 0:
            object.__setattr__(self, "outgoing_offsets", np.zeros(self.pulses.rows + 1, np.int64))
        if len(self.offsets) != self.pulses.rows + 1 or (len(self.offsets) and self.offsets[-1] > len(self.samples)):
            raise ValueError("offsets do not fit pulses and samples")
        if len(self.outgoing_offsets) != self.pulses.rows + 1 or self.outgoing_offsets[-1] > len(self.outgoing):
            raise ValueError("outgoing_offsets do not fit pulses and outgoing")
