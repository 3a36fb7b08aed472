"""A LAS, LAZ or COPC file as it presents itself: what it holds, where its waveforms are, and what is wrong with it."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from fwclass.formats.crs import crs_of
from fwclass.formats.las_header import (
    EVLR_HEADER,
    SPEC_USERS,
    WDP_RECORD,
    WPD_FIRST,
    WPD_LAST,
    Header,
    Record,
    evlr_at,
    packet_endings,
    read_header,
)
from fwclass.formats.laz import check_laz
from fwclass.paths import file_beside
from fwclass.read.base import Source, WaveStore

STANDARD_GPS_TIME = 1
"""Bit of the global encoding."""

PLAIN, LASZIP = 0, 1
"""Compression types of packets that can be read."""


@dataclass(frozen=True)
class Descriptor:
    """How the samples of a packet are stored: `LASF_Spec` record 99 + index.

    `gain` and `offset` turn stored samples into volts. Samples stay as the digitiser wrote them [DN]; the ratio of two
    descriptors' gains makes the energies of their echoes comparable. The offset is in the level that every fit finds.
    """

    bits: int
    compression: int
    n_samples: int
    spacing_ns: float
    gain: float
    offset: float

    @property
    def bytes_per_sample(self) -> int:
        """Bytes of a sample that is not compressed."""
        return (self.bits + 7) // 8

    @property
    def packet_bytes(self) -> int:
        """Bytes of a packet that is not compressed."""
        return self.n_samples * self.bytes_per_sample

    @property
    def has_unit(self) -> bool:
        """Gain and offset could be used."""
        return math.isfinite(self.gain) and math.isfinite(self.offset) and self.gain != 0.0

    @property
    def empty(self) -> bool:
        """A placeholder: many writers fill up to 100 descriptors."""
        return self.n_samples == 0


@dataclass(frozen=True, kw_only=True)
class LasSource(Source):
    """A LAS, LAZ or COPC file."""

    is_copc: bool
    descriptors: Mapping[int, Descriptor]
    header: Header

    @property
    def has_waves(self) -> bool:
        """The point format declares waveforms, whether or not they can be read."""
        return self.header.has_waves

    @property
    def sample_dtype(self) -> str:
        """One dtype for the whole file: the widest that its descriptors ask for."""
        wide = any(d.bytes_per_sample == 2 and not d.empty for d in self.descriptors.values())
        return "uint16" if wide else "uint8"


def open_las(path: Path) -> LasSource:
    """Look at a LAS file without reading its points.

    `InputError`: no LAS file, empty, cut short, or a header that contradicts the file.
    """
    header = read_header(path)
    if header.compressed:
        check_laz(header)
    faults = list(header.faults)
    crs = crs_of(header, faults)
    descriptors = _descriptors(header, faults)
    waves = _find_waves(header, faults, packet_endings((*header.vlrs, *header.evlrs)))
    if header.n_points == 0:
        faults.append("the file has no points")
    if header.has_waves and not descriptors:
        faults.append("the point format has waveforms, but no waveform packet descriptor is in the file")
    copc = any(r.user == "copc" and r.number == 1 for r in header.vlrs)
    return LasSource(
        path=path,
        size=header.size,
        version=header.version,
        compressed=header.compressed,
        n_points=header.n_points,
        n_records=header.n_points,
        point_format=header.point_format,
        bounds=header.bounds,
        scales=header.scales,
        offsets=header.offsets,
        crs=crs,
        waves=waves,
        standard_gps_time=bool(header.global_encoding & STANDARD_GPS_TIME),
        faults=tuple(dict.fromkeys(faults)),
        is_copc=copc,
        descriptors=descriptors,
        header=header,
    )


def _descriptors(header: Header, faults: list[str]) -> dict[int, Descriptor]:
    descriptors: dict[int, Descriptor] = {}
    if not header.has_waves:
        return descriptors
    for record in (*header.vlrs, *header.evlrs):
        if record.user not in SPEC_USERS or not WPD_FIRST <= record.number <= WPD_LAST:
            continue
        index = record.number - WPD_FIRST + 1
        if len(record.body) < 26:
            faults.append(f"waveform packet descriptor {index} is cut short")
            continue
        bits, compression, n, spacing, gain, offset = struct.unpack_from("<BBIIdd", record.body)
        descriptor = descriptors.setdefault(index, Descriptor(bits, compression, n, spacing * 1e-3, gain, offset))
        if not descriptor.empty and not descriptor.has_unit:
            faults.append(f"waveform packet descriptor {index} has gain {gain:g} and offset {offset:g}: no volts")
    return descriptors


def _find_waves(header: Header, faults: list[str], endings: tuple[str, ...]) -> WaveStore:
    """`endings`: of the files beside that may hold them, the likeliest first."""
    if not header.has_waves:
        return WaveStore("none", why_not="the point format has no waveforms")
    internal = bool(header.global_encoding & 2)
    for inside in (internal, not internal):
        waves = _internal(header, faults) if inside else _external(header, faults, endings)
        if waves is not None:
            return waves
    expected = header.path.with_suffix(endings[0]).name
    why = f"the waveforms are missing: put {expected} beside {header.path.name}"
    if internal:
        why = f"the waveforms that the header places in the file are not there, and there is no {expected}"
    elif ".wdz" not in endings and (other := file_beside(header.path, ".wdz")) is not None:
        why += f" ({other.name} is there, but its descriptors are of packets that are not compressed)"
    faults.append(why)
    return WaveStore("none", why_not=why)


def _external(header: Header, faults: list[str], endings: tuple[str, ...]) -> WaveStore | None:
    path = next((p for p in (file_beside(header.path, ending) for ending in endings) if p is not None), None)
    if path is None:
        return None
    size = path.stat().st_size
    if size <= EVLR_HEADER:
        faults.append(f"{path.name} holds no waveforms ({size} bytes)")
        return None
    with path.open("rb") as stream:
        user, number = struct.unpack_from("<16sH", stream.read(EVLR_HEADER), 2)
    if number != WDP_RECORD or user.split(b"\0")[0].decode("latin1") not in SPEC_USERS:
        faults.append(f"{path.name} does not start with a waveform record; its packets may be wrong")
    return WaveStore("external", path, 0, size)


def _internal(header: Header, faults: list[str]) -> WaveStore | None:
    stated = header.wave_start
    with header.path.open("rb") as stream:
        record = evlr_at(stream, stated, header.size) if stated else None
    if record is None or not _is_waves(record):
        # the start is stale after LAS -> LAZ; the record itself is still among the extended ones
        others = [r for r in header.evlrs if _is_waves(r)]
        if stated and others:
            faults.append("the header's start of the waveforms is stale; the record was found elsewhere")
        record = others[0] if others else None
    if record is None:
        return None
    held = header.size - record.start
    if EVLR_HEADER + record.length > held:
        faults.append(f"the waveform record is cut short: {record.length} bytes stated, {held - EVLR_HEADER} there")
    available = min(EVLR_HEADER + record.length, held) if record.length else held
    return WaveStore("internal", header.path, record.start, available)


def _is_waves(record: Record) -> bool:
    return record.number == WDP_RECORD and record.user in SPEC_USERS
