"""Columns of echoes, and of returns and pulses as they are read."""

from __future__ import annotations

from typing import Any

from fwclass.columns.record import NAN, Column, measured_column, published_columns

_COLUMNS = (
    # who an echo is; (strip, pulse, echo_number) is unique and the canonical order
    Column("strip", "u2", "", "number of the source file, which follows from its name; report.json lists them"),
    Column(
        "pulse",
        "u4",
        "",
        "index of the pulse in its strip, in order of first appearance in the file; without waveforms, of the return",
    ),
    Column(
        "echo_number",
        "u1",
        "",
        "place of the echo in its pulse, 1 is nearest to the sensor; implausible echoes come last",
        low=1,
    ),
    Column("number_of_echoes", "u1", "", "echoes of the pulse; a plausible echo counts those alone", low=1),
    Column(
        "origin",
        "u1",
        "",
        "0 fitted to a waveform, 1 vendor return without usable packet, 2 read as an echo, 3 shown by several pulses",
    ),
    # where it is
    Column("x", "f8", "m", "easting in the survey's CRS, whole millimetres"),
    Column("y", "f8", "m", "northing in the survey's CRS, whole millimetres"),
    Column("z", "f8", "m", "height in the survey's CRS, whole millimetres"),
    Column("gps_time", "f8", "s", "time of the pulse as the source gives it", null=NAN),
    measured_column("beam_x", "", "unit vector from sensor to target, east", low=-1, high=1),
    measured_column("beam_y", "", "unit vector from sensor to target, north", low=-1, high=1),
    measured_column("beam_z", "", "unit vector from sensor to target, up (negative)", low=-1, high=1),
    # what the waveform says
    measured_column(
        "amplitude",
        "DN",
        "height of the fitted echo above the baseline; a kept return's vendor amplitude [dB] or intensity",
        low=0,
    ),
    measured_column(
        "amplitude_db",
        "dB",
        "10 log10 of amplitude over the strip's detection limit; vendor's value where read",
        source="RIEGL extra byte `Amplitude`",
    ),
    measured_column("width", "ns", "echo width, full width at half maximum", low=0),
    measured_column(
        "time", "ns", "time of the echo in its waveform, from the first sample of the pulse's first segment"
    ),
    measured_column("energy", "DN ns", "area under the fitted echo, times the segment's relative gain", low=0),
    measured_column("amplitude_sigma", "DN", "standard error of amplitude, from the fit's covariance", low=0),
    measured_column("width_sigma", "ns", "standard error of width, from the fit's covariance", low=0),
    measured_column(
        "range_sigma", "m", "standard error of the echo's place along the beam, from the fit's covariance", low=0
    ),
    measured_column(
        "deviation",
        "",
        "1000 x root mean square residual around the echo over its amplitude; 0 is the system's pulse",
        low=0,
        source="RIEGL extra byte `Deviation`",
    ),
    measured_column("beam_range", "m", "distance from the sensor, where the source gives its place", low=0),
    measured_column("baseline", "DN", "level of the waveform without echoes"),
    measured_column("noise_level", "DN", "standard deviation of the waveform's noise", low=0),
    measured_column("misfit", "", "reduced chi-square of the pulse's fit", low=0),
    Column(
        "fit_flags",
        "u1",
        "",
        "1 saturated, 2 overlapping, 4 poor fit, 8 at the segment's edge, 16 vendor return kept, "
        "32 far from the vendor's returns, 64 not fitted for want of a usable waveform, 128 implausible",
    ),
    Column(
        "source_class",
        "u1",
        "",
        "class code of the nearest return of the pulse in the source file; 0 of an implausible echo",
    ),
    Column(
        "water",
        "u1",
        "",
        "1 the surface of water, 2 its bottom, placed behind the bent beam, 0 another echo",
        low=0,
        high=2,
    ),
    measured_column(
        "water_decay",
        "1/m",
        "how fast light fades in the pulse's water column, to and fro together, a metre along the beam",
        low=0,
    ),
    measured_column("water_depth", "m", "how far a bottom lies below the surface of its pulse, vertically", low=0),
    Column("stacked_pulses", "u1", "", "pulses whose waveforms show the echo together; none alone does"),
    Column("significance", "f4", "", "height of the stacked echo over its standard deviation", low=0),
    Column("intensity", "u2", "", "intensity of the nearest return of the pulse in the source file"),
    # samples of waveforms
    Column("sample", "u2", "", "number of the sample in its pulse, from 0"),
    Column("sample_value", "f4", "DN", "recorded sample over the level of its waveform", las="sample value"),
    Column(
        "returned_energy",
        "f4",
        "DN ns",
        "energy that was sent back here: the waveform freed of the system's pulse",
        low=0,
    ),
    Column("share", "f4", "", "of the energy of all samples of the pulse", low=0, high=1, las="share"),
    # returns, as read
    Column("return_number", "u1", "", "vendor's return number; 0 occurs in faulty files"),
    Column("number_of_returns", "u1", "", "vendor's number of returns of the pulse"),
    measured_column("location", "ns", "vendor's return location, from the first sample of the pulse's first segment"),
    Column("withheld", "bool", "", "the source flags the return as withheld or synthetic"),
    Column("has_packet", "bool", "", "the return's waveform packet could be read"),
    measured_column("vendor_amplitude", "dB", "extra byte `Amplitude` of the source"),
    measured_column("vendor_width", "ns", "extra byte `Pulse width` of the source"),
    measured_column("vendor_deviation", "", "extra byte `Deviation` of the source"),
    # pulses, as read
    Column("anchor_x", "f8", "m", "easting of the pulse's anchor return"),
    Column("anchor_y", "f8", "m", "northing of the pulse's anchor return"),
    Column("anchor_z", "f8", "m", "height of the pulse's anchor return"),
    Column("anchor_time", "f4", "ns", "return location of the anchor return"),
    Column(
        "step_x",
        "f8",
        "m/ns",
        "stored beam vector, east; P(t) = P_anchor + (anchor_time - t) step",
        source="LAS 1.4 R15",
    ),
    Column("step_y", "f8", "m/ns", "stored beam vector, north"),
    Column("step_z", "f8", "m/ns", "stored beam vector, up"),
    Column(
        "segment_start", "f4", "ns", "first sample of the segment after the first sample of the pulse's first segment"
    ),
    Column("anchor_range", "f8", "m", "distance from the sensor to the anchor, where the source gives it", null=NAN),
    measured_column(
        "outgoing_start", "ns", "first sample of the recorded outgoing pulse after the pulse's time origin"
    ),
    Column("sample_spacing", "f4", "ns", "time between samples", low=0),
    Column("saturation", "f4", "DN", "highest value that the digitiser can record"),
    Column("gain", "f4", "", "volts a DN of the segment over those of the file's first waveform descriptor", low=0),
    Column("receiver", "u1", "", "waveform descriptor of the segment, which may stand for a receiver; 0 none is told"),
)
_EXTRA_BYTES: dict[str, tuple[Any, ...]] = {
    "pulse": ("pulse", "its place in the source file"),
    "amplitude": ("amplitude DN", "height above the baseline", "u4", 0.1),
    "amplitude_db": ("Amplitude", "above the detection limit", "i2", 0.01),
    "width": ("echo width", "full width at half maximum", "u2", 0.01),
    "time": ("echo time", "from the first sample"),
    "energy": ("echo energy", "area under the echo"),
    "amplitude_sigma": ("amplitude sigma", "standard error of amplitude"),
    "width_sigma": ("width sigma", "standard error of width"),
    "range_sigma": ("range sigma", "standard error of range"),
    "deviation": ("Deviation", "1000 x rms residual / amplitude", "u2"),
    "baseline": ("baseline", "level of the waveform"),
    "noise_level": ("noise", "of the waveform"),
    "misfit": ("misfit", "reduced chi-square of the fit"),
    "fit_flags": ("fit flags", "bits, see docs/waveforms.md"),
    "water": ("water", "1 surface, 2 bottom"),
    "water_decay": ("water decay", "of the column's light"),
    "water_depth": ("water depth", "of a bottom, vertical"),
    "stacked_pulses": ("stacked pulses", "that show the echo together"),
    "significance": ("significance", "height over standard deviation"),
    "returned_energy": ("returned energy", "energy sent back here"),
}
"""Of LAS: the name there, what is said of it, how it is stored."""

ECHOES = published_columns(_COLUMNS, _EXTRA_BYTES)
