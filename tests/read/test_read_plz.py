"""Compressed PulseWaves: what an independent compressor wrote is read as what it was made of, and damage is told."""

from __future__ import annotations

import hashlib
import shutil
import struct
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from plsmaker import OUTGOING, Descriptor, Pulse, Sampling, survey, two_segments_of, write_pls
from plzmaker import compress, wild_records

from fwclass.errors import InputError
from fwclass.operate.schedule.inbox import fault_of
from fwclass.operate.schedule.source_directories import WAVES
from fwclass.paths import WAVEFORM_ENDINGS
from fwclass.read import pls_compressed, pls_read
from fwclass.read.info import describe, files_in, info
from fwclass.read.params import ReadParams
from fwclass.read.pls_waves import Samplings, find, read_records, waves_fault
from fwclass.read.source import open_source
from fwclass.read.stage import check_source, index_source, read_span
from fwclass.waveforms import Waveforms


@pytest.fixture
def params(base) -> ReadParams:
    return ReadParams(**base["read"])


def read(path: Path, params: ReadParams) -> Waveforms:
    source = open_source(path)
    check_source(source, params)
    (span,) = index_source(source, params)
    return read_span(source, span, params)


def same(a: Waveforms, b: Waveforms) -> None:
    assert a.faults == b.faults
    for one in fields(Waveforms):
        first, second = getattr(a, one.name), getattr(b, one.name)
        if one.name in ("pulses", "returns"):
            for name in first:
                np.testing.assert_array_equal(first[name], second[name], err_msg=name)
        elif isinstance(first, np.ndarray):
            assert first.dtype == second.dtype
            np.testing.assert_array_equal(first, second)


def described(bits: int = 8, extra: int = 0) -> dict[int, Descriptor]:
    out = Sampling(OUTGOING, bits=bits, length_bits=0, samples=20, segment_bits=0, segments=1)
    return {1: Descriptor([out, Sampling(bits=bits)], extra=extra)}


def copied(path: Path, name: str) -> Path:
    for suffix in (".pls", ".wvs"):
        shutil.copy(path.with_suffix(suffix), path.with_name(name + suffix))
    return path.with_name(f"{name}.pls")


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize(("extra", "source"), [(0, 0), (2, 16), (4, 32), (7, 16), (6, 0)])
@pytest.mark.parametrize(("chunk", "piped"), [(50_000, False), (7, True), ([5, 10, 3], False)])
def test_a_survey_is_read_as_before_it_was_compressed(tmp_path, params, bits, extra, source, chunk, piped):
    kinds = described(bits, extra=3)
    plain = survey(tmp_path / "a.pls", pulses=18, bits=bits, extra_bytes=extra, descriptors=kinds).path
    packed = compress(copied(plain, "b"), kinds, chunk=chunk, source=source, piped=piped)
    opened = open_source(packed)
    assert packed.suffix == ".plz" and opened.compressed and opened.packed
    same(read(packed, params), read(plain, params))
    a, b = info(plain), info(packed)
    assert b["compressed"] and not b["faults"]
    assert {k: v for k, v in a.items() if k not in ("path", "size", "compressed", "waveforms")} == {
        k: v for k, v in b.items() if k not in ("path", "size", "compressed", "waveforms")
    }


PEER = {8: "cc4177d4eb7c22dad2be3dbc2eb08f6e", 16: "52474a67fb21ca2a17ef8f0077b938c9"}
"""Digests of chunks, table and waves that PulseWaves' own compressor (commit d9a3179) made of these surveys."""


@pytest.mark.parametrize("bits", [8, 16])
def test_the_encoder_of_the_tests_writes_what_pulsewaves_own_writes(tmp_path, bits):
    kinds = described(bits, extra=3)
    path = survey(tmp_path / "a.pls", pulses=120, bits=bits, extra_bytes=6, descriptors=kinds).path
    packed = compress(path, kinds)
    data, start = packed.read_bytes(), open_source(packed).header.pulses_start
    own = data[start + 8 : -96] + packed.with_suffix(".wvz").read_bytes()
    assert hashlib.blake2b(own, digest_size=16).hexdigest() == PEER[bits]


