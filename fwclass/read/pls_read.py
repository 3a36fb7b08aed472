"""Reading PulseWaves: pulses with their segments and outgoing pulses; there are no returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.read.feet import in_metres
from fwclass.read.layout import SLACK, join_rows
from fwclass.read.packet_kernels import gather
from fwclass.read.pls_stated import misfit_of
from fwclass.read.pls_waves import (
    FAULTS,
    FEW,
    MISFIT,
    OVERLAP,
    OVERLAPPING,
    SILENT,
    Pulses,
    Samplings,
    Segments,
    blocks_of,
    find,
    reach,
    read_records,
    refuse_overlap,
    waves_fault,
)
from fwclass.read.projection import metres_of
from fwclass.read.pulsewaves import OUTGOING, RETURNING, PulseSource
from fwclass.read.spans import Span, spans_by_points
from fwclass.read.wave_kernels import clear_of_last, gather_parted
from fwclass.schema import Table
from fwclass.units import METRES_PER_NS
from fwclass.waveforms import PULSE_COLUMNS, RETURN_COLUMNS, Waveforms

SECOND_CHANNEL = "segments of a second channel left out"
RUN_TOGETHER = "outgoing pulses of 8 bits where 16 are declared, and returning samples behind them, taken apart"
BAD_OUTGOING = "outgoing pulses that are saturated or sampled unlike the returning waveform, left out"


def check_pls(source: PulseSource) -> None:
    """`InputError` if no pulse of `source` has a returning waveform that can be read: there is nothing else in it.

    Looks at pulses until the first usable one.
    """
    counts = np.zeros(len(FAULTS), np.int64)
    for records, pulses in blocks_of(source):
        counts += np.bincount(pulses.fault, minlength=len(FAULTS))
        if counts[0]:
            if misfit := waves_fault(source, records["waves"], pulses):
                raise InputError(
                    "the pulses and their compressed waves do not fit each other",
                    where=source.path,
                    expected=f"waves of more than {1 - MISFIT:.0%} of the pulses that end before the next pulse's",
                    got=misfit,
                    do=f"put the {(source.waves.path or source.path).name} of this very file beside it",
                )
            kinds = Samplings.of(source)
            if wrong := misfit_of(source, records, pulses, kinds):
                raise InputError(
                    "pulses and waves do not fit each other",
                    where=source.path,
                    expected="waves of their own pulses, times there and back, samples in the header's bounds",
                    got=wrong,
                    do="write both files again from the vendor's own, with times in the units of their descriptor, and "
                    "axes as the header has them",
                )
            return
    if source.n_records == 0:
        return
    with np.errstate(invalid="ignore"):
        length = float(np.median(np.linalg.norm(pulses.step * metres_of(source), axis=1))) / METRES_PER_NS
    reasons = ", ".join(f"{n} pulses: {FAULTS[i]}" for i, n in enumerate(counts) if n)
    wvs = (source.waves.path or source.path.with_suffix(".wvz" if source.compressed else ".wvs")).name
    raise InputError(
        "no waveform of the file can be read",
        where=source.path,
        expected=f"returning waveforms in {source.waves.path or wvs}",
        got=f"{source.waves.why_not}; {reasons}" if source.waves.why_not else reasons,
        do=f"put {wvs} beside it"
        if source.waves.kind == "none"
        else in_metres(
            length, f"ask for {source.path.name} and {wvs} again: they do not fit each other, or one is damaged", source
        ),
    )


def pulse_bounds(source: PulseSource) -> tuple[float, ...]:
    """Bounds of the returning samples as the pulses have them, not as the header says; the header's without any.

    Reads the whole file.
    """
    kinds, low, high = Samplings.of(source), np.full(3, np.inf), np.full(3, -np.inf)
    for _, pulses in blocks_of(source):
        least, most = reach(pulses, kinds)
        low, high = np.minimum(low, least), np.maximum(high, most)
    return (*low.tolist(), *high.tolist()) if np.isfinite(low).all() else source.bounds


def index_pls(source: PulseSource, chunk: int) -> list[Span]:
    """Spans of `chunk` pulses."""
    return spans_by_points(source.n_records, chunk)


def read_pls(source: PulseSource, span: Span) -> Waveforms:
    """Waveforms of the pulses of `span`; `returns` is empty.

    The anchor is the pulse's own, `anchor_time` its (negative) time in the segment, so that
    P(t) = P_anchor + (anchor_time - t) step holds as everywhere; `anchor_range` is the distance from the optical
    centre to the anchor, 0 where they coincide. Of several channels the first that has samples counts.
    """
    kinds = Samplings.of(source)
    pulses = find(source, read_records(source, span.first_point, span.last_point), kinds)
    counts = np.bincount(pulses.fault, minlength=len(FAULTS))
    faults = {name: int(n) for name, n in zip(FAULTS[:SILENT], counts, strict=False) if n and name}
    segments, lost = _returning(pulses.segments, kinds)
    faults |= lost
    spacing, top = kinds.spacing[segments.sampling], kinds.top[segments.sampling]
    lasts = segments.samples * spacing
    layout = join_rows(segments.pulse, segments.begin, lasts, spacing, top)
    segments = segments.take(layout.order)
    head = layout.head
    ends = np.concatenate([[0], np.cumsum(segments.samples)]).astype(np.int64)
    first_of_row = np.searchsorted(layout.row[layout.order], np.arange(len(head) + 1))
    _check_overlap(source, pulses.segments, kinds)
    parted = _parted(source, pulses, kinds)
    if len(parted.pulse):
        faults[RUN_TOGETHER] = len(parted.pulse)
    samples = _gather(source, segments, kinds, pulses.data, ends, parted)
    at = segments.pulse[first_of_row[:-1]]
    spacing, top = spacing[head], top[head]
    begin = segments.begin[first_of_row[:-1]]
    sent = (source, pulses.segments, kinds, pulses.data, parted)
    outgoing, out_offsets, out_start, unlike = _outgoing(*sent, at, spacing, top)
    if unlike:
        faults[BAD_OUTGOING] = unlike
    rows = {f"anchor_{axis}": pulses.anchor[at, k] for k, axis in enumerate("xyz")}
    rows |= {f"step_{axis}": pulses.step[at, k] for k, axis in enumerate("xyz")}
    rows |= {
        "pulse": at + span.first_pulse,
        "gps_time": pulses.time[at],
        "anchor_time": -begin,
        "segment_start": layout.start,
        "anchor_range": pulses.anchor_range[at] if source.ranged else np.full(len(at), np.nan),
        "outgoing_start": out_start,
        "sample_spacing": spacing,
        "saturation": top,
        "gain": np.ones(len(top)),
        "receiver": np.zeros(len(top), np.uint8),
    }
    return Waveforms(
        Table({name: rows[name] for name in PULSE_COLUMNS}),
        Table.empty(RETURN_COLUMNS),
        samples,
        ends[first_of_row],
        faults,
        outgoing,
        out_offsets,
    )


def _returning(segments: Segments, kinds: Samplings) -> tuple[Segments, dict[str, int]]:
    """Returning segments of the first channel of every pulse, sorted by pulse and begin, none before the end of the
    one before it; and how many were left out."""
    segments = segments.take(kinds.kind[segments.sampling] == RETURNING)
    channel = kinds.channel[segments.sampling]
    pulses, first = np.unique(segments.pulse, return_index=True)
    same = channel == channel[first][np.searchsorted(pulses, segments.pulse)]
    chosen = segments.take(same)
    chosen = chosen.take(np.lexsort((chosen.begin, chosen.pulse)))
    spacing = kinds.spacing[chosen.sampling]
    keep = np.empty(len(chosen.pulse), np.bool_)
    clear_of_last(chosen.pulse, chosen.begin, chosen.begin + chosen.samples * spacing, SLACK * spacing, keep)
    lost = {SECOND_CHANNEL: int((~same).sum()), OVERLAPPING: int((~keep).sum())}
    return chosen.take(keep), {name: n for name, n in lost.items() if n}


def _check_overlap(source: PulseSource, segments: Segments, kinds: Samplings) -> None:
    """Waves that together are much longer than the file cannot be right, and would fill the memory."""
    wanted = int((segments.samples * kinds.table[segments.sampling, -1]).sum())
    if not source.packed and wanted > OVERLAP * source.waves.available:
        refuse_overlap(source, f"{wanted} bytes")


TRIED, SURE = 2000, 0.9
"""Pulses at the start of a file that are looked at, and share of them that must say the same."""

VARIED = 16
"""DN that an outgoing pulse of 8 bits rises over its level at least; constant samples of 16 bits do not."""


def _parted(source: PulseSource, pulses: Pulses, kinds: Samplings) -> Segments:
    """The outgoing segments of pulses whose returning samples begin in them; none in sound files.

    A converter of 2013 took outgoing samples of 8 bits for such of 16, so that one half of what it wrote for them are
    the first returning samples; what it wrote for these ends with the outgoing ones of the next pulse.
    """
    sent, _ = _wide_pairs(pulses, kinds)
    if len(sent.pulse) == 0 or pulses.data is None:
        return sent
    files = [(f, f.stat()) for f in (source.path, source.waves.path or source.path)]
    marks = tuple((f, facts.st_size, facts.st_mtime_ns, facts.st_ino) for f, facts in files)
    known = _runs_together(_Asked(marks, source))
    return sent if known else sent.take(np.zeros(len(sent.pulse), np.bool_))


@dataclass(frozen=True)
class _Asked:
    """A source, and what tells its files from others."""

    files: tuple[tuple[Path, int, int, int], ...]
    source: PulseSource = field(compare=False)


@lru_cache(maxsize=64)
def _runs_together(asked: _Asked) -> bool:
    """Whether the first pulses of the file are stored so; asked once for all spans of a file."""
    source, kinds = asked.source, Samplings.of(asked.source)
    tried = find(source, read_records(source, 0, min(TRIED, source.n_records)), kinds)
    return _runs_on(tried, kinds)


def _wide_pairs(pulses: Pulses, kinds: Samplings) -> tuple[Segments, Segments]:
    """Outgoing and returning segments, of 16 bits and long enough, of pulses that have one of each and no others."""
    parts = pulses.segments
    alone = np.bincount(parts.pulse, minlength=1)[parts.pulse] == 2
    kind, wide = kinds.kind[parts.sampling], kinds.table[parts.sampling, -1] == 2
    sent, back = (parts.take(np.flatnonzero(alone & wide & (kind == k))) for k in (OUTGOING, RETURNING))
    _, s, b = np.intersect1d(sent.pulse, back.pulse, return_indices=True)
    long = 2 * back.samples[b] >= sent.samples[s]
    return sent.take(s[long]), back.take(b[long])


def _runs_on(pulses: Pulses, kinds: Samplings) -> bool:
    """What was written for returning samples ends with the outgoing ones of the next pulse."""
    data, parts = pulses.data, pulses.segments
    every = parts.take(np.flatnonzero(kinds.kind[parts.sampling] == OUTGOING))
    first = dict(zip(every.pulse.tolist(), every.byte.tolist(), strict=True))
    sent, back = _wide_pairs(pulses, kinds)
    same = []
    for pulse, n, samples, at in zip(sent.pulse + 1, sent.samples, back.samples, back.byte, strict=True):
        if data is not None and int(pulse) in first:
            begin, end = first[int(pulse)], int(at + 2 * samples)
            ahead, last = data[begin : begin + n], data[end - n : end]
            varied = min(np.ptp(last[k::2]) for k in (0, 1)) >= VARIED if n > 1 else False
            same.append(bool(varied and np.array_equal(ahead, last)))
    return len(same) >= FEW and float(np.mean(same)) >= SURE


def _gather(
    source: PulseSource,
    segments: Segments,
    kinds: Samplings,
    data: NDArray[np.uint8] | None,
    ends: NDArray[np.int64],
    parted: Segments,
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """The samples of `segments`; `parted` are the outgoing ones of pulses that are stored so (`_parted`)."""
    samples = np.empty(int(ends[-1]), np.dtype(source.sample_dtype))
    if data is None or len(segments.byte) == 0:
        return samples
    mine = np.isin(segments.pulse, parted.pulse)
    sent = mine & (kinds.kind[segments.sampling] == OUTGOING)
    gather(data, segments.byte, (kinds.table[segments.sampling, -1] == 2) & ~sent, ends, samples)
    if back := np.flatnonzero(mine & ~sent).tolist():
        of = np.searchsorted(parted.pulse, segments.pulse[back])
        first, length = np.zeros(len(segments.byte), np.int64), np.full(len(segments.byte), -1)
        first[back], length[back] = parted.byte[of] + parted.samples[of], parted.samples[of]
        gather_parted(data, first, length, segments.byte, ends, samples)
    return samples


def _outgoing(
    source: PulseSource,
    segments: Segments,
    kinds: Samplings,
    data: NDArray[np.uint8] | None,
    parted: Segments,
    at: NDArray[np.int64],
    spacing: NDArray[np.float64],
    top: NDArray[np.float32],
) -> tuple[NDArray[np.uint8] | NDArray[np.uint16], NDArray[np.int64], NDArray[np.float64], int]:
    """The first outgoing segment of the pulse of every row: samples, offsets, start [ns]; and pulses whose outgoing
    pulse does not share the row's spacing and saturation and so is left out."""
    segments = segments.take(kinds.kind[segments.sampling] == OUTGOING)
    pulses, first = np.unique(segments.pulse, return_index=True)
    place = np.minimum(np.searchsorted(pulses, at), max(0, len(pulses) - 1))
    has = pulses[place] == at if len(pulses) else np.zeros(len(at), np.bool_)
    chosen = segments.take(first[place[has]])
    own_top = kinds.top[chosen.sampling]
    ends = np.concatenate([[0], np.cumsum(chosen.samples)]).astype(np.int64)
    samples = _gather(source, chosen, kinds, data, ends, parted)
    peak = np.maximum.reduceat(samples, ends[:-1]) if len(chosen.pulse) else np.empty(0)
    fits = (kinds.spacing[chosen.sampling] == spacing[has]) & (peak < np.minimum(own_top, top[has]))
    lengths, start = np.zeros(len(at), np.int64), np.full(len(at), np.nan)
    row = np.flatnonzero(has)[fits]
    lengths[row], start[row] = chosen.samples[fits], chosen.begin[fits]
    offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    unlike = len(np.unique(chosen.pulse[~fits]))
    return samples[np.repeat(fits, chosen.samples)], offsets, start, unlike
