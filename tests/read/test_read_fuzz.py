"""Damaged bytes never end in anything but a result or an `InputError`, nor in a big allocation."""

from __future__ import annotations

import shutil
import tracemalloc
from pathlib import Path

import pytest
from defaults import BASE
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lasmaker import survey, to_laz

from fwclass.errors import InputError
from fwclass.read.info import describe, info
from fwclass.read.params import ReadParams
from fwclass.read.source import open_source
from fwclass.read.stage import check_source, index_source, read_cloud, read_span

ALLOCATION = 60
"""Bytes that reading may allocate per byte of the files, beyond `FIXED`: points become columns of 8 bytes, samples
stay as they are."""
FIXED = 8 << 20

PARAMS = ReadParams(**BASE["read"] | {"chunk_pulses": 10, "max_span_points": 1000})
relaxed = settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def originals(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("fuzz")
    made = {
        "internal": survey(folder / "i.las", pulses=25, where="internal").path,
        "external": survey(folder / "e.las", pulses=25, point_format=4, bits=16).path,
    }
    made["laz"] = to_laz(made["external"], folder / "z.laz")
    shutil.copy(made["external"].with_suffix(".wdp"), folder / "z.wdp")
    for path in made.values():
        use_all(path)  # compiled code is loaded before allocations are counted
    return made


def use_all(path: Path) -> None:
    """Everything that a user can do to a file; `InputError` is an answer."""
    for action in (lambda: describe(info(path)), lambda: read_cloud(path), lambda: read_spans(path)):
        try:
            action()
        except InputError as error:
            assert "where" in str(error)


def read_spans(path: Path) -> None:
    source = open_source(path)
    for span in index_source(source, PARAMS):
        waves = read_span(source, span, PARAMS)
        assert waves.returns.rows == span.n_points
    check_source(source, PARAMS)


def damaged(folder: Path, original: Path, changes: list[tuple[int, int]], cut: int | None) -> Path:
    raw = bytearray(original.read_bytes())
    for at, value in changes:
        raw[at % len(raw)] = value
    path = folder / original.name
    path.write_bytes(raw[: len(raw) - cut] if cut else raw)
    sidecar = original.with_suffix(".wdp")
    if sidecar.exists():
        shutil.copy(sidecar, path.with_suffix(".wdp"))
    return path


changes = st.lists(st.tuples(st.integers(0, 1 << 20), st.integers(0, 255)), min_size=1, max_size=6)
header_changes = st.lists(st.tuples(st.integers(4, 650), st.integers(0, 255)), min_size=1, max_size=6)


@pytest.mark.parametrize("kind", ["internal", pytest.param("external", marks=pytest.mark.slow), "laz"])
@relaxed
@given(changes=header_changes, cut=st.one_of(st.none(), st.integers(0, 3000)))
def test_damaged_headers(originals, tmp_path, kind, changes, cut):
    path = damaged(tmp_path, originals[kind], changes, cut)
    size = path.stat().st_size + sum(p.stat().st_size for p in path.parent.glob("*.wdp"))
    tracemalloc.start()
    try:
        use_all(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < FIXED + ALLOCATION * size


@pytest.mark.parametrize("kind", [pytest.param("internal", marks=pytest.mark.slow), "external"])
@relaxed
@given(changes=changes, cut=st.one_of(st.none(), st.integers(0, 3000)))
def test_damaged_points_and_packets(originals, tmp_path, kind, changes, cut):
    use_all(damaged(tmp_path, originals[kind], changes, cut))


@relaxed
@given(head=st.binary(max_size=600))
def test_any_bytes(tmp_path, head):
    path = tmp_path / "any.las"
    path.write_bytes(b"LASF" + head)
    use_all(path)
