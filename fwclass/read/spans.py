"""Cutting a file into spans of consecutive points that never cut a pulse."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.read.las import LasSource
from fwclass.read.packet_kernels import crowded_keys, cut_spans, join_heads, pulse_heads
from fwclass.read.packet_references import MAX_RETURNS, OWN, sound_links
from fwclass.read.points import LINK_FIELDS, PointReader
from fwclass.read.segments import Rows, segment_links

MAX_SHARED = 1000
"""More packets than this with too many returns each are no accident of a few points."""


@dataclass(frozen=True)
class Span:
    """Consecutive points [`first_point`, `last_point`) with whole pulses, numbered from `first_pulse`.

    In formats that hold pulses only, a point is a pulse.
    `shared` holds the packet keys that too many points of the file share; their points are pulses of their own.
    """

    first_point: int
    last_point: int
    first_pulse: int
    n_pulses: int
    shared: tuple[int, ...] = ()

    @property
    def n_points(self) -> int:
        """Number of points."""
        return self.last_point - self.first_point


def spans_by_points(n_points: int, size: int) -> list[Span]:
    """Spans of a file without waveforms, where every return is a pulse of its own."""
    return [Span(a, min(a + size, n_points), a, min(size, n_points - a)) for a in range(0, n_points, size)]


def spans_by_pulses(source: LasSource, wanted: int, most_points: int) -> list[Span]:
    """Spans of about `wanted` pulses; one pass over the packet references, at most 40 bytes of memory a point."""
    keys, link = _keys_and_links(source)
    order = np.argsort(keys, kind="stable")
    shared = _shared_keys(source, keys, order)
    head = np.empty(len(keys), np.int64)
    pulse_heads(keys, order, OWN, MAX_RETURNS, head)
    if shared:
        link &= ~np.isin(keys, np.array(shared, np.uint64))
        link[1:] &= ~np.isin(keys[:-1], np.array(shared, np.uint64))
    if link.any():
        join_heads(head, sound_links(keys, link))
    cuts = np.empty((len(keys) // wanted + 1, 2), np.int64)
    rows, n_pulses = cut_spans(head, order, wanted, cuts)
    ends = np.concatenate([cuts[:rows], [[len(keys), n_pulses]]])
    spans = [
        Span(int(a[0]), int(b[0]), int(a[1]), int(b[1] - a[1]), shared)
        for a, b in zip(ends[:-1], ends[1:], strict=True)
    ]
    _refuse_long(source, spans, most_points)
    return spans


def _keys_and_links(source: LasSource) -> tuple[NDArray[np.uint64], NDArray[np.bool_]]:
    """Packet key of every point, and which points continue the pulse of the point before them."""
    keys, links = np.empty(source.n_points, np.uint64), np.empty(source.n_points, np.bool_)
    before: Rows | None = None
    with PointReader(source, LINK_FIELDS) as reader:
        for first, points in reader.blocks():
            rows = Rows.of_points(source, points)
            last = first + len(rows.key)
            keys[first:last], links[first:last] = rows.key, segment_links(source, rows, before)
            before = rows.take(slice(-1, None))
    return keys, links


def _shared_keys(source: LasSource, keys: NDArray[np.uint64], order: NDArray[np.int64]) -> tuple[int, ...]:
    """Keys of more than `MAX_RETURNS` points."""
    shared = np.empty(MAX_SHARED, np.uint64)
    count = int(crowded_keys(keys, order, OWN, MAX_RETURNS, shared))
    if count > MAX_SHARED:
        raise InputError(
            "the packet references of the points make no sense",
            where=source.path,
            expected="a packet for the few returns of one pulse",
            got=f"{count} packets with more than {MAX_RETURNS} returns each",
            do="export the file again with its waveforms, or convert it to a point format without them",
        )
    return tuple(int(k) for k in shared[:count])


def _refuse_long(source: LasSource, spans: list[Span], most_points: int) -> None:
    longest = max(spans, key=lambda s: s.n_points, default=None)
    if longest is not None and longest.n_points > most_points:
        raise InputError(
            "the returns of one pulse lie too far apart in the file",
            where=f"{source.path}, points {longest.first_point} to {longest.last_point}",
            expected=f"a place to cut the file at least every {most_points} points (read.max_span_points)",
            got=f"{longest.n_points} points that cannot be cut",
            do="sort the file by GPS time, or raise read.max_span_points if memory allows",
        )
