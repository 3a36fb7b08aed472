"""Which quantity the amplitudes and echo widths of a file are: one column holds different ones for different files."""

from __future__ import annotations

from typing import NamedTuple

from fwclass.formats.las_header import SPEC_USERS, Header
from fwclass.read.base import Source
from fwclass.read.beam_source import BeamSource
from fwclass.read.las import LasSource

STEPS = "steps of "
"""Before the size of a step in the samples' unit: amplitudes of a file whose samples are no whole numbers."""

COUNTS, DECIBELS, INTENSITY, FITTED, READ, NONE = "counts", "decibels", "intensity", "fitted", "read", "none"
WORDS = {
    COUNTS: "digitiser counts of fitted echoes [DN]",
    DECIBELS: "decibels [dB], the extra byte `Amplitude`",
    INTENSITY: "the returns' intensity, in the vendor's own scale",
    FITTED: "fitted to the waveforms [ns]",
    READ: "as the file has them [ns], an extra byte",
    NONE: "none",
}
UNITS = {COUNTS: "DN", DECIBELS: "dB", INTENSITY: "", FITTED: "ns", READ: "ns", NONE: ""}

_EXTRA_RECORD, _EXTRA_SIZE = 4, 192
WIDTHS = ("pulse width", "echo width")
"""Extra bytes, in small letters, that hold the echo width [ns]."""


class Quantities(NamedTuple):
    """What a file's columns `amplitude` and `width` are: names of `WORDS`, or `STEPS` and a number."""

    amplitude: str
    width: str


def words_of(quantity: str) -> str:
    """What a quantity is, for people; a name that nobody knows stays itself."""
    if quantity.startswith(STEPS):
        return f"counts of fitted echoes, in {quantity} in the file's samples"
    return WORDS.get(quantity, quantity)


def unit_of(quantity: str) -> str:
    """In which a quantity is counted; "" for none."""
    return UNITS[COUNTS if quantity.startswith(STEPS) else quantity]


def quantities_of(source: Source, waves: bool = True) -> Quantities:
    """By the header alone; of a file whose waveforms cannot be read, or are left aside (without `waves`), those of its
    returns."""
    if waves and source.has_waves and source.waves.kind != "none":
        step = source.scaling.step if isinstance(source, BeamSource) else 1.0
        return Quantities(COUNTS if step == 1.0 else f"{STEPS}{step:.9g}", FITTED)
    names = _extra_names(source.header) if isinstance(source, LasSource) else set()
    amplitude = DECIBELS if "amplitude" in names else INTENSITY
    return Quantities(amplitude, READ if names & set(WIDTHS) else NONE)


def _extra_names(header: Header) -> set[str]:
    """Names of the extra bytes, in small letters."""
    names = set()
    for record in (*header.vlrs, *header.evlrs):
        if record.user in SPEC_USERS and record.number == _EXTRA_RECORD:
            for at in range(0, len(record.body) - _EXTRA_SIZE + 1, _EXTRA_SIZE):
                name = record.body[at + 4 : at + 36].split(b"\0")[0]
                names.add(name.decode("utf-8", "replace").strip().lower())
    return names
