"""RIEGL's sample data, through something that pretends to be the vendor's library: what it hands over is what is read.

Neither library nor file was at hand; a raw table of the same waveforms is the measure.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from commandline import fwclass
from rawmaker import HALF_LIGHT, scene, write_parquet

from fwclass.errors import ConfigError, InputError
from fwclass.read import riegl_sdf
from fwclass.read.info import describe, info
from fwclass.read.params import ReadParams
from fwclass.read.riegl_sdf import LIBRARY, REFERENCE
from fwclass.read.source import open_source
from fwclass.read.stage import check_source, index_source, read_span
from fwclass.store.run_store import Store
from fwclass.survey.file_digests import Digests
from fwclass.survey.gather import digests_of

GATE = 3e-6
"""s after the pulse when the range gate opens; times of blocks count from it."""


@dataclass
class Pretender:
    """The functions of RiWaveLIB over `records`: (time, origin, direction, [(channel, start [s], samples)])."""

    records: list[tuple[float, Any, Any, list[tuple[int, float, Any]]]]
    indexed: bool = True
    wrong: str = ""
    at: int = 0
    read: int = 0
    kept: list[Any] = field(default_factory=list)

    def fwifc_open(self, path: Any, file: Any) -> int:
        self.at = 0
        return 6 if self.wrong else 0

    def fwifc_close(self, file: Any) -> int:
        return 0

    def fwifc_set_sosbl_relative(self, file: Any, value: Any) -> int:
        assert value.value == 1
        return 0

    def fwifc_get_last_error(self, message: Any) -> int:
        message._obj.value = self.wrong.encode()
        return 0

    def fwifc_get_info(self, file: Any, instrument: Any, serial: Any, epoch: Any, v: Any, dt: Any, *_: Any) -> int:
        instrument._obj.value, serial._obj.value, epoch._obj.value = b"Q-680i", b"S999", b"WEEKSEC"
        v._obj.value, dt._obj.value = 2e9 * HALF_LIGHT, 1e-9
        return 0

    def fwifc_seek(self, file: Any, record: Any) -> int:
        if not self.indexed:
            return 3
        self.at = record.value - 1
        return 0

    def fwifc_read(self, file: Any, gate: Any, time: Any, origin: Any, direction: Any, *rest: Any) -> int:
        if self.at == len(self.records):
            return -1
        stamp, place, away, blocks = self.records[self.at]
        self.at, self.read = self.at + 1, self.read + 1
        gate._obj.value, time._obj.value = GATE, stamp
        origin._obj[:], direction._obj[:] = place, away
        made = (riegl_sdf._SampleBlock * len(blocks))()
        self.kept = [made]
        for one, (channel, start, samples) in zip(made, blocks, strict=True):
            values = np.asarray(samples, np.uint16)
            self.kept.append(values)
            one.time, one.channel, one.count, one.size = start - GATE, channel, len(values), 2
            one.samples = values.ctypes.data_as(ctypes.POINTER(ctypes.c_uint16))
        rest[2]._obj.value = len(blocks)
        rest[4]._obj.contents = made[0] if blocks else riegl_sdf._SampleBlock()
        return 0


EMITTED = 1e-6
PULSE = np.array([3, 40, 180, 40, 3])


def records_of(truth: Any) -> list[tuple[float, Any, Any, list[tuple[int, float, Any]]]]:
    """Every pulse with a block of low power; every third with one of high power, every fifth alone with its pulse."""
    begin = np.linalg.norm(truth.first - truth.origin, axis=1) / HALF_LIGHT * 1e-9
    records = []
    for k in range(len(begin)):
        blocks = [(REFERENCE, EMITTED, PULSE)]
        if k % 5:
            blocks.append((1, EMITTED + begin[k], truth.samples[k]))
        if k % 3 == 0 and k % 5:
            blocks.append((0, EMITTED + begin[k], truth.samples[k] // 4))
        records.append((truth.time[k], truth.origin[k], 2.0 * truth.away[k], blocks))
    return records


@pytest.fixture
def truth() -> Any:
    return scene(pulses=300)


@pytest.fixture
def params(base: Any) -> ReadParams:
    return ReadParams(**base["read"])


def sdf(tmp_path: Path, monkeypatch: Any, library: Pretender) -> Path:
    monkeypatch.setattr(riegl_sdf, "library_of", lambda name: library)
    path = tmp_path / "a.sdf"
    path.write_bytes(b"sample data")
    return path


@pytest.mark.parametrize("indexed", [True, False])
def test_shots_become_the_rows_of_a_raw_table(tmp_path, monkeypatch, base, truth, indexed):
    path = sdf(tmp_path, monkeypatch, Pretender(records_of(truth), indexed))
    params = ReadParams(**{**base["read"], "chunk_pulses": 50})
    source = open_source(path)
    check_source(source, params)
    spans = index_source(source, params)
    columns = truth.columns("unit", at="sensor")
    rows = np.array([k for k in range(300) if k % 5])
    table = {name: np.asarray(values)[rows] for name, values in columns.items() if name != "samples"}
    table |= {"samples": [truth.samples[k] for k in rows], "outgoing": [PULSE.astype(np.uint16)] * len(rows)}
    table |= {"outgoing_begin_ns": np.zeros(len(rows))}
    raw = write_parquet(tmp_path / "a.parquet", table, {"spacing_ns": "1.0", "crs": "EPSG:32632"})
    whole = ReadParams(**base["read"])
    (span,) = index_source(open_source(raw), whole)
    want = read_span(open_source(raw), span, whole)
    got = [read_span(source, one, params) for one in spans]
    assert len(got) > 3
    samples = np.concatenate([g.samples for g in got])
    np.testing.assert_array_equal(samples, want.samples)
    for name in ("anchor_x", "anchor_y", "anchor_z", "step_x", "step_z", "anchor_time", "gps_time", "anchor_range"):
        values = np.concatenate([g.pulses[name] for g in got])
        np.testing.assert_allclose(values, want.pulses[name], atol=1e-5, err_msg=name)
    np.testing.assert_array_equal(np.concatenate([g.outgoing for g in got]), want.outgoing)
    told = describe(info(path))
    assert "RIEGL sample data" in told and "Q-680i, S999" in told
    assert sum(n for g in got for fault, n in g.faults.items() if "second channel" in fault) == 80


@pytest.mark.parametrize("indexed", [True, False])
def test_opening_reads_every_record_once(tmp_path, monkeypatch, truth, indexed):
    """Without an index each block of rows was read from the first record on."""
    monkeypatch.setattr(riegl_sdf, "BLOCK", 20)
    library = Pretender(records_of(truth), indexed)
    path = sdf(tmp_path, monkeypatch, library)
    assert (open_source(path).n_records, library.read) == (320, 300)
    open_source(path)
    assert library.read == 300


def test_the_scanners_own_frame_is_no_place(tmp_path, monkeypatch, truth):
    records = [(t, np.array([0.1, 0.0, 0.2]), d, b) for t, _, d, b in records_of(truth)]
    with pytest.raises(InputError, match="the scanner's own frame"):
        open_source(sdf(tmp_path, monkeypatch, Pretender(records)))


def test_a_shot_without_its_pulse_has_no_times(tmp_path, monkeypatch, truth):
    records = records_of(truth)
    records[1] = (*records[1][:3], [b for b in records[1][3] if b[0] != REFERENCE])
    path = sdf(tmp_path, monkeypatch, Pretender(records))
    assert "no sane time of the first sample" in describe(info(path))


def test_what_the_library_says_is_told(tmp_path, monkeypatch, truth):
    with pytest.raises(InputError, match="checksum error in packet 7"):
        open_source(sdf(tmp_path, monkeypatch, Pretender(records_of(truth), wrong="checksum error in packet 7")))
    too_many = [(*records_of(truth)[0][:3], [(1, 0.0, PULSE)] * (riegl_sdf.MOST_BLOCKS + 1))]
    with pytest.raises(InputError, match="too many blocks"):
        open_source(sdf(tmp_path, monkeypatch, Pretender(too_many)))


@pytest.mark.parametrize("name", ["", "libsdfifc.so", "/nowhere/libsdfifc.so"])
def test_a_library_is_named_by_the_user_alone(tmp_path, monkeypatch, name):
    """Nothing is looked for: not in the current directory, not by the system."""
    monkeypatch.setenv(LIBRARY, name)
    riegl_sdf.library_of.cache_clear()
    monkeypatch.chdir(tmp_path)
    (tmp_path / "libsdfifc.so").write_bytes(b"\x7fELF")
    path = tmp_path / "a.sdf"
    path.write_bytes(b"sample data")
    with pytest.raises(ConfigError, match=LIBRARY):
        open_source(path)


@pytest.mark.parametrize("command", [("info",), ("decompose",)])
def test_rdb_is_refused_with_what_to_export(tmp_path, command):
    (tmp_path / "a.rdbx").write_bytes(b"RIEGL" + bytes(500))
    ended = fwclass(*command, tmp_path / "a.rdbx", *([tmp_path / "o.laz"] if command[0] == "decompose" else []))
    assert ended.returncode == 1 and "export LAS 1.4 with waveforms" in ended.stderr, ended.stderr


def test_another_library_reads_a_strip_anew(tmp_path, monkeypatch):
    """A part's key has the digests of what it read, and what read it."""
    library, path = tmp_path / "libsdfifc.so", tmp_path / "a.sdf"
    path.write_bytes(b"record")
    monkeypatch.setenv(LIBRARY, str(library))
    source = SimpleNamespace(path=path, waves=SimpleNamespace(path=path))
    keys = []
    for version in (b"one", b"two"):
        library.write_bytes(version)
        keys.append([(f.name, f.digest) for f in digests_of(source, path, Digests(Store(tmp_path)))])
    assert [n for n, _ in keys[0]] == ["a.sdf", "libsdfifc.so"]
    assert keys[0][0] == keys[1][0] and keys[0][1] != keys[1][1]