@pytest.mark.parametrize("what", ["pulses", "waves"])
def test_one_of_both_may_be_compressed(tmp_path, params, what):
    """As examples of PulseWaves' own are: pulses as they are beside waves that are compressed."""
    kinds = described()
    plain = survey(tmp_path / "a.pls", pulses=30, descriptors=kinds).path
    packed = compress(copied(plain, "b"), kinds, pulses=what == "pulses", waves=what == "waves")
    same(read(packed, params), read(plain, params))


def test_compressed_pulses_behind_those_that_the_header_counts_are_refused(tmp_path, params):
    kinds = described()
    packed = compress(survey(tmp_path / "a.pls", pulses=40, descriptors=kinds).path, kinds)
    raw = bytearray(packed.read_bytes())
    struct.pack_into("<q", raw, 184, 30)
    packed.write_bytes(raw)
    with pytest.raises(InputError, match="fewer pulses than the file holds"):
        read(packed, params)
    assert "fewer pulses" in fault_of(packed, (packed.with_suffix(".wvz"),), tmp_path, marked=True)


@pytest.mark.parametrize("chunk", [1, 7, 40])
def test_cutting_changes_nothing(tmp_path, base, chunk):
    """Spans begin and end inside of chunks."""
    kinds = described()
    packed = compress(survey(tmp_path / "a.pls", pulses=40, descriptors=kinds).path, kinds, chunk=11)
    source, parts = open_source(packed), {}
    for size in (chunk, 1000):
        params = ReadParams(**{**base["read"], "chunk_pulses": size})
        parts[size] = [read_span(source, span, params) for span in index_source(source, params)]
    (whole,) = parts[1000]
    for name in whole.pulses:
        np.testing.assert_array_equal(np.concatenate([p.pulses[name] for p in parts[chunk]]), whole.pulses[name])
    np.testing.assert_array_equal(np.concatenate([p.samples for p in parts[chunk]]), whole.samples)


@pytest.mark.parametrize("duration_bits", [8, 16, 32])
@pytest.mark.parametrize(("segment_bits", "length_bits"), [(0, 0), (8, 8), (16, 16), (0, 16), (16, 0)])
def test_every_width_of_the_counts(tmp_path, params, duration_bits, segment_bits, length_bits):
    sampling, segments = two_segments_of(duration_bits, segment_bits, length_bits)
    kinds = {1: Descriptor([sampling], extra=5)}
    plain = write_pls(tmp_path / "a.pls", [Pulse((0, 0, 800), (0.1, 0.05, -1.0), [segments])] * 3, kinds)
    packed = compress(copied(plain, "b"), kinds)
    same(read(packed, params), read(plain, params))


@pytest.mark.statistics
@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 2**32), n=st.integers(1, 120), chunk=st.integers(1, 130))
def test_any_pulse_comes_back(tmp_path_factory, seed, n, chunk):
    folder = tmp_path_factory.mktemp("wild")
    path = write_pls(folder / "a.pls", [Pulse((0, 0, 800), (0, 0, -1), [[]])] * n)
    raw = bytearray(path.read_bytes())
    rows = wild_records(n, seed).tobytes()
    raw[-len(rows) :] = rows
    path.write_bytes(raw)
    source = open_source(compress(path, {}, chunk=chunk, waves=False))
    chunks = source.header.chunks
    assert pls_compressed.unpacked_pulses(source.path, chunks, 0, n).tobytes() == rows
    a, b = sorted(np.random.default_rng(seed).integers(0, n + 1, 2))
    assert pls_compressed.unpacked_pulses(source.path, chunks, a, b).tobytes() == rows[48 * a : 48 * b]


