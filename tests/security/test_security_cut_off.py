"""A file that is cut off while it is read ends a command in words, not by a signal: what others write is not mapped."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import lasmaker
import numpy as np
import plsmaker
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from plsmaker import OUTGOING, Descriptor, Sampling
from plzmaker import compress

from fwclass.conf import section
from fwclass.errors import InputError
from fwclass.formats import extents, polygon_magic
from fwclass.formats.extents import read_extents
from fwclass.read import wave_extents
from fwclass.read.source import open_source
from fwclass.read.stage import index_source, read_span

ROOT = Path(__file__).resolve().parents[2]

CUTTING = """
import importlib, os, sys, types
place, path, *words = sys.argv[1:]
module, _, name = place.rpartition(".")
owner = importlib.import_module(module)
original = getattr(owner, name)
def cutting(*given, **named):
    os.truncate(path, 0)
    return (original if callable(original) else original.match)(*given, **named)
setattr(owner, name, cutting if callable(original) else types.SimpleNamespace(match=cutting))
sys.argv = ["fwclass", *words]
from fwclass.cli import main
main()
"""
"""The file is cut off where `place` (a kernel, a pattern) begins to go through its bytes."""


def sources(place: Path) -> dict[str, Path]:
    """Of every kind one of more than a page."""
    lasmaker.survey(place / "a.las", 300)
    kinds = {1: Descriptor([Sampling(OUTGOING, length_bits=0, samples=20, segment_bits=0, segments=1), Sampling()])}
    for name in "bc":
        plsmaker.survey(place / f"{name}.pls", 300, descriptors=kinds)
    compress(place / "c.pls", kinds)
    ring = [[0, 0], [9, 0], [9, 9], [0, 0]]
    feature = {"type": "Feature", "properties": {}, "geometry": {"type": "Polygon", "coordinates": [ring]}}
    (place / "d.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [feature] * 90}))
    return {p.suffix: p for p in place.iterdir()}


@pytest.mark.parametrize(
    ("ending", "name", "where"),
    [
        (".wdp", "a.las", "fwclass.read.packets.gather"),
        (".wvs", "b.pls", "fwclass.read.pls_waves.find_segments"),
        pytest.param(".plz", "c.plz", "fwclass.read.pls_compressed.unpack_pulses", marks=pytest.mark.slow),
        pytest.param(".wvz", "c.plz", "fwclass.read.pls_compressed.unpack_waves", marks=pytest.mark.slow),
        (".geojson", "d.geojson", "fwclass.formats.polygon_magic._PLAIN"),
    ],
)
def test_a_file_that_is_cut_off_between_its_bytes_and_their_use(
    ending: str, name: str, where: str, tmp_path: Path
) -> None:
    cut = sources(tmp_path)[ending]
    command = ["info"] if ending == ".geojson" else ["decompose"]
    words = [*command, str(tmp_path / name), *([str(tmp_path / "out.laz")] if command == ["decompose"] else [])]
    line = [sys.executable, "-c", CUTTING, where, str(cut), *words]
    ended = subprocess.run(line, capture_output=True, text=True, timeout=300)
    assert cut.stat().st_size == 0
    assert ended.returncode in (1, 2) and cut.name in ended.stderr and "Traceback" not in ended.stderr, ended
    assert not (tmp_path / "out.laz").exists()


@pytest.mark.parametrize("ending", [".wdp", ".wvs", ".plz", ".wvz"])
def test_a_file_that_is_cut_off_while_its_bytes_are_read(
    ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cut = sources(tmp_path)[ending]
    pulses = {".wdp": "a.las", ".wvs": "b.pls"}.get(ending, "c.plz")
    read = os.preadv

    def cutting(handle: int, room: Any, at: int) -> int:
        if os.path.samestat(os.fstat(handle), cut.stat()):
            os.truncate(cut, 80)
        return read(handle, room, at)

    monkeypatch.setattr(os, "preadv", cutting)
    params = section("read", ())
    with pytest.raises(InputError, match="changed while it was read") as fault:
        source = open_source(tmp_path / pulses)
        read_span(source, index_source(source, params)[0], params)
    assert cut.name in str(fault.value) and "80 bytes" in str(fault.value)


def test_polygons_that_are_cut_off_while_they_are_checked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = sources(tmp_path)[".geojson"]
    opened = polygon_magic.open_regular

    def cutting(at: Path) -> Any:
        file = opened(at)
        facts = os.fstat(file.fileno())
        os.truncate(at, 80)
        monkeypatch.setattr(os, "fstat", lambda handle: facts)  # its size was taken, but not its bytes
        return file

    monkeypatch.setattr(polygon_magic, "open_regular", cutting)
    with pytest.raises(InputError, match="changed while it was read"):
        polygon_magic.check_format(path)


@settings(deadline=None, max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    size=st.integers(0, 5000),
    pairs=st.lists(st.tuples(st.integers(0, 5000), st.integers(0, 900)), max_size=20),
    near=st.integers(0, 600),
)
def test_extents_hold_what_was_asked_for_once(
    size: int, pairs: list[tuple[int, int]], near: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(extents, "NEAR", near)
    whole = np.random.default_rng(size).integers(0, 256, size).astype(np.uint8)
    path = tmp_path / "a.wdp"
    whole.tofile(path)
    begin = np.array([min(a, size) for a, _ in pairs], np.int64)
    end = np.array([min(a + n, size) for a, n in pairs], np.int64)
    data, place, held = read_extents(path, begin, end, size)
    assert len(data) <= size and not data.flags.writeable
    for a, b, at, to in zip(begin, end, place, held, strict=True):
        assert to - at >= b - a
        np.testing.assert_array_equal(data[at:to], whole[a : a + to - at])


@pytest.mark.parametrize("first", [3, 64])
@pytest.mark.parametrize("packed", [False, True])
def test_waves_are_the_same_however_little_is_read_at_first(
    first: int, packed: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sources(tmp_path)
    source, params = open_source(tmp_path / ("c.plz" if packed else "b.pls")), section("read", ())
    (span,) = index_source(source, params)
    whole = read_span(source, span, params)
    monkeypatch.setattr(wave_extents, "FIRST_READ", first)
    monkeypatch.setattr(extents, "NEAR", 0)
    pieces = read_span(source, span, params)
    assert len(whole.samples) and pieces.faults == whole.faults
    for name in ("samples", "offsets", "outgoing", "outgoing_offsets"):
        np.testing.assert_array_equal(getattr(pieces, name), getattr(whole, name))


def test_what_others_may_write_is_not_mapped() -> None:
    """These map what they wrote themselves, or the header of an array."""
    own = {"temporary.py", "single_file/street/batch.py", "store/models.py"}
    mapping = set()
    for path in (ROOT / "fwclass").rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        names = {n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute)}
        names |= {n.arg for n in ast.walk(tree) if isinstance(n, ast.keyword) and n.arg}
        names |= {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
        if names & {"mmap", "memmap", "open_memmap", "mmap_mode", "memory_map"}:
            mapping.add(path.relative_to(ROOT / "fwclass").as_posix())
    assert mapping == own
