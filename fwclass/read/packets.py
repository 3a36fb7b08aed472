"""Waveform packets: which of those that points refer to can be used, and their samples."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.formats.extents import read_extents
from fwclass.formats.las_header import EVLR_HEADER
from fwclass.read.compressed_packets import SHORTEST, decompress
from fwclass.read.las import LASZIP, PLAIN, LasSource
from fwclass.read.layout import lay_out
from fwclass.read.packet_kernels import first_anchors, gather
from fwclass.read.packet_references import References
from fwclass.read.projection import metres_of
from fwclass.units import METRES_PER_NS

FAULTS = (
    "",
    "no packet",
    "unknown descriptor",
    "unknown compression of packets",
    "unsupported samples",
    "invalid sample spacing",
    "packet size too small",
    "waveforms missing",
    "packet inside the record's header",
    "packet past the end",
    "packet cut short",
    "packet shared by too many returns",
    "no sane return location or beam vector",
    "compressed packet damaged, or another file's",
)
"""Why a return has no usable packet; the index is the code in `judge`. The last one shows only where it is read."""

DAMAGED = FAULTS.index("compressed packet damaged, or another file's")

VECTOR_RANGE = (0.7, 1.5)
"""Sane lengths of the stored beam vector, in units of c / 2n: water (0.75) passes, zeros, metres and the way there
alone do not."""

MAX_SPACING = 100.0
"""No laser scanner samples slower than this [ns]: 15 m a sample."""

REPEATED = "waveform packet repeats samples of the return before (taken once)"
UNITLESS = "descriptor without a usable gain or offset (taken for the gain of the others)"
LONGER = "waveform packet larger than its descriptor says (what it holds beyond is left out)"
PADDED = 8
"""Bytes behind the samples of a packet that may be padding."""

MOST_GAIN = 1e4
"""Ratio of two descriptors' gains that a receiver may have; more is a mistake."""

_OVERLAP = 2

PAIRS = 4096
"""Pairs of packets that are compared at once."""

MOST_PACKED = 1024
"""Samples of a compressed packet take at most so many times its bytes: 5000 equal ones of 16 bits take 300 times."""

UNPACKED, UNPACKED_FREE = 32, 8 << 20
"""All packets of a span together take at most so many times the bytes of their file, and so many bytes for nothing;
real ones take three times as many."""


@dataclass(frozen=True)
class _Lookup:
    """The descriptors of a file as arrays over the 256 possible indices."""

    fault: NDArray[np.uint8]
    samples: NDArray[np.int64]
    bytes: NDArray[np.int64]
    wide: NDArray[np.bool_]
    packed: NDArray[np.bool_]
    spacing: NDArray[np.float64]
    top: NDArray[np.float32]
    unitless: NDArray[np.bool_]
    gain: NDArray[np.float32]

    @classmethod
    def of(cls, source: LasSource) -> _Lookup:
        fault = np.full(256, FAULTS.index("unknown descriptor"), np.uint8)
        fault[0] = FAULTS.index("no packet")
        samples, length = np.zeros(256, np.int64), np.zeros(256, np.int64)
        wide, spacing, top = np.zeros(256, np.bool_), np.zeros(256), np.zeros(256, np.float32)
        unitless, packed = np.zeros(256, np.bool_), np.zeros(256, np.bool_)
        for i, d in source.descriptors.items():
            samples[i], length[i], wide[i] = d.n_samples, d.packet_bytes, d.bytes_per_sample == 2
            spacing[i], top[i] = d.spacing_ns, float(2 ** min(d.bits, 16) - 1)
            fault[i], unitless[i], packed[i] = 0, not d.has_unit, d.compression == LASZIP
            if d.compression not in (PLAIN, LASZIP):
                fault[i] = FAULTS.index("unknown compression of packets")
            elif d.empty or not (d.bits in (8, 16) if packed[i] else 1 <= d.bits <= 16):
                fault[i] = FAULTS.index("unsupported samples")
            elif not 0 < d.spacing_ns <= MAX_SPACING:
                fault[i] = FAULTS.index("invalid sample spacing")
        return cls(fault, samples, length, wide, packed, spacing, top, unitless, _relative_gains(source))