def patched(path: Path, at: int, layout: str, *values) -> None:
    data = bytearray(path.read_bytes())
    struct.pack_into("<" + layout, data, at, *values)
    path.write_bytes(data)


def record_of(path: Path) -> int:
    """Byte where the body of the record lies that says how pulses are compressed: the last before them."""
    source = open_source(path)
    return next(r.start for r in source.header.vlrs if r.number == 5) + 96


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda p, r, s: patched(p, r, "H", 2), "(?s)not known.*compressor 2"),
        (lambda p, r, s: patched(p, r + 2, "H", 1), "(?s)not known.*coder 1"),
        (lambda p, r, s: patched(p, r + 12, "I", 0), "damaged"),
        (lambda p, r, s: patched(p, r + 12, "I", 1), "a table of 40 chunks"),
        (lambda p, r, s: patched(p, r + 16, "H", 0), "what a pulse consists of"),
        (lambda p, r, s: patched(p, r + 16, "H", 9), "what a pulse consists of"),
        (lambda p, r, s: patched(p, r + 18, "H", 7), "item 7"),
        (lambda p, r, s: patched(p, r + 18, "H", 1000), "once each item"),
        (lambda p, r, s: patched(p, r + 22, "H", 2), "version 2"),
        (lambda p, r, s: patched(p, s, "q", s), "never finished"),
        (lambda p, r, s: patched(p, s, "q", 2**60), "a table of chunks between"),
        (lambda p, r, s: patched(p, s, "q", -2), "a table of chunks between"),
        (lambda p, r, s: patched(p, s, "q", s + 8), "a table of 6 chunks"),
        (lambda p, r, s: patched(p, 184, "q", 2**40), "times its bytes of pulses"),
        (lambda p, r, s: patched(p, 184, "q", 41), "6 pulses from pulse 35 on"),
        (lambda p, r, s: p.write_bytes(p.read_bytes()[: s + 4]), "damaged"),
        (lambda p, r, s: p.write_bytes(p.read_bytes()[:-120]), "damaged"),
    ],
)
def test_a_useless_file_is_an_input_error(tmp_path, params, change, text):
    kinds = described()
    path = compress(survey(tmp_path / "a.pls", pulses=40, descriptors=kinds).path, kinds, chunk=7)
    change(path, record_of(path), open_source(path).header.pulses_start)
    with pytest.raises(InputError, match=text) as caught:
        read(path, params)
    assert str(path) in str(caught.value) and "what to do" in str(caught.value)


def test_a_chunk_that_ends_before_its_pulses(tmp_path, params):
    kinds = described()
    path = compress(survey(tmp_path / "a.pls", pulses=40, descriptors=kinds).path, kinds, chunk=20)
    source = open_source(path)
    chunks = source.header.chunks
    with pytest.raises(InputError, match=r"(?s)20 pulses from pulse 20 on.*the end of their chunk"):
        short = replace(chunks, start=np.r_[chunks.start[:2], chunks.start[1] + 60])
        read_records(replace(source, header=replace(source.header, chunks=short)), 0, 40)


def test_without_the_waves_the_name_that_is_missing_is_told(tmp_path, params):
    kinds = described()
    path = compress(survey(tmp_path / "a.pls", pulses=5, descriptors=kinds).path, kinds)
    path.with_suffix(".wvz").rename(tmp_path / "moved.wvz")
    with pytest.raises(InputError, match=r"put a\.wvz beside"):
        read(path, params)
    with pytest.raises(InputError, match=r"give the \.pls or \.plz"):
        open_source(tmp_path / "moved.wvz")


