"""Pulses of a Pulse file and the segments that the Waves file holds of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.formats.extents import Extents
from fwclass.read import wave_kernels
from fwclass.read.packets import VECTOR_RANGE
from fwclass.read.pls_compressed import PULSE, unpacked_pulses, unpacked_waves
from fwclass.read.points import ZEROS
from fwclass.read.projection import metres_of
from fwclass.read.pulsewaves import OUTGOING, RETURNING, WAVES_HEADER, PulseSource, Sampling
from fwclass.read.wave_extents import read_waves
from fwclass.read.wave_kernels import CUT_SHORT, NO_WAVES, PAST_END, SEGMENT_COLUMNS, SOUND, TOO_MANY, find_segments
from fwclass.units import METRES_PER_NS

BLOCK = 50_000
"""Pulses that a streaming pass holds at a time."""

MAX_SEGMENTS = 1000
"""A pulse of more segments than this is a damaged one."""

MAX_DURATION = 1e7
"""No segment begins later than this after the anchor [ns]: 1500 km."""

FAULTS = (
    "",
    "no waves",
    "waves past the end",
    "waves cut short",
    "too many segments",
    "compressed waves damaged",
    "unknown pulse descriptor",
    "unusable pulse descriptor",
    "no sane beam vector",
    "no sane duration from the anchor",
    "waveforms missing",
    "zeros in place of the waveforms",
    "no returning samples",
)
"""What a pulse lacks; the index is the code in `Pulses.fault`. The last one is no fault: nothing came back."""

OVERLAPPING = "segments that begin before the one before them ends, left out"

DAMAGED = (*FAULTS[2:4], FAULTS[5], FAULTS[-2], OVERLAPPING)
"""Those that a file shows which was not copied whole, has holes of zeros, or samples at one time twice."""

HOLE = 256
"""Bytes of zeros where waveforms should be that tell a hole: silent pulses in a row, of a few bytes each, fall short of
it; file systems leave holes of 512 bytes and more."""

_BY_WALK = {SOUND: 0, NO_WAVES: 1, PAST_END: 2, CUT_SHORT: 3, TOO_MANY: 4, wave_kernels.DAMAGED: 5}
SILENT = FAULTS.index("no returning samples")

FEW, MISFIT = 10, 0.5
"""Pulses below which nothing is told, and the share of them whose compressed waves are damaged, or run into those of
another pulse, from which the file is another's: sound waves do neither, in whatever order or selection pulses stand."""

UNPACKED = ("waves cut short", "too many segments", "compressed waves damaged")
"""What compressed waves end in that are not what the pulse had."""

OVERLAP = 2
"""Waves may be this many times as long as their file before they are refused."""

RECORD = np.dtype(
    {
        "names": ["time", "waves", "anchor", "target", "first", "last", "bits", "intensity", "class"],
        "formats": ["<i8", "<i8", ("<i4", 3), ("<i4", 3), "<i2", "<i2", "<u2", "u1", "u1"],
        "offsets": [0, 8, 16, 28, 40, 42, 44, 46, 47],
        "itemsize": PULSE,
    }
)
"""A pulse of format 0; attributes and extra bytes behind it are not read."""


ANCHORS = RECORD.fields["intensity"][1] if RECORD.fields else PULSE
"""Bytes of a record before intensity and class: time, place of the waves, anchor, target, descriptor."""


def read_records(source: PulseSource, first: int, last: int) -> NDArray[Any]:
    """The stored pulses [first, last)."""
    length, chunks = source.header.pulse_size, source.header.chunks
    if chunks is not None:
        rows = unpacked_pulses(source.path, chunks, first, last)[:, :PULSE]
    else:
        with source.path.open("rb") as stream:
            stream.seek(source.header.pulses_start + first * length)
            raw = stream.read((last - first) * length)
        if len(raw) != (last - first) * length:
            raise InputError("the file is cut short", where=source.path, do="copy the file again")
        rows = np.frombuffer(raw, np.uint8).reshape(last - first, length)[:, :PULSE]
    empty = np.flatnonzero(~rows[:, :ANCHORS].any(axis=1))
    if len(empty) > ZEROS:
        raise InputError(
            "a part of the file was never written: its pulses are nothing but zeros",
            where=source.path,
            expected=f"at most {ZEROS} such pulses in {last - first}",
            got=f"{len(empty)}, the first of them pulse {first + int(empty[0])}",
            do="wait for the end of the upload, or copy the file again",
        )
    return np.ascontiguousarray(rows).view(RECORD).reshape(-1)


