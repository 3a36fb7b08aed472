"""Every column of every table, declared once.

The stages, the store, the LAS extra bytes, the GeoParquet metadata and the manual all read these records.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Column:
    """One column of any table.

    Attributes
    ----------
    name : the field's standard term; neighbourhood features carry their scale, as in ``echo_ratio_r100``.
    dtype : numpy dtype as text.
    unit : SI or field unit; "" for counts, codes and fractions.
    meaning : one sentence.
    null : the value that says "no value"; None where every row has one.
    low, high : range of valid values, or None.
    source : paper and equation, or the format's field.
    las : name as a LAS extra byte, or "" if the column has a field of its own in LAS or is not published.
    las_about : what the extra byte's 32 bytes of description say after the unit; "": the first words of `meaning`.
    las_dtype, las_scale : how the extra byte stores it: value = scale x stored number; "" stores `dtype` itself.
        Where `null` is NaN and the stored type is whole, the lowest number (signed) or the highest (unsigned) stands
        for "no value" and is declared as the extra byte's no-data value.
    """

    name: str
    dtype: str
    unit: str
    meaning: str
    null: float | None = None
    low: float | None = None
    high: float | None = None
    source: str = ""
    las: str = ""
    las_about: str = ""
    las_dtype: str = ""
    las_scale: float = 1.0


NAN = float("nan")

_DECLARED = (
    # who an echo is; (strip, pulse, echo_number) is unique and the canonical order
    Column("strip", "u2", "", "index of the source file in the survey's sorted list"),
    Column("pulse", "u4", "", "index of the pulse in its strip, in order of first appearance in the file"),
    Column("echo_number", "u1", "", "place of the echo in its pulse, 1 is nearest to the sensor", low=1),
    Column("number_of_echoes", "u1", "", "echoes of the pulse", low=1),
    Column("origin", "u1", "", "0 fitted to a waveform, 1 vendor return without usable packet, 2 read as an echo"),
    # where it is
    Column("x", "f8", "m", "easting in the survey's CRS, whole millimetres"),
    Column("y", "f8", "m", "northing in the survey's CRS, whole millimetres"),
    Column("z", "f8", "m", "height in the survey's CRS, whole millimetres"),
    Column("gps_time", "f8", "s", "time of the pulse as the source gives it", null=NAN),
    Column("beam_x", "f4", "", "unit vector from sensor to target, east", null=NAN, low=-1, high=1),
    Column("beam_y", "f4", "", "unit vector from sensor to target, north", null=NAN, low=-1, high=1),
    Column("beam_z", "f4", "", "unit vector from sensor to target, up (negative)", null=NAN, low=-1, high=1),
    # what the waveform says
    Column(
        "amplitude",
        "f4",
        "DN",
        "height of the fitted echo above the baseline; a kept return's vendor amplitude [dB] or intensity",
        null=NAN,
        low=0,
        las="amplitude DN",
        las_about="height above the baseline",
    ),
    Column(
        "amplitude_db",
        "f4",
        "dB",
        "10 log10 of amplitude over the strip's detection limit; vendor's value where read",
        null=NAN,
        source="RIEGL extra byte `Amplitude`",
        las="Amplitude",
        las_about="above the detection limit",
        las_dtype="i2",
        las_scale=0.01,
    ),
    Column(
        "width",
        "f4",
        "ns",
        "echo width, full width at half maximum",
        null=NAN,
        low=0,
        las="echo width",
        las_about="full width at half maximum",
    ),
    Column(
        "time",
        "f4",
        "ns",
        "time of the echo in its waveform, from the first sample of the pulse's first segment",
        null=NAN,
        las="echo time",
        las_about="from the first sample",
    ),
    Column(
        "energy",
        "f4",
        "DN ns",
        "area under the fitted echo, times the segment's relative gain",
        null=NAN,
        low=0,
        las="echo energy",
        las_about="area under the echo",
    ),
    Column(
        "amplitude_sigma",
        "f4",
        "DN",
        "standard error of amplitude, from the fit's covariance",
        null=NAN,
        low=0,
        las="amplitude sigma",
        las_about="standard error of amplitude",
    ),
    Column(
        "width_sigma",
        "f4",
        "ns",
        "standard error of width, from the fit's covariance",
        null=NAN,
        low=0,
        las="width sigma",
        las_about="standard error of width",
    ),
    Column(
        "range_sigma",
        "f4",
        "m",
        "standard error of the echo's place along the beam, from the fit's covariance",
        null=NAN,
        low=0,
        las="range sigma",
        las_about="standard error of range",
    ),
    Column(
        "deviation",
        "f4",
        "",
        "1000 x root mean square residual around the echo over its amplitude; 0 is the system's pulse",
        null=NAN,
        low=0,
        source="RIEGL extra byte `Deviation`",
        las="Deviation",
        las_about="1000 x rms residual / amplitude",
        las_dtype="u2",
    ),
    Column("beam_range", "f4", "m", "distance from the sensor, where the source gives its place", null=NAN, low=0),
    Column(
        "baseline",
        "f4",
        "DN",
        "level of the waveform without echoes",
        null=NAN,
        las="baseline",
        las_about="level of the waveform",
    ),
    Column(
        "noise",
        "f4",
        "DN",
        "standard deviation of the waveform's noise",
        null=NAN,
        low=0,
        las="noise",
        las_about="of the waveform",
    ),
    Column(
        "misfit",
        "f4",
        "",
        "reduced chi-square of the pulse's fit",
        null=NAN,
        low=0,
        las="misfit",
        las_about="reduced chi-square of the fit",
    ),
    Column(
        "fit_flags",
        "u1",
        "",
        "1 saturated, 2 overlapping, 4 poor fit, 8 at the segment's edge, 16 vendor return kept, "
        "32 far from the vendor's returns, 64 not fitted for want of a usable waveform",
        las="fit flags",
        las_about="bits, see docs/waveforms.md",
    ),
    Column("source_class", "u1", "", "class code of the nearest return of the pulse in the source file"),
    Column("intensity", "u2", "", "intensity of the nearest return of the pulse in the source file"),
    # returns, as read
    Column("return_number", "u1", "", "vendor's return number; 0 occurs in faulty files"),
    Column("number_of_returns", "u1", "", "vendor's number of returns of the pulse"),
    Column(
        "location", "f4", "ns", "vendor's return location, from the first sample of the pulse's first segment", null=NAN
    ),
    Column("has_packet", "bool", "", "the return's waveform packet could be read"),
    Column("vendor_amplitude", "f4", "dB", "extra byte `Amplitude` of the source", null=NAN),
    Column("vendor_width", "f4", "ns", "extra byte `Pulse width` of the source", null=NAN),
    Column("vendor_deviation", "f4", "", "extra byte `Deviation` of the source", null=NAN),
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
    Column(
        "outgoing_start",
        "f4",
        "ns",
        "first sample of the recorded outgoing pulse after the pulse's time origin",
        null=NAN,
    ),
    Column("sample_spacing", "f4", "ns", "time between samples", low=0),
    Column("saturation", "f4", "DN", "highest value that the digitiser can record"),
    Column("gain", "f4", "", "volts a DN of the segment over those of the file's first waveform descriptor", low=0),
    # ground
    Column("ground", "bool", "", "the ground filter took the echo for ground"),
    Column("noise", "bool", "", "the ground filter took the echo for no surface: far below its surroundings, or alone"),
    Column(
        "height_above_ground",
        "f4",
        "m",
        "z minus the terrain model under the echo",
        null=NAN,
        las="HeightAboveGround",
        las_about="above the terrain model",
    ),
    # neighbourhood features; the name in the tables carries the radius
    Column(
        "zc",
        "f4",
        "m",
        "z minus the lowest z of the 12 m x 10 m cell",
        null=NAN,
        low=0,
        source="Fan 2013, 2.1",
        las="zc",
        las_about="above the lowest of its cell",
    ),
    Column(
        "inclination",
        "f4",
        "deg",
        "angle between local normal and vertical",
        null=NAN,
        low=0,
        high=90,
        source="Fan 2013, 2.2",
        las="inclination",
        las_about="local normal to vertical",
    ),
    Column(
        "echo_ratio",
        "f4",
        "",
        "echoes in the sphere / echoes in the vertical cylinder",
        null=NAN,
        low=0,
        high=1,
        source="Fan 2013, eq. 2",
        las="echo ratio",
        las_about="echoes in sphere / in cylinder",
    ),
    Column(
        "linearity",
        "f4",
        "",
        "(l1 - l2) / l1 of the neighbourhood's covariance, l1 >= l2 >= l3",
        null=NAN,
        low=0,
        high=1,
        source="Demantke 2011",
    ),
    Column(
        "planarity",
        "f4",
        "",
        "(l2 - l3) / l1 of the neighbourhood's covariance",
        null=NAN,
        low=0,
        high=1,
        source="Demantke 2011",
    ),
    Column(
        "sphericity",
        "f4",
        "",
        "l3 / l1 of the neighbourhood's covariance",
        null=NAN,
        low=0,
        high=1,
        source="Demantke 2011",
    ),
    Column(
        "roughness",
        "f4",
        "m",
        "root mean square distance of the neighbours from their fitted plane",
        null=NAN,
        low=0,
        source="Shi 2019, plane residual",
    ),
    Column(
        "height_std",
        "f4",
        "m",
        "standard deviation of z in the sphere",
        null=NAN,
        low=0,
        source="Xiong 2018; Shi 2019, HV",
    ),
    Column(
        "height_range",
        "f4",
        "m",
        "highest minus lowest z in the sphere",
        null=NAN,
        low=0,
        source="Xiong 2018",
    ),
    Column("height_above_lowest", "f4", "m", "z minus the lowest z in the vertical cylinder", null=NAN, low=0),
    Column("density", "f4", "1/m2", "echoes in the vertical cylinder per area of its circle", null=NAN, low=0),
    Column(
        "first_share",
        "f4",
        "",
        "share of first echoes, single ones included, in the sphere",
        null=NAN,
        low=0,
        high=1,
        source="Xiong 2018, EBI",
    ),
    Column(
        "last_share",
        "f4",
        "",
        "share of last echoes, single ones included, in the sphere",
        null=NAN,
        low=0,
        high=1,
        source="Xiong 2018, EGI",
    ),
    # the local surface, for radiometry
    Column("normal_x", "f4", "", "upward unit normal of the neighbourhood, east", null=NAN, low=-1, high=1),
    Column("normal_y", "f4", "", "upward unit normal of the neighbourhood, north", null=NAN, low=-1, high=1),
    Column("normal_z", "f4", "", "upward unit normal of the neighbourhood, up", null=NAN, low=0, high=1),
    # radiometry
    Column(
        "range",
        "f4",
        "m",
        "distance from the sensor to the echo",
        null=NAN,
        low=0,
        las="range",
        las_about="from sensor to echo",
    ),
    Column(
        "incidence",
        "f4",
        "deg",
        "angle between the beam and the local normal",
        null=NAN,
        low=0,
        high=90,
        las="incidence angle",
        las_about="beam to local normal",
    ),
    Column(
        "cross_section",
        "f4",
        "m2",
        "backscatter cross-section sigma of the echo",
        null=NAN,
        low=0,
        source="Wagner 2006, eq. 9; Wagner 2008",
        las="cross section",
        las_about="backscatter cross-section",
    ),
    Column(
        "backscatter",
        "f4",
        "",
        "backscatter coefficient gamma = sigma / (A_i cos(incidence)); relative where no target calibrates it",
        null=NAN,
        low=0,
        source="Fan 2013, eq. 3; Wagner 2008",
        las="backscatter",
        las_about="coefficient, 4 x reflectance",
    ),
    Column(
        "reflectance",
        "f4",
        "dB",
        "10 log10 of the cross-section over that of a white matt surface that faces the beam",
        null=NAN,
        source="RIEGL extra byte `Reflectance`",
        las="Reflectance",
        las_about="over white facing the beam",
        las_dtype="i2",
        las_scale=0.01,
    ),
    Column(
        "radiometry_flags",
        "u1",
        "",
        "1 one of several echoes, 2 no range, 4 no normal, 8 incidence clipped, 16 saturated, 32 uncalibrated",
        las="radiometry flags",
        las_about="bits, see docs/radiometry.md",
    ),
    # classes
    Column("reference", "u1", "", "reference class code; 0 is none"),
    Column("classification", "u1", "", "class code given by the forest"),
    Column(
        "confidence",
        "f4",
        "",
        "share of the forest's votes for the class",
        low=0,
        high=1,
        las="confidence",
        las_about="share of the forest's votes",
    ),
)

COLUMNS: dict[str, Column] = {c.name: c for c in _DECLARED}