def test_waves_cut_short_cost_their_own_pulses_only(tmp_path, params):
    kinds = described()
    plain = survey(tmp_path / "a.pls", pulses=30, descriptors=kinds).path
    path = compress(copied(plain, "b"), kinds)
    wvz = path.with_suffix(".wvz")
    wvz.write_bytes(wvz.read_bytes()[:-300])
    waves, whole = read(path, params), read(plain, params)
    assert set(waves.faults) <= {"waves past the end", "waves cut short"} and 0 < sum(waves.faults.values()) < 15
    kept = np.isin(whole.pulses["pulse"], waves.pulses["pulse"])
    np.testing.assert_array_equal(whole.pulses["gps_time"][kept], waves.pulses["gps_time"])
    assert "waves cut short" in describe(info(path)) or "past the end" in describe(info(path))


def test_another_files_waves_are_told(tmp_path, params):
    kinds = described()
    path = compress(survey(tmp_path / "a.pls", pulses=40, descriptors=kinds).path, kinds)
    other = compress(survey(tmp_path / "b.pls", pulses=40, seed=9, noise=3.0, descriptors=kinds).path, kinds)
    other.with_suffix(".wvz").rename(path.with_suffix(".wvz"))
    with pytest.raises(InputError, match="do not fit each other"):
        read(path, params)
    assert "another file's" in describe(info(path))


def test_what_unpacks_to_far_more_than_the_file_is_refused(tmp_path, params):
    """All pulses begin at one place, whose samples are constant: few bytes, and a gigabyte of them."""
    kinds = {1: Descriptor([Sampling(length_bits=16)])}
    level = [(9.0, np.full(60_000, 7))]
    path = write_pls(tmp_path / "a.pls", [Pulse((0, 0, 800), (0, 0, -1), [level])] * 2, kinds)
    path = compress(path, kinds, pulses=False)
    data = bytearray(path.read_bytes())
    row = bytes(data[-48:])
    data[184:192] = struct.pack("<q", 20_000)
    path.write_bytes(bytes(data) + row * 19_998)
    with pytest.raises(InputError, match="times its bytes"):
        read(path, params)


