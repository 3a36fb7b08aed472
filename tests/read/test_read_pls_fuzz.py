"""Damaged bytes of PulseWaves never end in anything but a result or an `InputError`, nor in a big allocation."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import pytest
from defaults import BASE
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from plsmaker import Descriptor, Pulse, Sampling, survey, write_pls

from fwclass.errors import InputError
from fwclass.read.info import describe, info
from fwclass.read.params import ReadParams
from fwclass.read.source import open_source
from fwclass.read.stage import check_source, index_source, read_span

ALLOCATION = 400
"""Bytes that reading may allocate per byte of the files, beyond `FIXED`: a segment of one sample (7 bytes in the file)
becomes a row of 14 columns, and its look-up as much again."""
FIXED = 4 << 20

PARAMS = ReadParams(**BASE["read"] | {"chunk_pulses": 10, "max_span_points": 1000})
relaxed = settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def originals(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("fuzz")
    short = [Pulse((0, 0, 500), (0, 0, -1), [[(9.0 + 3 * k, [7]) for k in range(9)]]) for _ in range(25)]
    made = {
        "survey": survey(folder / "s.pls", pulses=25).path,
        "appended": survey(folder / "a.pls", pulses=25, bits=16, appended=-1, extra_bytes=3).path,
        "short": write_pls(folder / "t.pls", short, {1: Descriptor([Sampling(duration_bits=16)])}),
    }
    for path in made.values():
        use_all(path)  # compiled code is loaded before allocations are counted
    return made


def use_all(path: Path) -> None:
    """Everything that a user can do to a file; `InputError` is an answer."""
    for action in (lambda: describe(info(path)), lambda: read_spans(path)):
        try:
            action()
        except InputError as error:
            assert "where" in str(error)


def read_spans(path: Path) -> None:
    source = open_source(path)
    for span in index_source(source, PARAMS):
        waves = read_span(source, span, PARAMS)
        assert waves.offsets[-1] == len(waves.samples) and waves.outgoing_offsets[-1] == len(waves.outgoing)
    check_source(source, PARAMS)


def damaged(folder: Path, original: Path, pls, wvs, cut_pls, cut_wvs) -> tuple[Path, int]:
    size = 0
    for suffix, changes, cut in ((".pls", pls, cut_pls), (".wvs", wvs, cut_wvs)):
        raw = bytearray(original.with_suffix(suffix).read_bytes())
        for at, value in changes:
            raw[at % len(raw)] = value
        target = folder / ("any" + suffix)
        target.write_bytes(raw[: len(raw) - cut] if cut else raw)
        size += len(raw)
    return folder / "any.pls", size


changes = st.lists(st.tuples(st.integers(0, 1 << 20), st.integers(0, 255)), max_size=6)
head_changes = st.lists(st.tuples(st.integers(16, 1100), st.integers(0, 255)), max_size=6)
cuts = st.one_of(st.none(), st.integers(0, 2000))


@pytest.mark.parametrize("kind", ["survey", "appended", pytest.param("short", marks=pytest.mark.slow)])
@relaxed
@given(head=head_changes, pls=changes, wvs=changes, cut_pls=cuts, cut_wvs=cuts)
def test_damaged_files(originals, tmp_path, kind, head, pls, wvs, cut_pls, cut_wvs):
    path, size = damaged(tmp_path, originals[kind], head + pls, wvs, cut_pls, cut_wvs)
    tracemalloc.start()
    try:
        use_all(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < FIXED + ALLOCATION * size


@relaxed
@given(head=st.binary(max_size=900), waves=st.binary(max_size=300))
def test_any_bytes(tmp_path, head, waves):
    path = tmp_path / "any.pls"
    path.write_bytes(b"PulseWavesPulse\0" + head)
    path.with_suffix(".wvs").write_bytes(b"PulseWavesWaves\0\0\0\0\0" + bytes(40) + waves)
    use_all(path)