@dataclass(frozen=True)
class Samplings:
    """All samplings of a file as arrays, and which of them every descriptor has.

    `described` (256, 3) and `table` (m, 6) as `wave_kernels.find_segments` wants them; `state` (256,) is the code of
    the fault that every pulse of the descriptor has; `unit`, `centre`, `sends` (outgoing pulses are recorded) by
    descriptor; the others by sampling.
    """

    described: NDArray[np.int64]
    table: NDArray[np.int64]
    state: NDArray[np.uint8]
    unit: NDArray[np.float64]
    centre: NDArray[np.float64]
    sends: NDArray[np.bool_]
    kind: NDArray[np.int64]
    channel: NDArray[np.int64]
    scale: NDArray[np.float64]
    offset: NDArray[np.float64]
    spacing: NDArray[np.float64]
    top: NDArray[np.float32]

    @classmethod
    def of(cls, source: PulseSource) -> Samplings:
        """The samplings of all pulse descriptors of a file."""
        described = np.zeros((256, 3), np.int64)
        state = np.full(256, FAULTS.index("unknown pulse descriptor"), np.uint8)
        unit, centre, sends = np.ones(256), np.full(256, np.nan), np.zeros(256, np.bool_)
        every: list[Sampling] = []
        for index, d in source.descriptors.items():
            state[index] = FAULTS.index("unusable pulse descriptor") if d.fault else 0
            if d.fault:
                continue
            described[index] = d.extra_bytes, len(every), len(d.samplings)
            unit[index], centre[index] = d.unit_ns, d.centre
            sends[index] = any(s.kind == OUTGOING for s in d.samplings)
            every += d.samplings
        table = [
            (s.duration_bits // 8, s.segment_bits // 8, s.length_bits // 8, s.segments, s.samples, s.bits // 8)
            for s in every
        ]
        return cls(
            described,
            np.array(table, np.int64).reshape(-1, 6),
            state,
            unit,
            centre,
            sends,
            np.array([s.kind for s in every], np.int64),
            np.array([s.channel for s in every], np.int64),
            np.array([s.scale for s in every], np.float64),
            np.array([s.offset for s in every], np.float64),
            np.array([s.spacing_ns for s in every], np.float64),
            np.array([2.0**s.bits - 1 for s in every], np.float32),
        )


@dataclass(frozen=True)
class Segments:
    """Segments of pulses: pulse (row of the records), sampling, samples, byte of the first one, begin after the
    anchor [ns]."""

    pulse: NDArray[np.int64]
    sampling: NDArray[np.int64]
    samples: NDArray[np.int64]
    byte: NDArray[np.int64]
    begin: NDArray[np.float64]

    def take(self, index: NDArray) -> Segments:
        """The segments of an index or a mask."""
        return Segments(
            self.pulse[index], self.sampling[index], self.samples[index], self.byte[index], self.begin[index]
        )


@dataclass(frozen=True)
class Pulses:
    """Pulses and what their waves hold: anchor and step [1/ns] up the beam in the file's own units, `anchor_range` [m],
    `fault` codes, all segments, and the bytes `data` that these are in, None without any; `stop` is where the
    compressed waves of each end, 0 for others."""

    time: NDArray[np.float64]
    anchor: NDArray[np.float64]
    step: NDArray[np.float64]
    anchor_range: NDArray[np.float64]
    fault: NDArray[np.uint8]
    segments: Segments
    data: NDArray[np.uint8] | None
    stop: NDArray[np.int64]


def find(source: PulseSource, records: NDArray[Any], kinds: Samplings) -> Pulses:
    """Look at pulses, read their waves and walk through them."""
    index = (records["bits"] & 0xFF).astype(np.int64)
    scales, offsets = np.array(source.scales), np.array(source.offsets)
    anchor = records["anchor"] * scales + offsets
    away = (records["target"].astype(np.int64) - records["anchor"]) * scales
    step = away / (-1000.0 * kinds.unit[index])[:, None]
    if source.mirrored:
        step[:, :2] *= -1.0
    length = np.sqrt(((step * metres_of(source)) ** 2).sum(axis=1))
    fault = kinds.state[index].copy()
    sane = (length >= VECTOR_RANGE[0] * METRES_PER_NS) & (length <= VECTOR_RANGE[1] * METRES_PER_NS)
    fault[(fault == 0) & ~sane] = FAULTS.index("no sane beam vector")
    if source.waves.path is None:
        fault[fault == 0] = FAULTS.index("waveforms missing")
        table, ends = np.empty((0, SEGMENT_COLUMNS), np.int64), np.zeros(len(index), np.int64)
        read, samples, stop = None, None, np.zeros(len(index), np.int64)
    else:
        known = np.where(fault == 0, index, -1)
        read, samples, table, ends, stop = _walk(source, source.waves.path, records["waves"], known, kinds)
    codes = np.array([_BY_WALK[k] for k in range(len(_BY_WALK))], np.uint8)
    fault = np.where(fault == 0, codes[ends], fault)
    sampling = table[:, 1]
    begin = (table[:, 2] * kinds.scale[sampling] + kinds.offset[sampling]) * kinds.unit[index[table[:, 0]]]
    segments = Segments(table[:, 0], sampling, table[:, 3], table[:, 4], begin)
    wild = ~(np.abs(begin) <= MAX_DURATION)
    fault[segments.pulse[wild]] = FAULTS.index("no sane duration from the anchor")
    segments = segments.take(fault[segments.pulse] == 0)
    heard = np.zeros(len(fault), np.bool_)
    heard[segments.pulse[kinds.kind[segments.sampling] == RETURNING]] = True
    fault[(fault == 0) & ~heard] = SILENT
    rows = np.flatnonzero((fault == SILENT) & kinds.sends[index])
    fault[rows[_in_hole(read, rows)]] = SILENT - 1
    time = records["time"] * source.header.time_scale + source.header.time_offset
    return Pulses(time, anchor, step, kinds.centre[index] * kinds.unit[index] * length, fault, segments, samples, stop)


def _in_hole(read: Extents | None, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether nothing but zeros stands where the waves of pulses begin: a sound file has an outgoing pulse there."""
    if read is None or len(read.data) < HOLE:
        return np.zeros(len(rows), np.bool_)
    runs = np.lib.stride_tricks.sliding_window_view(read.data, HOLE)
    inside = read.place[rows] + HOLE <= read.end[rows]
    inside[inside] = ~runs[read.place[rows[inside]]].any(axis=1)
    return inside


def _walk(
    source: PulseSource, path: Path, offset: NDArray[np.int64], descriptor: NDArray[np.int64], kinds: Samplings
) -> tuple[Extents, NDArray[np.uint8], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """What was read, the bytes that hold the samples, the segments in them, what every pulse ended in, where compressed
    waves end."""
    size, count, offset = source.waves.available, 0, np.ascontiguousarray(offset)
    ends, reach, stop = (np.zeros(len(offset), np.int64) for _ in range(3))
    table = np.empty((2 * len(offset), SEGMENT_COLUMNS), np.int64)

    def look(waves: Extents) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        nonlocal count
        held = (waves.data, waves.place, waves.end, offset, size)
        count = int(
            find_segments(
                *held, descriptor, kinds.described, kinds.table, WAVES_HEADER, MAX_SEGMENTS, ends, reach, table
            )
        )
        if count > OVERLAP * size:  # every segment found has samples
            refuse_overlap(source, f"{count} segments")
        return ends, reach

    if source.packed:
        returning = kinds.kind == RETURNING
        unpacked = unpacked_waves(
            path, size, offset, descriptor, kinds.described, kinds.table, returning, WAVES_HEADER, MAX_SEGMENTS
        )
        read, data, offset, unpacking, stop = unpacked
        size = len(data)
        waves = Extents(data, offset, np.full(len(offset), size))
        look(waves)
    else:
        waves = read = read_waves(path, size, offset, (descriptor >= 0) & (offset >= WAVES_HEADER), look)
        data, unpacking = read.data, np.zeros(len(offset), np.int64)
    if count > len(table):
        table = np.empty((count, SEGMENT_COLUMNS), np.int64)
        look(waves)
    return read, data, table[:count], np.where(unpacking == SOUND, ends, unpacking), stop


def waves_fault(source: PulseSource, begins: NDArray[np.int64], pulses: Pulses) -> str:
    """That compressed waves are another file's; `begins` is where those of every pulse stand. "" where they are not."""
    if not source.packed:
        return ""
    places = np.append(np.unique(begins), source.waves.available)
    following = places[np.minimum(np.searchsorted(places, begins, "right"), len(places) - 1)]
    damaged = np.isin(pulses.fault, [FAULTS.index(f) for f in UNPACKED])
    tried = damaged | (pulses.stop > 0)
    wrong = damaged | (pulses.stop > following)
    if tried.sum() < FEW or wrong[tried].mean() < MISFIT:
        return ""
    count = int(wrong[tried].sum())
    return f"compressed waves of {count} of {int(tried.sum())} pulses are damaged or run into others': another file's"


def blocks_of(source: PulseSource) -> Iterator[tuple[NDArray[Any], Pulses]]:
    """(records, what they hold) of consecutive runs over the whole file."""
    kinds = Samplings.of(source)
    for first in range(0, source.n_records, BLOCK):
        records = read_records(source, first, min(first + BLOCK, source.n_records))
        yield records, find(source, records, kinds)


def reach(pulses: Pulses, kinds: Samplings) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least and greatest x, y, z of the first and last returning samples [m]; infinite where there are none."""
    parts = pulses.segments.take(kinds.kind[pulses.segments.sampling] == RETURNING)
    lasts = np.maximum(0, parts.samples - 1) * kinds.spacing[parts.sampling]
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for t in (parts.begin, parts.begin + lasts):
        place = pulses.anchor[parts.pulse] - t[:, None] * pulses.step[parts.pulse]
        low = np.minimum(low, place.min(axis=0, initial=np.inf))
        high = np.maximum(high, place.max(axis=0, initial=-np.inf))
    return low, high


def refuse_overlap(source: PulseSource, got: str) -> NoReturn:
    """`InputError`: more samples are referred to than the file has."""
    raise InputError(
        "the waves of the pulses overlap",
        where=source.path,
        expected=f"at most {source.waves.available} bytes of samples",
        got=got,
        do="the pulses or their descriptors are damaged; export the file again",
    )
