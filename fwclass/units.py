"""Physical constants and conversions, each once."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta

SPEED_OF_LIGHT = 299_792_458.0
"""In vacuum [m/s]."""

REFRACTIVE_INDEX = 1.000273
"""Group index of air at 1550 nm, 15 °C, 1013 hPa (Ciddor 1996)."""

METRES_PER_NS = SPEED_OF_LIGHT * 1e-9 / (2.0 * REFRACTIVE_INDEX)
"""One-way distance that one nanosecond of two-way travel time stands for [m/ns]."""

FWHM_PER_SIGMA = 2.0 * math.sqrt(2.0 * math.log(2.0))
"""Full width at half maximum of a Gaussian of unit standard deviation."""

SIGMA_PER_MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""

ERROR_OF_MEDIAN = 1.2533
"""Standard error of a median over that of a mean, of normal values."""

AREA_PER_FWHM = math.sqrt(math.pi / (4.0 * math.log(2.0)))
"""Area of a Gaussian of unit height and unit full width at half maximum."""

LAND = (-500.0, 9000.0)
"""m, heights of land: the Dead Sea's shore lies at -438, Mount Everest at 8849."""

GPS_EPOCH, GPS_WEEK = datetime(1980, 1, 6, tzinfo=UTC), 604_800.0
"""Where GPS time begins, and its week [s]."""

ADJUSTED = 1e9
"""s, that adjusted standard GPS time leaves out of GPS time (LAS 1.4 R15, global encoding)."""

LEAP_SECONDS = 18
"""GPS time less UTC since 2017; a survey of 2012 is dated two seconds off."""

MIB, GIB = 1 << 20, 1 << 30
"""Bytes."""

QUANTUM = 0.001
"""Step of every coordinate in the store [m]; millimetres are exact integers in float64 and, as
differences below 16 km, in float32."""


def utc_of(time: float) -> datetime:
    """UTC of an adjusted standard GPS time [s]."""
    return GPS_EPOCH + timedelta(seconds=time + ADJUSTED - LEAP_SECONDS)


def finite_or_none(value: float) -> float | None:
    """`value` for JSON, which has neither NaN nor infinity."""
    return float(value) if math.isfinite(value) else None


def number_of(word: str) -> float:
    """The number that a word of a file is; `ValueError` for none, also for what Python alone takes for one (``1_5`` for
    15, digits of other scripts)."""
    if "_" in word or not word.isascii():
        raise ValueError(f"no number: {word[:40]!r}")
    return float(word)
