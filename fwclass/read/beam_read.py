"""Reading waveforms that are rows with a beam each: to pulses with segments; there are no returns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.formats.linear_units import linear_units
from fwclass.read.beam_source import FAULTS, OVERLAPPING, BeamRows, BeamSource, Ragged, turn_beams
from fwclass.read.layout import SLACK, join_rows
from fwclass.read.spans import Span
from fwclass.read.wave_kernels import clear_of_last
from fwclass.schema import Table
from fwclass.waveforms import PULSE_COLUMNS, RETURN_COLUMNS, Waveforms

SECOND_CHANNEL = "waveforms of a second channel of their pulse left out"
BAD_OUTGOING = "outgoing pulses that are saturated, left out"


def check_beam_rows(source: BeamSource) -> None:
    """`InputError` if `source` has rows and none can be used, or its places are not in metres as its beams are."""
    if source.crs is not None and not (source.crs.is_geographic or source.crs.is_geocentric):
        units = linear_units(source.crs, None, source.path)
        if not units.metres:
            raise InputError(
                "the places are not in metres",
                where=source.path,
                expected="places and beams of one unit, metres, in a projected system of metres",
                got=units.source,
                do="bring the places into such a system first, and name it in the file",
            )
    counts = source.census.faults
    if counts.sum() == 0 or counts[0]:
        return
    raise InputError(
        "no waveform of the file can be read",
        where=source.path,
        expected="a finite place, a beam, a sample spacing and samples in every row",
        got=", ".join(f"{n} rows: {FAULTS[i]}" for i, n in enumerate(counts) if n),
        do="see docs/waveforms.md for columns and units; `fwclass info` counts what is wrong",
    )


def index_beam_rows(source: BeamSource, chunk: int) -> list[Span]:
    """Spans of `chunk` pulses; none is cut."""
    starts, n = source.census.first_rows(), source.census.pulses
    ends = [(a, min(a + chunk, n)) for a in range(0, n, chunk)]
    return [Span(int(starts[a]), int(starts[b]), a, b - a) for a, b in ends]


def read_beam_rows(source: BeamSource, span: Span) -> Waveforms:
    """Waveforms of the pulses of `span`; `returns` is empty.

    The anchor is the row's own, `anchor_time` its time in the waveform. Of several channels of a pulse the first that
    can be used counts. Rows that cannot be used are counted in `faults`.
    """
    rows = turn_beams(source.layout.read(span.first_point, span.last_point), source)
    pulse = np.cumsum(np.r_[0, rows.pulse[1:] != rows.pulse[:-1]]) if len(rows) else np.empty(0, np.int64)
    code = rows.fault
    faults = {FAULTS[i]: int(n) for i, n in enumerate(np.bincount(code, minlength=len(FAULTS))) if n and i}
    good = np.flatnonzero(code == 0)
    top = np.full(len(rows), source.scaling.top, np.float32)
    good, lost = _first_channel(rows, pulse, good)
    faults |= lost
    begin = _on_one_clock(rows.begin[good], rows.anchor[good], rows.step[good], pulse[good])
    order = np.lexsort((begin, pulse[good]))
    good, begin = good[order], begin[order]
    rows, pulse, top = rows.take(good), pulse[good], top[good]
    lasts = rows.samples.lengths * rows.spacing
    keep = np.empty(len(rows), np.bool_)
    clear_of_last(pulse, begin, begin + lasts, SLACK * rows.spacing, keep)
    if not keep.all():
        faults[OVERLAPPING] = int((~keep).sum())
        rows, pulse, top, lasts, begin = rows.take(keep), pulse[keep], top[keep], lasts[keep], begin[keep]
    layout = join_rows(pulse, begin, lasts, rows.spacing, top)
    head = layout.head
    ends = np.searchsorted(layout.row, np.arange(len(head) + 1))
    outgoing, begins, bad = _outgoing(rows.take(head), source)
    if bad:
        faults[BAD_OUTGOING] = bad
    one = rows.take(head)
    columns: dict[str, NDArray] = {f"anchor_{axis}": one.anchor[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"step_{axis}": one.step[:, k] for k, axis in enumerate("xyz")}
    columns |= {
        "pulse": pulse[head] + span.first_pulse,
        "gps_time": one.time,
        "anchor_time": -one.begin,
        "segment_start": layout.start,
        "anchor_range": one.anchor_range if source.ranged else np.full(len(one), np.nan),
        "outgoing_start": begins,
        "sample_spacing": one.spacing,
        "saturation": top[head],
        "gain": np.full(len(head), source.scaling.step),
        "receiver": np.zeros(len(head), np.uint8),
    }
    return Waveforms(
        Table({name: columns[name] for name in PULSE_COLUMNS}),
        Table.empty(RETURN_COLUMNS),
        source.scaling.counts(rows.samples.values),
        rows.samples.offsets[ends],
        faults,
        source.scaling.counts(outgoing.values),
        outgoing.offsets,
    )


def _on_one_clock(
    begin: NDArray[np.float64], anchor: NDArray[np.float64], step: NDArray[np.float64], pulse: NDArray[np.int64]
) -> NDArray[np.float64]:
    """`begin` of every row, (rows,) [ns] after the light passed its own `anchor`, (rows, 3) [m], on the clock of its
    pulse's first row; `step` is the beam up, (rows, 3) [m/ns], `pulse` (rows,) in rising order."""
    _, first, of = np.unique(pulse, return_index=True, return_inverse=True)
    step = step[first][of]
    along = ((anchor - anchor[first][of]) * step).sum(axis=1)
    return np.asarray(begin - along / np.maximum((step**2).sum(axis=1), 1e-30))


def _first_channel(
    rows: BeamRows, pulse: NDArray[np.int64], good: NDArray[np.int64]
) -> tuple[NDArray[np.int64], dict[str, int]]:
    number, first = np.unique(pulse[good], return_index=True)
    channel = rows.channel[good]
    same = channel == channel[first][np.searchsorted(number, pulse[good])]
    return good[same], {SECOND_CHANNEL: int((~same).sum())} if not same.all() else {}


def _outgoing(rows: BeamRows, source: BeamSource) -> tuple[Ragged, NDArray[np.float64], int]:
    """Outgoing pulses of `rows`, their begin [ns], and how many are saturated and so left out."""
    with np.errstate(invalid="ignore"):
        highest = source.scaling.counts(np.nan_to_num(rows.outgoing.per_row(np.maximum, -np.inf), neginf=0.0))
        sums = rows.outgoing.per_row(np.add, 0.0)
    has = rows.outgoing.lengths > 0
    fine = has & np.isfinite(sums) & (highest < source.scaling.top)
    pulses = Ragged(rows.outgoing.values, rows.outgoing.offsets).take(np.flatnonzero(fine))
    lengths = np.where(fine, rows.outgoing.lengths, 0)
    ends = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    return Ragged(pulses.values, ends), np.where(fine, rows.outgoing_begin, np.nan), int((has & ~fine).sum())
