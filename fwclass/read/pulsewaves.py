"""PulseWaves: a Pulse file (.pls) as it presents itself, and the Waves file (.wvs) beside it.

Source: M. Isenburg, PulseWaves specification 0.3. All numbers are little-endian. Where the specification and the
files written by its library differ, the files are followed: stored durations are signed, and the two words after
the composition's sample units are compression and scanner in either order (both are 0 or an index in every file).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fwclass.errors import InputError
from fwclass.formats.checks import counts_fewer
from fwclass.formats.crs import crs_of
from fwclass.formats.extents import read_extent
from fwclass.formats.las_header import NEAR, SEEN_BEHIND
from fwclass.paths import WAVEFORM_ENDINGS, file_beside, open_regular
from fwclass.read.base import Source, WaveStore
from fwclass.read.pls_header import SIGNATURE, SPEC, PulseHeader, read_pulse_header

WAVES_SIGNATURE, WAVES_HEADER = b"PulseWavesWaves\0", 60

DESCRIPTOR_FIRST, DESCRIPTOR_LAST = 200_001, 200_255
COMPOSITION, SAMPLING, DESCRIPTION = 28, 40, 64
"""Bytes of a composition and of a sampling record up to their description, and of the description."""

OUTGOING, RETURNING = 1, 2
FLUCTUATES = -0x70000001
"""Optical centre to anchor: 0x8FFFFFFF says that there is no constant distance."""

DESCRIPTOR_BYTE = 44
"""Of a pulse."""

MIN_UNIT, MAX_UNIT = 0.001, 100.0
"""No laser scanner samples faster or slower than this [ns]; the first is the least that a LAS file can say."""


@dataclass(frozen=True)
class Sampling:
    """How one part of a pulse is sampled.

    Attributes
    ----------
    kind : `OUTGOING` or `RETURNING`.
    channel : of the receiver.
    duration_bits, scale, offset : stored width of a segment's duration from the anchor, and duration [units of the
        composition] = scale x stored + offset.
    segment_bits, length_bits : stored widths of the number of segments and of samples; 0 where they are fixed.
    segments, samples : the fixed numbers.
    bits : of a sample.
    spacing_ns : between samples.
    table : lookup table to physical values, 0 is none; samples are never looked up, they stay [DN].
    """

    kind: int
    channel: int
    duration_bits: int
    scale: float
    offset: float
    segment_bits: int
    length_bits: int
    segments: int
    samples: int
    bits: int
    table: int
    spacing_ns: float
    compression: int

    @property
    def fault(self) -> str:
        """Why it cannot be used; empty if it can."""
        if self.compression:
            return "compressed samples"
        if self.kind not in (OUTGOING, RETURNING):
            return f"sampling of unknown type {self.kind}"
        if self.bits not in (8, 16):
            return f"{self.bits} bits per sample"
        if not MIN_UNIT <= self.spacing_ns <= MAX_UNIT:
            return f"sample spacing of {self.spacing_ns:g} ns"
        if self.duration_bits not in (0, 8, 16, 32) or {self.segment_bits, self.length_bits} - {0, 8, 16}:
            return "unknown width of a duration or a count"
        if not (math.isfinite(self.scale) and math.isfinite(self.offset)):
            return f"durations scaled by {self.scale:g}, offset by {self.offset:g}"
        if self.duration_bits and self.scale == 0.0:
            return "durations scaled by 0"
        return ""


@dataclass(frozen=True)
class PulseDescriptor:
    """How a pulse is sampled: record 200 000 + index.

    `centre` is the time from the optical centre to the anchor [units], NaN where it differs from pulse to pulse;
    `unit_ns` is what durations and the distance to the target (1000 units) are counted in; `fault` is empty or why
    its pulses cannot be used.
    """

    centre: float
    extra_bytes: int
    unit_ns: float
    samplings: tuple[Sampling, ...]
    fault: str


@dataclass(frozen=True, kw_only=True)
class PulseSource(Source):
    """A Pulse file with its Waves file, whose waves may be `packed`."""

    descriptors: Mapping[int, PulseDescriptor]
    header: PulseHeader
    packed: bool

    @property
    def has_waves(self) -> bool:
        return True

    @property
    def sample_dtype(self) -> str:
        wide = any(s.bits > 8 for d in self.descriptors.values() if not d.fault for s in d.samplings)
        return "uint16" if wide else "uint8"


def is_pulse_file(path: Path) -> bool:
    """The file begins with the signature of PulseWaves, or is named like a part of it."""
    if path.suffix.lower() in (".pls", ".plz", *WAVEFORM_ENDINGS[".pls"]):
        return True
    try:
        with open_regular(path) as stream:
            return stream.read(16) == SIGNATURE
    except (OSError, InputError):
        return False


def open_pls(path: Path) -> PulseSource:
    """Look at a Pulse file and for its Waves file.

    `InputError`: no Pulse file of version 0.3, cut short, or a header that contradicts the file.
    """
    if path.suffix.lower() in WAVEFORM_ENDINGS[".pls"]:
        raise InputError("this file holds waveforms, not pulses", where=path, do="give the .pls or .plz beside it")
    header = read_pulse_header(path)
    faults = list(header.faults)
    crs = crs_of(header, faults)
    if header.n_pulses == 0:
        faults.append("the file has no pulses")
    descriptors = _descriptors(header, faults)
    if header.chunks is None:
        _check_count(path, header, descriptors)
    waves, packed = _find_waves(path, header.chunks is not None, faults)
    return PulseSource(
        path=path,
        size=header.size,
        version=header.version,
        compressed=header.chunks is not None,
        n_points=0,
        n_records=header.n_pulses,
        point_format=-1,
        bounds=header.bounds,
        scales=header.scales,
        offsets=header.offsets,
        crs=crs,
        waves=waves,
        packed=packed,
        standard_gps_time=header.standard_gps_time,
        faults=tuple(dict.fromkeys(faults)),
        descriptors=descriptors,
        header=header,
    )


def _descriptors(header: PulseHeader, faults: list[str]) -> dict[int, PulseDescriptor]:
    descriptors: dict[int, PulseDescriptor] = {}
    for record in (*header.vlrs, *header.avlrs):
        if record.user != SPEC or not DESCRIPTOR_FIRST <= record.number <= DESCRIPTOR_LAST:
            continue
        index = record.number - DESCRIPTOR_FIRST + 1
        descriptor = descriptors.setdefault(index, _descriptor(record.body))
        if descriptor.fault:
            faults.append(f"pulse descriptor {index} cannot be used: {descriptor.fault}")
    if not descriptors:
        faults.append("no pulse descriptor is in the file")
    return descriptors


def _check_count(path: Path, header: PulseHeader, descriptors: Mapping[int, PulseDescriptor]) -> None:
    """`InputError` where bytes between the pulses that the header counts and the appended records read as more pulses:
    of a descriptor that the file has, within `NEAR` of the last pulse that is counted, or of the first without one."""
    end = header.pulses_start + header.n_pulses * header.pulse_size
    behind = min([r.start - r.length for r in header.avlrs], default=header.size)
    room = max(0, behind - end) // header.pulse_size
    begin = end - header.pulse_size if header.n_pulses else end
    raw = read_extent(path, begin, end + min(room, SEEN_BEHIND) * header.pulse_size, header.size)
    rows = raw.reshape(-1, header.pulse_size)
    if not len(rows):
        return
    places = rows[:, 16:28].copy().view("<i4") * np.array(header.scales)
    near = (np.abs(places - places[0]) < NEAR).all(axis=1) & np.isin(rows[:, DESCRIPTOR_BYTE], list(descriptors))
    near = near[1:] if header.n_pulses else near
    if 2 * near.sum() > len(near):
        raise counts_fewer(path, header.n_pulses, "pulses", f"room for {room} more, which read as pulses")


def _descriptor(body: bytes) -> PulseDescriptor:
    if len(body) < COMPOSITION + DESCRIPTION:
        return PulseDescriptor(math.nan, 0, 0.0, (), "cut short")
    size, _, centre, extra, count, unit, a, b = struct.unpack_from("<IIiHHfII", body)
    samplings: list[Sampling] = []
    at = size
    fault = "compressed waves" if a and b else ""
    if size < COMPOSITION + DESCRIPTION:
        fault = f"composition record of {size} bytes"
    elif not 0 < unit <= MAX_UNIT:
        fault = f"sample units of {unit:g} ns"
    while not fault and len(samplings) < count:
        if at + SAMPLING + DESCRIPTION > len(body):
            fault = f"{count} samplings promised, {len(samplings)} there"
            break
        length, *values = struct.unpack_from("<I4xBBxBffBBHIHHfI", body, at)
        samplings.append(Sampling(*values))
        fault = samplings[-1].fault or ("" if length >= SAMPLING + DESCRIPTION else f"sampling of {length} bytes")
        at += length
    return PulseDescriptor(math.nan if centre == FLUCTUATES else centre, extra, unit, tuple(samplings), fault)


def _find_waves(path: Path, compressed: bool, faults: list[str]) -> tuple[WaveStore, bool]:
    """The Waves file, and whether it is compressed; beside compressed pulses a .wvz comes first."""
    names = WAVEFORM_ENDINGS[".plz" if compressed else ".pls"]
    waves, why, packed = next(filter(None, (file_beside(path, name) for name in names)), None), "", False
    if waves is None:
        why = f"the waveforms are missing: put {path.with_suffix(names[0]).name} beside {path.name}"
    else:
        with waves.open("rb") as stream:
            head = stream.read(WAVES_HEADER)
        packed = head[16:20] != b"\0\0\0\0"
        if len(head) < WAVES_HEADER or head[:16] != WAVES_SIGNATURE:
            why = f"{waves.name} is no Waves file: it does not begin with PulseWavesWaves"
    if why or waves is None:
        faults.append(why)
        return WaveStore("none", why_not=why), False
    return WaveStore("external", waves, 0, waves.stat().st_size), packed