relaxed = settings(deadline=None, max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> list[tuple[str, bytes]]:
    """A compressed survey's files, as (name, bytes): pulses, then waves."""
    kinds = described(16)
    made = survey(tmp_path_factory.mktemp("sound") / "a.pls", pulses=12, bits=16, descriptors=kinds)
    path = compress(made.path, kinds, chunk=5)
    return [(one.name, one.read_bytes()) for one in (path, path.with_suffix(".wvz"))]


@pytest.mark.statistics
@relaxed
@given(
    changes=st.lists(st.tuples(st.booleans(), st.integers(0, 1 << 20), st.integers(0, 255)), min_size=1, max_size=6),
    cut=st.integers(0, 60),
)
def test_damage_anywhere_ends_in_waveforms_or_in_words(tmp_path, params, sound, changes, cut):
    for waves, (name, data) in enumerate(sound):
        raw = bytearray(data)
        for own, at, value in changes:
            if own == waves:
                raw[at % len(raw)] = value
        (tmp_path / name).write_bytes(raw[: len(raw) - (cut if waves else 0)])
    path = tmp_path / sound[0][0]
    try:
        describe(info(path))
        read(path, params)
    except InputError as error:
        assert "where" in str(error)


@pytest.mark.slow
def test_real_pulses(shared_data, params, tmp_path, monkeypatch):
    """A GeoLas file, compressed by the encoder of the tests; without what is taken apart of it where it is not."""
    monkeypatch.setattr(pls_read, "_runs_together", lambda _: False)
    path = shared_data / "waveform" / "geolas_example2.pls"
    if not path.exists():
        pytest.skip("no geolas_example2.pls")
    source = open_source(path)
    kinds = {
        i: Descriptor(
            [
                Sampling(
                    s.kind,
                    s.channel,
                    s.bits,
                    s.spacing_ns,
                    s.duration_bits,
                    s.scale,
                    s.offset,
                    s.segment_bits,
                    s.length_bits,
                    s.segments,
                    s.samples,
                )
                for s in d.samplings
            ],
            extra=d.extra_bytes,
        )
        for i, d in source.descriptors.items()
    }
    for suffix in (".pls", ".wvs"):
        (tmp_path / f"a{suffix}").write_bytes(path.with_suffix(suffix).read_bytes())
    packed = compress(tmp_path / "a.pls", kinds, chunk=1000)
    same(read(packed, params), read(path, params))
    both = [
        packed.with_suffix(s).stat().st_size / path.with_suffix(t).stat().st_size
        for s, t in ((".plz", ".pls"), (".wvz", ".wvs"))
    ]
    assert max(both) < 0.6, both


def test_a_directory_names_them_and_an_inbox_moves_both(tmp_path):
    kinds = described()
    plz = compress(survey(tmp_path / "a.pls", pulses=5, descriptors=kinds).path, kinds)
    assert files_in(tmp_path) == (plz,)
    assert plz.with_suffix(".wvz").suffix in WAVEFORM_ENDINGS[plz.suffix] and ".wvz" in WAVES
    assert "PulseWaves 0.3, compressed" in describe(info(plz))


@pytest.mark.parametrize("packed", [False, True])
def test_an_inbox_waits_for_all_of_a_waves_file(tmp_path, packed):
    kinds = described()
    head = survey(tmp_path / "a.pls", pulses=40, descriptors=kinds).path
    head = compress(head, kinds) if packed else head
    waves = head.with_suffix(WAVEFORM_ENDINGS[head.suffix][0])
    assert fault_of(head, (waves,), tmp_path, False) == ""
    waves.write_bytes(waves.read_bytes()[:-200])
    assert f"{waves.name} is cut short" in fault_of(head, (waves,), tmp_path, False)
    waves.unlink()
    assert f"put {waves.name} beside" in fault_of(head, (), tmp_path / "survey", False)


@pytest.mark.parametrize("which", ["shuffled", "every seventh"])
def test_pulses_in_any_order_and_selection_fit_their_waves(tmp_path, params, which):
    """A file sorted by intensity, or thinned beside its whole Waves file, is no other file's."""
    kinds = described()
    path = compress(survey(tmp_path / "a.pls", pulses=200, descriptors=kinds).path, kinds, pulses=False)
    data = bytearray(path.read_bytes())
    rows = np.frombuffer(bytes(data[-200 * 48 :]), np.uint8).reshape(200, 48)
    chosen = np.random.default_rng(1).permutation(200) if which == "shuffled" else np.arange(0, 200, 7)
    data[184:192] = struct.pack("<q", len(chosen))
    path.write_bytes(bytes(data[: -200 * 48]) + rows[chosen].tobytes())
    source = open_source(path)
    check_source(source, params)
    assert not [f for f in info(path)["faults"] if "another file" in f]
    for first in range(0, len(chosen), 20):  # however few of the others are seen
        records = read_records(source, first, min(first + 20, len(chosen)))
        pulses = find(source, records, Samplings.of(source))
        assert waves_fault(source, records["waves"], pulses) == ""


def test_another_files_waves_of_fixed_lengths_are_told(tmp_path, params):
    """Nothing that is unpacked can be wrong by itself: all counts are fixed."""
    fixed = Sampling(length_bits=0, samples=60, segment_bits=0, segments=1)
    kinds, paths = {1: Descriptor([fixed])}, []
    for seed in (1, 2):
        rng = np.random.default_rng(seed)
        pulses = [
            Pulse((0, 0, 800), (0, 0, -1), [[(9.0, rng.normal(40, 2 * seed, 60).astype(int))]]) for _ in range(80)
        ]
        paths.append(compress(write_pls(tmp_path / f"{seed}.pls", pulses, kinds), kinds))
    check_source(open_source(paths[0]), params)
    paths[1].with_suffix(".wvz").rename(paths[0].with_suffix(".wvz"))
    with pytest.raises(InputError, match="do not fit each other"):
        read(paths[0], params)
