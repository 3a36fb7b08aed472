"""Full waveforms of the simulator HELIOS++ (``*_fullwave.txt``), a line a pulse:

index, origin x y z [m], direction x y z, first and last time [ns], GPS time [s], samples.

Source: its writer of full waveforms (2021 to 2025); versions differ in decimals only, and older ones count the GPS time
in other units. Its times are distances over the speed of light in vacuum: of one way, not there and back. The width of
a bin is not written; there are ceil(last / bin) - ceil(first / bin) samples, which all lines together pin down.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.read.beam_source import BeamRows, Layout, Ragged
from fwclass.read.text_blocks import line_blocks, row_marks, rows_between, rows_of
from fwclass.units import SPEED_OF_LIGHT

ENDING = "_fullwave.txt"
HEAD = 10
"""Numbers before the samples."""

UNIT = 1e-2
"""A direction's length is 1 within this."""

THERE_AND_BACK = 2.0
"""Nanoseconds of two-way time in one of theirs."""

HALF_VACUUM = SPEED_OF_LIGHT * 1e-9 / 2.0

DIGITS = 6
"""Significant ones of a bin's width at most."""

SILENCE = 32
"""Samples of 0 before and behind every waveform: HELIOS++ writes none beyond the pulses of its first and last hit,
where the signal is 0, and a fit needs to see the level and the flanks' ends."""

LEVELS = 255.0
"""Counts of the highest sample, as of a digitiser of 8 bits: the waveforms have no noise but this rounding."""

LEVEL = 16.0
"""Counts that silence has, as of a receiver whose noise is not cut off at 0: a level of 0 is told as a fault."""

LOOKED_AT = 100_000
"""Lines that pin it down."""


@dataclass(frozen=True)
class HeliosLayout(Layout):
    """`bin_ns` is a bin's width in HELIOS's own time."""

    path: Path
    bin_ns: float

    @property
    def n_rows(self) -> int:
        return int(row_marks(self.path, 0)[-1, 0])

    def blocks(self) -> Iterator[BeamRows]:
        first = 0
        for _, data in line_blocks(self.path, 0):
            lines = rows_of(data)
            if lines:
                yield self._rows(lines, first)
            first += len(lines)

    def read(self, first: int, last: int) -> BeamRows:
        return self._rows(rows_between(self.path, 0, first, last), first)

    def _rows(self, lines: list[bytes], first: int) -> BeamRows:
        head, samples = _parse(self.path, lines, first)
        n = len(lines)
        return BeamRows(
            pulse=np.arange(first, first + n),
            anchor=head[:, 1:4],
            step=-HALF_VACUUM * head[:, 4:7],
            begin=THERE_AND_BACK * (head[:, 7] - SILENCE * self.bin_ns),
            anchor_range=np.zeros(n),
            spacing=np.full(n, THERE_AND_BACK * self.bin_ns),
            time=head[:, 9],
            channel=np.zeros(n, np.int64),
            samples=_in_silence(samples),
            outgoing=Ragged.none(n),
            outgoing_begin=np.full(n, np.nan),
            unusable=np.zeros(n, np.bool_),
        )


def is_helios(path: Path) -> bool:
    """By its name."""
    return path.name.lower().endswith(ENDING)


def open_helios(path: Path) -> HeliosLayout:
    """Look at the first lines; `InputError` for none that HELIOS++ writes, or bins of no one width."""
    low, high, count = 0.0, math.inf, 0
    for _, data in line_blocks(path, 0):
        lines = rows_of(data)
        head, samples = _parse(path, lines, count)
        length = np.sqrt((head[:, 4:7] ** 2).sum(axis=1))
        if len(head) and not np.abs(np.median(length) - 1.0) < UNIT:
            raise InputError(
                "these are no waveforms of HELIOS++",
                where=path,
                expected="index, origin, direction of length 1, first and last time, GPS time and samples on a line",
                got=f"directions of length {np.median(length):.4g}",
                do="rename the file if another program wrote it; see docs/waveforms.md for tables of raw waveforms",
            )
        span, n = head[:, 8] - head[:, 7], samples.lengths
        sound = np.isfinite(span) & (span > 0.0) & (n > 1)
        low = max(low, float((span[sound] / (n[sound] + 1)).max(initial=0.0)))
        high = min(high, float((span[sound] / (n[sound] - 1)).min(initial=math.inf)))
        count += len(lines)
        if count >= LOOKED_AT:
            break
    return HeliosLayout(path, _simplest(low, high, path) if math.isfinite(high) else math.nan)


def _simplest(low: float, high: float, path: Path) -> float:
    """The number of fewest digits between two, as people write the width of a bin."""
    if not low <= high:
        raise InputError(
            "the numbers of samples do not fit the times",
            where=path,
            expected="bins of one width in all lines",
            got=f"at least {low:.6g} ns in one line, at most {high:.6g} ns in another",
            do="the file is cut, or joined from several; simulate it again",
        )
    middle = (low + high) / 2.0
    for digits in range(1, DIGITS + 1):
        value = float(f"{middle:.{digits}g}")
        if low <= value <= high:
            return value
    return middle


def _parse(path: Path, lines: list[bytes], first: int) -> tuple[NDArray[np.float64], Ragged]:
    """Numbers before the samples (n, 10), and the samples."""
    head, parts = np.full((len(lines), HEAD), np.nan), []
    for k, line in enumerate(lines):
        try:
            if b"_" in line:  # Python takes 1_5 for 15
                raise ValueError(line)
            values = np.array(line.split(), np.float64)
        except ValueError:
            raise _wrong(path, first + k, "this is no number", line[:60].decode("utf-8", "replace")) from None
        if len(values) <= HEAD:
            raise _wrong(path, first + k, "the line is too short", f"{len(values)} numbers")
        head[k] = values[:HEAD]
        parts.append(values[HEAD:])
    ends = np.concatenate([[0], np.cumsum([len(p) for p in parts])]).astype(np.int64)
    return head, Ragged(np.concatenate([*parts, np.empty(0)]), ends)


def _in_silence(samples: Ragged) -> Ragged:
    """`samples` with `SILENCE` on both sides of those that are any."""
    lengths = samples.lengths
    ends = np.concatenate([[0], np.cumsum(lengths + 2 * SILENCE)]).astype(np.int64)
    values = np.zeros(int(ends[-1]))
    values[np.arange(len(samples.values)) + np.repeat(ends[:-1] + SILENCE - samples.offsets[:-1], lengths)] = (
        samples.values
    )
    return Ragged(values, ends)


def _wrong(path: Path, row: int, what: str, got: str) -> InputError:
    return InputError(
        what,
        where=f"{path}: line {row + 1}",
        expected=f"{HEAD} numbers and the samples, as HELIOS++ writes them",
        got=got,
        do="the file is cut short or damaged; copy it again",
    )
