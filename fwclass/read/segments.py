"""Segments: several waveform packets of one pulse.

A digitiser that starts anew for every group of echoes leaves a pulse with several packets, each with returns of its
own. Their GPS time and beam are one, and they follow each other along the beam. Some writers give every return a packet
of its own: the whole record once more, or a window around it. Such packets overlap, and hold the same samples there.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.read.las import LasSource
from fwclass.read.layout import SLACK
from fwclass.read.packet_references import OWN, References, packet_keys
from fwclass.read.packets import judge, repeats
from fwclass.read.points import coordinates, gps_times
from fwclass.units import METRES_PER_NS

ACROSS = 0.05
"""Returns of one pulse lie on one line within this [m]: a coordinate in whole centimetres is off by up to 9 mm."""

SAME_BEAM = 1e-4
"""Largest relative difference of the stored beam vectors of one pulse; that of neighbouring pulses is larger."""

APART = 1000.0 / METRES_PER_NS
"""Two segments of a pulse are at most this far apart [ns]: 1 km along the beam."""


@dataclass(frozen=True)
class Rows:
    """What tells whether a point continues the pulse of the point before it."""

    key: NDArray[np.uint64]
    time: NDArray[np.float64]
    number: NDArray[np.uint8]
    of: NDArray[np.uint8]
    place: NDArray[np.float64]
    refs: References

    @classmethod
    def of_points(cls, source: LasSource, points: Any) -> Rows:
        """What is needed of a block of points, in its order."""
        return cls(
            packet_keys(points),
            gps_times(source, points),
            np.asarray(points["return_number"], np.uint8),
            np.asarray(points["number_of_returns"], np.uint8),
            np.stack(coordinates(source, points), axis=1),
            References.of(points, source.mirrored),
        )

    def take(self, index: Any) -> Rows:
        """The rows of an index or a mask."""
        kept = self.refs.take(index)
        return Rows(self.key[index], self.time[index], self.number[index], self.of[index], self.place[index], kept)

    @classmethod
    def concat(cls, a: Rows, b: Rows) -> Rows:
        """The rows of `a`, then those of `b`."""
        names = [f.name for f in fields(References)]
        refs = References(*(np.concatenate([getattr(a.refs, n), getattr(b.refs, n)]) for n in names))
        both = np.concatenate
        return cls(
            both([a.key, b.key]),
            both([a.time, b.time]),
            both([a.number, b.number]),
            both([a.of, b.of]),
            both([a.place, b.place]),
            refs,
        )


def segment_links(source: LasSource, rows: Rows, before: Rows | None = None) -> NDArray[np.bool_]:
    """Per point, whether it and the point before it in the file are returns in two segments of one pulse.

    They are if both have a usable packet and these differ, their GPS times are equal (and not 0 or NaN), their
    numbers of returns are equal and the return number rises, the beam is the same and passes through both, and the
    samples of the second follow those of the first along it, or repeat them where both overlap. The answer for a pair
    depends on nothing else, so it is the same however the file is cut.

    `before`: the point before the first of `rows`, as one row; None links the first point to nothing.
    """
    if before is not None:
        return segment_links(source, Rows.concat(before, rows))[1:]
    second, follows, repeated = _judge_links(source, rows)
    link = np.zeros(len(rows.key), np.bool_)
    link[second] = follows | repeated
    return link


def count_repeats(source: LasSource, rows: Rows, before: Rows | None) -> int:
    """How many packets of `rows` repeat samples of that of the point before, see `segment_links`."""
    _, _, repeated = _judge_links(source, rows if before is None else Rows.concat(before, rows))
    return int(repeated.sum())


def _judge_links(source: LasSource, rows: Rows) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.bool_]]:
    """Points that may be in another segment of the pulse of the point before, whether their packets follow that
    point's, and whether they repeat its samples."""
    a, b = slice(None, -1), slice(1, None)
    with np.errstate(invalid="ignore"):
        may = (rows.time[a] == rows.time[b]) & (rows.time[a] != 0) & (rows.key[a] != rows.key[b])
    may &= (rows.key[a] != OWN) & (rows.key[b] != OWN)
    may &= (
        (rows.of[a] == rows.of[b])
        & (rows.number[a] >= 1)
        & (rows.number[a] < rows.number[b])
        & (rows.number[b] <= rows.of[b])
    )
    second = np.flatnonzero(may) + 1
    one, two = rows.take(second - 1), rows.take(second)
    follows, after = _follows(source, one, two)
    repeated = after >= 0
    repeated[repeated] = repeats(source, one.refs.take(repeated), two.refs.take(repeated), after[repeated])
    return second, follows, repeated


def _follows(source: LasSource, a: Rows, b: Rows) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Which of `b` follow their `a` along one beam, and of the others of one descriptor, where both overlap, how many
    samples after `a` they begin; -1 else."""
    usable = (judge(source, a.refs) == 0) & (judge(source, b.refs) == 0)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        length = np.sqrt((a.refs.step**2).sum(axis=1))
        up = a.refs.step / length[:, None]
        one_beam = np.sqrt(((a.refs.step - b.refs.step) ** 2).sum(axis=1)) <= SAME_BEAM * length
        apart = b.place - a.place
        along = -(apart * up).sum(axis=1)
        one_line = np.sqrt(((apart + along[:, None] * up) ** 2).sum(axis=1)) <= ACROSS
        spacing, n = _sampling(source, a.refs.descriptor)
        gap = along / length - (b.refs.location - a.refs.location) - n * spacing
        one = usable & one_beam & one_line
        follows = one & (gap >= -SLACK * spacing) & (gap <= APART)
        after = np.rint(gap / spacing + n)
        overlaps = one & (a.refs.descriptor == b.refs.descriptor) & (after >= 0) & (after < n) & ~follows
    return follows, np.where(overlaps, after, -1.0).astype(np.int64)


def _sampling(source: LasSource, descriptor: NDArray[np.uint8]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Spacing [ns] and number of samples by descriptor index; 0 for unknown ones."""
    table = np.zeros((256, 2))
    for index, d in source.descriptors.items():
        table[index] = d.spacing_ns, d.n_samples
    return table[descriptor, 0], table[descriptor, 1]
