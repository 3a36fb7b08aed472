"""Spans cover the file, never cut a pulse, and how they are cut changes nothing."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lasmaker import survey, write_las

from fwclass.errors import InputError
from fwclass.read.packet_kernels import cut_spans, number_pulses, pulse_heads
from fwclass.read.packet_references import OWN
from fwclass.read.params import ReadParams
from fwclass.read.source import open_source
from fwclass.read.stage import index_source, read_span


def whole(base, **changes) -> ReadParams:
    return ReadParams(**{**base["read"], **changes})


def joined(source, params):
    """All spans of a file, put together."""
    parts = [read_span(source, s, params) for s in index_source(source, params)]
    returns = {k: np.concatenate([p.returns[k] for p in parts]) for k in parts[0].returns}
    pulses = {k: np.concatenate([p.pulses[k] for p in parts]) for k in parts[0].pulses}
    lengths = np.concatenate([np.diff(p.offsets) for p in parts])
    return returns, pulses, np.concatenate([p.samples for p in parts]), lengths


def shuffled_survey(path, seed, spread):
    """A survey whose returns of one pulse are not adjacent: points are moved by up to `spread` places."""
    truth = survey(path, pulses=60, seed=seed)
    raw = bytearray(truth.path.read_bytes())
    start = int.from_bytes(raw[96:100], "little")
    n = len(truth.pulse)
    rows = np.frombuffer(bytes(raw[start : start + n * 59]), np.uint8).reshape(n, 59)
    order = np.argsort(np.arange(n) + np.random.default_rng(seed).uniform(0, spread, n), kind="stable")
    raw[start : start + n * 59] = rows[order].tobytes()
    truth.path.write_bytes(raw)
    return truth, order


@pytest.mark.parametrize("spread", [0, 5, 40])
@pytest.mark.parametrize("chunk", [1, 7, 25])
def test_chunking_changes_nothing(tmp_path, base, spread, chunk):
    truth, order = shuffled_survey(tmp_path / "a.las", 4, spread)
    source = open_source(truth.path)
    one = joined(source, whole(base))
    many = joined(source, whole(base, chunk_pulses=chunk))
    for a, b in zip(one[:2], many[:2], strict=True):
        for name in a:
            np.testing.assert_array_equal(a[name], b[name])
    np.testing.assert_array_equal(one[2], many[2])
    np.testing.assert_array_equal(one[3], many[3])
    # pulses are numbered by first appearance, and their members are right
    _, first = np.unique(truth.pulse[order], return_index=True)
    rank = np.argsort(np.argsort(first))
    np.testing.assert_array_equal(one[0]["pulse"], rank[truth.pulse[order]])


def test_spans_are_about_as_long_as_asked(tmp_path, base):
    source = open_source(survey(tmp_path / "a.las", pulses=100).path)
    spans = index_source(source, whole(base, chunk_pulses=10))
    assert [s.n_pulses for s in spans] == [10] * 10
    assert spans[0].first_point == 0 and spans[-1].last_point == source.n_points
    assert all(a.last_point == b.first_point for a, b in zip(spans[:-1], spans[1:], strict=True))


@settings(max_examples=100, deadline=None)
@given(st.lists(st.integers(0, 12), min_size=1, max_size=60), st.integers(1, 8))
def test_cuts_against_brute_force(groups, wanted):
    keys = np.array([OWN if g == 0 else g for g in groups], np.uint64)
    n = len(keys)
    head, pulse = np.empty(n, np.int64), np.empty(n, np.int64)
    pulse_heads(keys, np.argsort(keys, kind="stable"), OWN, 255, head)
    count = number_pulses(head, pulse)
    names: dict[object, int] = {}
    expected = [names.setdefault(("own", i) if g == 0 else g, len(names)) for i, g in enumerate(groups)]
    assert pulse.tolist() == expected and count == len(names)
    cuts = np.empty((n // wanted + 1, 2), np.int64)
    rows, total = cut_spans(head, np.empty(n, np.int64), wanted, cuts)
    assert total == count
    starts = cuts[:rows, 0].tolist()
    for a, b in zip(starts, [*starts[1:], n], strict=True):
        inside = set(expected[a:b])
        assert not inside & set(expected[:a]) and not inside & set(expected[b:])
        if b < n:
            assert len(inside) >= wanted
    assert cuts[:rows, 1].tolist() == [len(set(expected[:a])) for a in starts]


def test_points_without_packet_are_pulses_of_their_own(tmp_path, base):
    path = write_las(
        tmp_path / "a.las", np.zeros((4, 3)), waveforms=[np.arange(60)] * 2, pulse=[0, -1, 1, -1], location=10.0
    )
    returns = joined(open_source(path), whole(base))[0]
    assert returns["pulse"].tolist() == [0, 1, 2, 3]
    assert returns["has_packet"].tolist() == [True, False, True, False]


def test_a_packet_that_everything_refers_to_is_no_pulse(tmp_path, base):
    n = 600
    path = write_las(
        tmp_path / "a.las",
        np.zeros((n, 3)),
        waveforms=[np.arange(60)] * 2,
        pulse=np.r_[np.zeros(n - 1, int), 1],
        location=10.0,
    )
    source = open_source(path)
    params = whole(base, chunk_pulses=100)
    spans = index_source(source, params)
    assert len(spans) == 6
    parts = [read_span(source, s, params) for s in spans]
    assert sum(p.faults.get("packet shared by too many returns", 0) for p in parts) == n - 1
    assert np.concatenate([p.returns["pulse"] for p in parts]).tolist() == list(range(n))
    assert sum(p.pulses.rows for p in parts) == 1


def test_a_file_that_cannot_be_cut_says_so(tmp_path, base):
    path = write_las(
        tmp_path / "a.las",
        np.zeros((100, 3)),
        waveforms=[np.arange(60)] * 50,
        pulse=np.r_[np.arange(50), np.arange(50)],
        location=10.0,
    )
    with pytest.raises(InputError, match="sort the file by GPS time"):
        index_source(open_source(path), whole(base, chunk_pulses=10, max_span_points=60))


def test_no_points(tmp_path, base):
    for point_format in (1, 9):
        source = open_source(write_las(tmp_path / "a.las", np.empty((0, 3)), point_format=point_format))
        assert index_source(source, whole(base)) == []
        assert "the file has no points" in source.faults


def test_indexing_needs_little_memory(tmp_path, base, monkeypatch):
    """At most 40 bytes a point, beside one block of the stream."""
    n = 200_000
    monkeypatch.setattr("fwclass.read.points.BLOCK", 5_000)
    offset = 60 + 60 * (np.arange(n) // 2)
    path = write_las(tmp_path / "a.las", np.zeros((n, 3)), wave={"index": 1, "offset": offset, "size": 60})
    source = open_source(path)
    index_source(source, whole(base))
    tracemalloc.start()
    try:
        spans = index_source(source, whole(base))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert sum(s.n_pulses for s in spans) == n // 2
    assert peak < 40 * n