def _relative_gains(source: LasSource) -> NDArray[np.float32]:
    """Volts a DN of every descriptor over those of the first that has samples; 1 where one of them is not usable."""
    used = {i: d for i, d in sorted(source.descriptors.items()) if not d.empty}
    first = next((d.gain for d in used.values() if d.has_unit and d.gain > 0.0), 1.0)
    relative = np.ones(256, np.float32)
    for i, d in used.items():
        share = d.gain / first
        if d.has_unit and MOST_GAIN > share > 1.0 / MOST_GAIN:
            relative[i] = share
    return relative


def judge(source: LasSource, refs: References, shared: tuple[int, ...] = ()) -> NDArray[np.uint8]:
    """Index into `FAULTS` for every point; 0 where its packet can be used."""
    table = _Lookup.of(source)
    index = refs.descriptor
    packed, whole = table.packed[index], table.bytes[index]
    need = np.where(packed, refs.size, whole).astype(np.uint64)
    least = np.where(packed, np.maximum(whole // MOST_PACKED, 1 + table.wide[index] + SHORTEST), whole)
    available = np.uint64(source.waves.available)
    fault = table.fault[index].copy()

    def mark(name: str, where: NDArray[np.bool_]) -> None:
        fault[(fault == 0) & where] = FAULTS.index(name)

    mark("packet size too small", refs.size < least)
    mark("waveforms missing", np.full(len(fault), source.waves.kind == "none"))
    mark("packet inside the record's header", refs.offset < EVLR_HEADER)
    mark("packet past the end", refs.offset >= available)
    mark("packet cut short", need > available - np.minimum(refs.offset, available))
    if shared:
        key = (index.astype(np.uint64) << np.uint64(56)) | refs.offset
        mark("packet shared by too many returns", np.isin(key, np.array(shared, np.uint64)))
    mark("no sane return location or beam vector", ~_sane(table, refs, metres_of(source)))
    return fault


def longer(source: LasSource, refs: References) -> NDArray[np.bool_]:
    """Per point whether its packet is plain and holds more than the samples that its descriptor names."""
    return _longer(_Lookup.of(source), refs)


def _longer(table: _Lookup, refs: References) -> NDArray[np.bool_]:
    index = refs.descriptor
    return ~table.packed[index] & (refs.size.astype(np.int64) > table.bytes[index] + PADDED)


def looked_into(source: LasSource, refs: References) -> NDArray[np.uint8]:
    """As `judge`, and compressed packets are read to see whether they are sound."""
    fault, table = judge(source, refs), _Lookup.of(source)
    point = np.flatnonzero((fault == 0) & table.packed[refs.descriptor])
    if len(point):
        _, first, packet = np.unique(refs.offset[point], return_index=True, return_inverse=True)
        fault[point[_stored(source, refs, table, point[first]).damaged[packet]]] = DAMAGED
    return fault


def repeats(source: LasSource, first: References, second: References, after: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Per pair of usable packets of one descriptor whether the second, which begins `after` samples after the first,
    holds the same samples wherever both have some."""
    table, same = _Lookup.of(source), np.zeros(len(after), np.bool_)
    order = np.lexsort((after, first.descriptor))
    breaks = np.flatnonzero((np.diff(after[order]) != 0) | (np.diff(first.descriptor[order]) != 0)) + 1
    for alike in np.split(order, breaks):
        for pair in np.split(alike, range(PAIRS, len(alike), PAIRS)):
            if len(pair):
                same[pair] = _repeat(source, table, first.take(pair), second.take(pair), int(after[pair[0]]))
    return same


def _repeat(source: LasSource, table: _Lookup, first: References, second: References, after: int) -> NDArray[np.bool_]:
    refs = References(*(np.concatenate([getattr(first, f.name), getattr(second, f.name)]) for f in fields(References)))
    _, point, packet = np.unique(refs.offset, return_index=True, return_inverse=True)
    stored = _stored(source, refs, table, point)
    start = np.full(len(point), -1, np.int64)
    start[~stored.damaged] = stored.start
    a, b = np.split(start[packet], 2)
    same = (a >= 0) & (b >= 0)
    bytes_each = 1 + int(stored.wide.any())
    byte = np.arange((int(table.samples[first.descriptor[0]]) - after) * bytes_each)
    one, two = ((at[same])[:, None] + byte for at in (a + after * bytes_each, b))
    same[same] = (stored.data[one] == stored.data[two]).all(axis=1)
    return same


def _sane(table: _Lookup, refs: References, metres: tuple[float, float, float]) -> NDArray[np.bool_]:
    """The location lies within one segment's length of the segment, and the vector, `metres` a unit of x, y and z, is
    as long as light demands."""
    length = np.sqrt(((refs.step * metres) ** 2).sum(axis=1)) / METRES_PER_NS
    lasts = (table.samples * table.spacing)[refs.descriptor]
    near = (refs.location >= -lasts) & (refs.location <= 2 * lasts)
    return near & (length >= VECTOR_RANGE[0]) & (length <= VECTOR_RANGE[1])


@dataclass(frozen=True)
class Packets:
    """The waveforms of a run of points.

    Attributes
    ----------
    anchor : per segment of the pulses **with** a usable packet its anchor point.
    pulse : pulse of those segments.
    start : first sample of the segment after that of the pulse's first [ns].
    spacing, saturation, gain : [ns], [DN], relative to the file's first descriptor.
    descriptor : index of each.
    samples, offsets : ragged samples, one row per segment.
    has_packet : per point, whether its packet is usable.
    shift : per point the first sample of its packet after that of its pulse's first [ns]; 0 without packet.
    faults : returns without a usable packet, by reason.
    """

    anchor: NDArray[np.int64]
    pulse: NDArray[np.int64]
    start: NDArray[np.float64]
    spacing: NDArray[np.float64]
    saturation: NDArray[np.float32]
    gain: NDArray[np.float32]
    descriptor: NDArray[np.uint8]
    samples: NDArray[np.uint8] | NDArray[np.uint16]
    offsets: NDArray[np.int64]
    has_packet: NDArray[np.bool_]
    shift: NDArray[np.float64]
    faults: Mapping[str, int]


def gather_packets(
    source: LasSource,
    refs: References,
    packet: NDArray[np.int64],
    pulse: NDArray[np.int64],
    place: NDArray[np.float64],
    return_number: NDArray[np.uint8],
    shared: tuple[int, ...],
) -> Packets:
    """Read the usable packets of points, one row per segment, by pulse and along the beam.

    `packet`, `pulse` (n,) as `pulses_of` gives them, `place` (n, 3) [m].
    """
    fault = judge(source, refs, shared)
    anchors = np.empty(int(packet.max(initial=-1)) + 1, np.int64)
    first_anchors(packet, fault == 0, return_number, anchors)
    table = _Lookup.of(source)
    stored = _stored(source, refs, table, anchors[anchors >= 0])
    fault, anchors = _without_damaged(stored.damaged, fault, anchors, packet)
    with_packet = np.flatnonzero(anchors >= 0)
    anchor = anchors[with_packet]
    has_packet = anchors[packet] >= 0
    index = refs.descriptor[anchor]
    layout = lay_out(
        pulse[anchor],
        place[anchor],
        refs.step[anchor],
        refs.location[anchor],
        table.samples[index] * table.spacing[index],
        table.spacing[index],
        table.top[index],
    )
    shift = np.zeros(len(anchors))
    shift[with_packet] = layout.shift
    ends = np.concatenate([[0], np.cumsum((table.samples[index] - layout.skip)[layout.order])]).astype(np.int64)
    first_of_row = np.searchsorted(layout.row[layout.order], np.arange(len(layout.head) + 1))
    head = anchor[layout.head]
    samples = np.empty(int(ends[-1]), np.dtype(source.sample_dtype))
    if len(index):
        begin = stored.start + layout.skip * (1 + stored.wide)
        gather(stored.data, begin[layout.order], stored.wide[layout.order], ends, samples)
    return Packets(
        head,
        pulse[head],
        layout.start,
        table.spacing[index[layout.head]],
        table.top[index[layout.head]],
        table.gain[index[layout.head]],
        index[layout.head],
        samples,
        ends[first_of_row],
        has_packet,
        shift[packet],
        _count(table, refs, fault, has_packet) | _repeated(layout.skip),
    )


@dataclass(frozen=True)
class _Stored:
    """Where the samples of packets are: bytes, where each packet begins, whether its samples have two bytes; and which
    of the packets that were asked for are `damaged`: the others do not have them."""

    data: NDArray[np.uint8]
    start: NDArray[np.int64]
    wide: NDArray[np.bool_]
    damaged: NDArray[np.bool_]


def _stored(source: LasSource, refs: References, table: _Lookup, anchor: NDArray[np.int64]) -> _Stored:
    """The packets of `anchor` points: in the file, or taken out of it where some are compressed."""
    index, none = refs.descriptor[anchor], np.zeros(len(anchor), np.bool_)
    packed, wide = table.packed[index], table.wide[index]
    size = np.where(packed, refs.size[anchor], table.bytes[index]).astype(np.int64)
    _refuse_overlap(source, int(size.sum()))
    if packed.any():
        _refuse_swollen(source, int(table.bytes[index].sum()))
    if len(anchor) == 0 or source.waves.path is None:
        return _Stored(np.empty(0, np.uint8), np.empty(0, np.int64), wide[:0], none[:0])
    begin = refs.offset[anchor].astype(np.int64) + source.waves.base
    read = read_extents(source.waves.path, begin, begin + size, source.waves.base + source.waves.available)
    if not packed.any():
        return _Stored(read.data, read.place, wide, none)
    samples, ends, sound = decompress(read.data, read.place, size, wide, packed, table.samples[index])
    all_wide = np.ones(int(sound.sum()), np.bool_)
    return _Stored(samples.astype("<u2", copy=False).view(np.uint8), 2 * ends[:-1][sound], all_wide, ~sound)


def _without_damaged(
    damaged: NDArray[np.bool_], fault: NDArray[np.uint8], anchors: NDArray[np.int64], packet: NDArray[np.int64]
) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """`fault` with that of damaged packets at all their points, and `anchors` without them."""
    lost = np.flatnonzero(anchors >= 0)[damaged]
    if len(lost) == 0:
        return fault, anchors
    anchors = anchors.copy()
    anchors[lost] = -1
    return np.where((fault == 0) & (anchors[packet] < 0), np.uint8(DAMAGED), fault), anchors


def _count(table: _Lookup, refs: References, fault: NDArray[np.uint8], has_packet: NDArray[np.bool_]) -> dict[str, int]:
    """Returns without a usable packet by reason, those whose samples have no usable unit, and those with more."""
    counts = np.bincount(fault[~has_packet], minlength=len(FAULTS))
    faults = {name: int(n) for name, n in zip(FAULTS, counts, strict=True) if n and name}
    usable = {UNITLESS: table.unitless[refs.descriptor], LONGER: _longer(table, refs)}
    return faults | {name: int(n) for name, where in usable.items() if (n := (has_packet & where).sum())}


def _repeated(skip: NDArray[np.int64]) -> dict[str, int]:
    count = int((skip > 0).sum())
    return {REPEATED: count} if count else {}


def _refuse_swollen(source: LasSource, wanted: int) -> None:
    """Compressed packets that promise far more samples than such packets hold would fill the memory."""
    if wanted > UNPACKED * source.waves.available + UNPACKED_FREE:
        raise InputError(
            "the compressed waveform packets promise too much",
            where=source.path,
            expected=f"at most {UNPACKED} times the {source.waves.available} bytes of packets",
            got=f"{wanted} bytes by the descriptors' sample counts",
            do="the descriptors are damaged; export the file again",
        )


def _refuse_overlap(source: LasSource, wanted: int) -> None:
    """Packets that together are much longer than the record cannot be right, and would fill the memory."""
    if wanted > _OVERLAP * source.waves.available:
        raise InputError(
            "the waveform packets overlap",
            where=source.path,
            expected=f"at most {source.waves.available} bytes of packets",
            got=f"{wanted} bytes by the descriptors' sample counts",
            do="the descriptors are damaged; export the file again",
        )
