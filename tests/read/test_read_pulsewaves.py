"""PulseWaves: what was written byte by byte is what is read; damage is refused or counted."""

from __future__ import annotations

import json
import struct

import numpy as np
import plsmaker
import pytest
from lasmaker import METRES_PER_NS
from plsmaker import OUTGOING, Descriptor, Pulse, Sampling, survey, two_segments_of, write_pls
from tolerances import FLOAT32_CHAIN_RTOL

from fwclass.errors import InputError
from fwclass.operate.schedule.inbox import fault_of
from fwclass.read.info import describe, info
from fwclass.read.params import ReadParams
from fwclass.read.pls_read import pulse_bounds
from fwclass.read.source import open_source
from fwclass.read.stage import check_source, index_source, read_cloud, read_span
from fwclass.waveforms import PULSE_COLUMNS, RETURN_COLUMNS

ANCHOR, AWAY = (500000.0, 5400000.0, 800.0), (0.1, 0.05, -1.0)


@pytest.fixture
def params(base) -> ReadParams:
    return ReadParams(**base["read"])


def read(path, params):
    source = open_source(path)
    (span,) = index_source(source, params)
    return read_span(source, span, params)


def one(path, segments, *, samplings=None, pulses=1, **options):
    """Pulses with the same segments in their only (returning) sampling."""
    unit, centre = options.pop("unit", 1.0), options.pop("centre", 0)
    descriptor = Descriptor(samplings or [Sampling()], unit=unit, centre=centre)
    waves = segments if samplings else [segments]
    made = [Pulse(ANCHOR, AWAY, waves, time=1000.0 + p) for p in range(pulses)]
    return write_pls(path, made, {1: descriptor}, **options)


def places(waves, row, times):
    """P(t) of a row, (n, 3)."""
    p = waves.pulses
    step, anchor = (np.array([p[f"{k}_{a}"][row] for a in "xyz"]) for k in ("step", "anchor"))
    return anchor + (p["anchor_time"][row] - np.asarray(times, float))[:, None] * step


def beam(time):
    """Place on the test beam, two-way time after the anchor [ns]."""
    away = np.array(AWAY) / np.linalg.norm(AWAY)
    return np.array(ANCHOR) + time * METRES_PER_NS * away


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("appended", [None, -1, 1, 5])
@pytest.mark.parametrize("extra", [0, 6])
def test_a_survey_is_read_as_written(tmp_path, params, bits, appended, extra):
    truth = survey(tmp_path / "a.pls", pulses=40, bits=bits, appended=appended, extra_bytes=extra)
    source = open_source(truth.path)
    check_source(source, params)
    assert (source.n_points, source.n_records, source.has_waves, source.crs.to_epsg()) == (0, 40, True, 32633)
    waves = read(truth.path, params)
    assert waves.faults == {} and waves.returns.rows == 0
    assert tuple(waves.pulses) == PULSE_COLUMNS and tuple(waves.returns) == RETURN_COLUMNS
    segments = [(p, s) for p, pulse in enumerate(truth.pulses) for s in pulse.waves[1]]
    assert waves.pulses["pulse"].tolist() == [p for p, _ in segments]
    np.testing.assert_array_equal(waves.samples, np.concatenate([s[1] for _, s in segments]))
    assert waves.samples.dtype == (np.uint16 if bits == 16 else np.uint8)
    np.testing.assert_array_equal(waves.outgoing, np.concatenate([truth.pulses[p].waves[0][0][1] for p, _ in segments]))
    assert set(np.diff(waves.outgoing_offsets)) == {20} and set(waves.pulses["outgoing_start"]) == {-8.0}
    np.testing.assert_allclose(waves.pulses["anchor_time"], [-s[0] for _, s in segments])
    first = {p: s[0] for p, s in reversed(segments)}
    np.testing.assert_allclose(waves.pulses["segment_start"], [s[0] - first[p] for p, s in segments])
    np.testing.assert_allclose(waves.pulses["gps_time"], [1000 + 1e-5 * p for p, _ in segments], atol=1e-6)
    assert set(waves.pulses["saturation"]) == {2.0**bits - 1} and set(waves.pulses["anchor_range"]) == {0.0}


def test_every_echo_lies_where_its_time_says(tmp_path, params):
    """Two-way time and place of the truth agree through anchor, step and the segment's begin; the target, stored in
    whole millimetres 150 m away, turns the beam by up to 4 mm at 600 m."""
    truth = survey(tmp_path / "a.pls", pulses=40, jitter=0.0)
    waves = read(truth.path, params)
    row = np.searchsorted(waves.pulses["pulse"], truth.pulse)
    row += np.r_[0, np.diff(truth.pulse) == 0]
    for r, t, xyz in zip(row, truth.time, truth.xyz, strict=True):
        in_row = t + waves.pulses["anchor_time"][r]
        assert 0 <= in_row < 60
        np.testing.assert_allclose(places(waves, r, [in_row])[0], xyz, atol=0.006)


@pytest.mark.parametrize("chunk", [1, 7, 40])
def test_cutting_changes_nothing(tmp_path, base, chunk):
    truth = survey(tmp_path / "a.pls", pulses=40)
    source = open_source(truth.path)
    parts = {}
    for size in (chunk, 1000):
        params = ReadParams(**{**base["read"], "chunk_pulses": size})
        spans = index_source(source, params)
        assert len(spans) == -(-40 // size) and sum(s.n_pulses for s in spans) == 40
        parts[size] = [read_span(source, s, params) for s in spans]
    (whole,) = parts[1000]
    for name in whole.pulses:
        np.testing.assert_array_equal(np.concatenate([p.pulses[name] for p in parts[chunk]]), whole.pulses[name])
    np.testing.assert_array_equal(np.concatenate([p.samples for p in parts[chunk]]), whole.samples)
    np.testing.assert_array_equal(np.concatenate([p.outgoing for p in parts[chunk]]), whole.outgoing)


@pytest.mark.parametrize("duration_bits", [8, 16, 32])
@pytest.mark.parametrize(("segment_bits", "length_bits"), [(0, 0), (8, 8), (16, 16), (0, 16), (16, 0)])
def test_every_width_of_the_counts(tmp_path, params, duration_bits, segment_bits, length_bits):
    """Durations are signed, scaled and offset; counts are fixed or stored in one or two bytes."""
    sampling, segments = two_segments_of(duration_bits, segment_bits, length_bits)
    descriptor = Descriptor([sampling], extra=5, padding=12)
    path = write_pls(tmp_path / "a.pls", [Pulse(ANCHOR, AWAY, [segments])] * 3, {1: descriptor})
    waves = read(path, params)
    assert waves.faults == {}
    assert waves.pulses["pulse"].tolist() == [0, 0, 1, 1, 2, 2]
    assert waves.pulses["segment_start"].tolist() == [0.0, 90.5] * 3
    assert waves.pulses["anchor_time"].tolist() == [-2950.0, -3040.5] * 3
    np.testing.assert_array_equal(waves.samples, np.concatenate([s for _, s in segments] * 3))


def test_no_stored_duration_means_that_the_anchor_is_the_first_sample(tmp_path, params):
    samplings = [Sampling(duration_bits=0, segment_bits=0, segments=1)]
    waves = read(one(tmp_path / "a.pls", [[(0.0, np.arange(9))]], samplings=samplings), params)
    assert waves.pulses["anchor_time"].tolist() == [0.0]
    assert [waves.pulses[f"anchor_{a}"][0] for a in "xyz"] == list(ANCHOR)


@pytest.mark.parametrize(("unit", "spacing"), [(1.0, 1.0), (0.5, 0.5), (1.0, 2.0), (2.0, 1.0), (1.00503, 1.0)])
def test_units_of_durations_and_of_samples(tmp_path, params, unit, spacing):
    """Durations and the target count in the composition's unit, samples in their sampling's."""
    begin = 4000 * unit
    samplings = [Sampling(spacing=spacing)]
    waves = read(one(tmp_path / "a.pls", [[(begin, np.arange(50))]], samplings=samplings, unit=unit), params)
    assert waves.pulses["sample_spacing"].tolist() == [np.float32(spacing)]
    step = np.array([waves.pulses[f"step_{a}"][0] for a in "xyz"])
    np.testing.assert_allclose(np.linalg.norm(step), METRES_PER_NS, rtol=FLOAT32_CHAIN_RTOL)
    assert step[2] > 0, "the step points up the beam"
    np.testing.assert_allclose(places(waves, 0, [0.0, 10.0]), [beam(begin), beam(begin + 10)], atol=0.03)


def test_segments_that_continue_each_other_are_one_row(tmp_path, params):
    a, b, c, d = (np.full(n, v) for n, v in ((20, 1), (30, 2), (10, 3), (5, 4)))
    path = one(tmp_path / "a.pls", [(1000.0, a), (1080.0, c), (1020.0, b), (1090.4, d)])
    waves = read(path, params)
    assert waves.pulses["segment_start"].tolist() == [0.0, 80.0] and waves.pulses["pulse"].tolist() == [0, 0]
    np.testing.assert_array_equal(waves.samples, np.concatenate([a, b, c, d]))
    assert np.diff(waves.offsets).tolist() == [50, 15]


def test_overlapping_segments_and_second_channels_are_left_out_and_counted(tmp_path, params):
    samplings = [Sampling(channel=1), Sampling(channel=0), Sampling(channel=1)]
    flat = np.full(20, 9)
    segments = [[(1000.0, flat), (1010.0, flat)], [(1000.0, flat)], [(1100.0, flat)]]
    waves = read(one(tmp_path / "a.pls", segments, samplings=samplings, pulses=2), params)
    assert waves.pulses["segment_start"].tolist() == [0.0, 100.0] * 2
    assert waves.faults == {
        "segments of a second channel left out": 2,
        "segments that begin before the one before them ends, left out": 2,
    }


@pytest.mark.parametrize(("centre", "expected"), [(0, 0.0), (1000, 1000 * METRES_PER_NS), (0x8FFFFFFF, np.nan)])
def test_the_distance_to_the_optical_centre(tmp_path, params, centre, expected):
    waves = read(one(tmp_path / "a.pls", [(50.0, np.arange(9))], centre=centre), params)
    np.testing.assert_allclose(waves.pulses["anchor_range"], [expected], rtol=FLOAT32_CHAIN_RTOL)


def test_pulses_without_echo_or_outgoing_pulse(tmp_path, params):
    samplings = [Sampling(OUTGOING, scale=0.5), Sampling()]
    flat = np.full(20, 9)
    waves = [[[(0.0, flat)], []], [[], [(1000.0, flat)]], [[], []], [[(0.5, flat)], [(900.0, flat), (990.0, flat)]]]
    path = write_pls(tmp_path / "a.pls", [Pulse(ANCHOR, AWAY, w) for w in waves], {1: Descriptor(samplings)})
    got = read(path, params)
    assert got.faults == {} and got.pulses["pulse"].tolist() == [1, 3, 3]
    assert np.diff(got.outgoing_offsets).tolist() == [0, 20, 20]
    np.testing.assert_array_equal(got.pulses["outgoing_start"], [np.nan, 0.5, 0.5])
    assert info(path)["waveforms"]["unusable"] == {"no returning samples": 2}


@pytest.mark.parametrize(
    ("kind", "samples"),
    [
        (Sampling(OUTGOING, spacing=0.5), np.full(20, 9)),
        (Sampling(OUTGOING), np.full(20, 255)),
        (Sampling(OUTGOING, bits=16), np.full(20, 300)),
    ],
)
def test_an_outgoing_pulse_unlike_its_row_is_left_out(tmp_path, params, kind, samples):
    path = one(tmp_path / "a.pls", [[(0.0, samples)], [(900.0, np.full(9, 7))]], samplings=[kind, Sampling()])
    waves = read(path, params)
    assert waves.pulses.rows == 1 and len(waves.outgoing) == 0 and np.isnan(waves.pulses["outgoing_start"]).all()
    assert sum(waves.faults.values()) == 1 and "outgoing" in next(iter(waves.faults))


def test_an_outgoing_pulse_of_other_bits_is_kept_where_it_fits(tmp_path, params):
    samplings = [Sampling(OUTGOING, bits=16), Sampling()]
    path = one(tmp_path / "a.pls", [[(0.0, np.full(20, 200))], [(900.0, np.full(9, 7))]], samplings=samplings)
    waves = read(path, params)
    assert waves.faults == {} and waves.outgoing.tolist() == [200] * 20


@pytest.mark.parametrize(
    ("offset", "time", "read_as", "standard"),
    [(0.0, 400_000.0, 400_000.0, False), (1e9, 1e9 + 3e8, 3e8, True), (0.0, 3e8, 3e8, True)],
)
def test_gps_times_as_las_has_them(tmp_path, params, offset, time, read_as, standard):
    """Seconds of the week stay; standard time is adjusted, with no loss of microseconds."""
    pulses = [Pulse(ANCHOR, AWAY, [[(9.0, [1, 2])]], time=time + 2.5e-5 * k) for k in range(3)]
    path = write_pls(tmp_path / "a.pls", pulses, time_offset=offset)
    assert open_source(path).standard_gps_time == standard
    np.testing.assert_allclose(read(path, params).pulses["gps_time"] - read_as, 2.5e-5 * np.arange(3), atol=1.1e-6)


def test_info(tmp_path):
    truth = survey(tmp_path / "a.pls", pulses=40)
    found = json.loads(json.dumps(info(truth.path), allow_nan=False))
    assert found["pulses"] == found["waveforms"]["usable"] == found["outgoing"] == 40 and found["faults"] == []
    assert sum(int(k) * n for k, n in found["segments"].items()) == len(truth.pulse)
    low, high = np.array(found["bounds"][:3]), np.array(found["bounds"][3:])
    assert (truth.xyz >= low).all() and (truth.xyz <= high).all() and high[2] - low[2] < 80
    text = describe(found)
    for expected in (
        "PulseWaves 0.3",
        "40 pulses",
        "outgoing, 1 segments of 20 samples of 8 bits every 1.0 ns",
        "EPSG",
    ):
        assert expected in text


def test_bounds(tmp_path):
    """As PulseWaves means them: of the first and last returning samples; a header that says otherwise is told."""
    path = survey(tmp_path / "a.pls", pulses=40).path
    source = open_source(path)
    np.testing.assert_allclose(source.bounds, pulse_bounds(source), atol=0.01)
    patch(path, 304, "6d", *[0.0] * 6)
    np.testing.assert_allclose(source.bounds, pulse_bounds(open_source(path)), atol=0.01)
    assert info(path)["faults"] == ["the header's bounds disagree with the samples"]


def test_a_pulse_file_is_no_cloud(tmp_path):
    with pytest.raises(InputError, match="pulses, not points"):
        read_cloud(survey(tmp_path / "a.pls", pulses=2).path)


def test_no_pulses(tmp_path, params):
    path = write_pls(tmp_path / "a.pls", [])
    source = open_source(path)
    assert index_source(source, params) == [] and "the file has no pulses" in source.faults
    check_source(source, params)
    assert "no pulses" in describe(info(path))


# damage


def patch(path, at, form, *values):
    raw = bytearray(path.read_bytes())
    struct.pack_into("<" + form, raw, at, *values)
    path.write_bytes(raw)
    return path


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda p: p.write_bytes(b""), "empty"),
        (lambda p: p.write_bytes(b"PulseWavesPuls" + p.read_bytes()[14:300]), "inside its header|no PulseWaves"),
        (lambda p: p.write_bytes(p.read_bytes()[:200]), "inside its header"),
        (lambda p: p.write_bytes(b"LASF" + p.read_bytes()[4:]), "no PulseWaves file"),
        (lambda p: p.write_bytes(p.read_bytes()[:-10]), "cut short"),
        (lambda p: patch(p, 172, "BB", 1, 0), "unknown PulseWaves version"),
        (lambda p: patch(p, 172, "BB", 0, 2), "unknown PulseWaves version"),
        (lambda p: patch(p, 184, "q", 2**62), "cut short"),
        (lambda p: patch(p, 184, "q", -1), "offsets do not fit"),
        (lambda p: patch(p, 176, "q", 2**62), "offsets do not fit"),
        (lambda p: patch(p, 174, "H", 10), "offsets do not fit"),
        (lambda p: patch(p, 192, "I", 3), "unknown pulse format"),
        (lambda p: patch(p, 200, "I", 40), "unknown pulse format"),
        (lambda p: patch(p, 204, "I", 1), "how pulses are compressed"),
        (lambda p: patch(p, 216, "I", 2**32 - 1), "records run into the pulses"),
        (lambda p: patch(p, 224, "d", 0.0), "scales or offsets"),
        (lambda p: patch(p, 256, "d", np.nan), "scales or offsets"),
    ],
)
def test_a_useless_pulse_file_is_an_input_error(tmp_path, change, text):
    path = survey(tmp_path / "a.pls", pulses=3).path
    change(path)
    with pytest.raises(InputError, match=text) as caught:
        open_source(path)
    assert str(path) in str(caught.value) and "what to do" in str(caught.value)


@pytest.mark.parametrize("missing", ["error", "keep"])
@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda p: p.unlink(), r"put a\.wvs beside"),
        (lambda p: patch(p, 16, "I", 1), "compressed waves damaged"),
        (lambda p: p.write_bytes(b"x" * 5000), "no Waves file"),
        (lambda p: p.write_bytes(p.read_bytes()[:60]), "5 pulses: waves past the end"),
    ],
)
def test_without_usable_waves(tmp_path, params, change, text, missing):
    """A Pulse file holds nothing else, so there is nothing to keep."""
    path = survey(tmp_path / "a.pls", pulses=5).path
    change(path.with_suffix(".wvs"))
    source = open_source(path)
    with pytest.raises(InputError, match=text):
        check_source(source, params.model_copy(update={"missing_packets": missing}))
    waves = read(path, params)
    assert waves.pulses.rows == 0 and sum(waves.faults.values()) == 5
    assert "NO WAVEFORM CAN BE READ" in describe(info(path))


def test_the_other_files_are_named(tmp_path):
    path = survey(tmp_path / "a.pls", pulses=2).path
    with pytest.raises(InputError, match="not pulses"):
        open_source(path.with_suffix(".wvs"))
    with pytest.raises(InputError, match="cannot open"):
        open_source(tmp_path / "none.pls")


def record(path):
    """First byte of the pulses."""
    return struct.unpack_from("<q", path.read_bytes(), 176)[0]


@pytest.mark.parametrize(
    ("at", "form", "value", "fault"),
    [
        (8, "q", 10**15, "waves past the end"),
        (8, "q", -1, "no waves"),
        (8, "q", 0, "no waves"),
        (44, "H", 9, "unknown pulse descriptor"),
        (28, "3i", (0, 0, 0), "no sane beam vector"),
        (28, "3i", (2**31 - 1, 0, 0), "no sane beam vector"),
    ],
)
def test_a_bad_pulse_is_counted(tmp_path, params, at, form, value, fault):
    path = survey(tmp_path / "a.pls", pulses=5, two_segments=0.0).path
    patch(path, record(path) + 2 * 48 + at, form, *(value if isinstance(value, tuple) else (value,)))
    waves = read(path, params)
    assert waves.faults == {fault: 1} and waves.pulses["pulse"].tolist() == [0, 1, 3, 4]
    assert f"1 of 5 pulses: {fault}" in info(path)["faults"]


def test_heights_in_feet_are_told(tmp_path, params):
    path = survey(tmp_path / "a.pls", pulses=5, two_segments=0.0).path
    for at in (272, 296):  # scale and offset of z
        patch(path, at, "d", struct.unpack_from("<d", path.read_bytes(), at)[0] / 0.3048)
    with pytest.raises(InputError, match="look like feet"):
        check_source(open_source(path), params)


@pytest.mark.parametrize(
    ("at", "form", "value", "fault"),
    [
        (0, "B", 255, "waves cut short"),
        (5, "H", 65535, "waves cut short"),
        (1, "i", 2**31 - 1, "no sane duration from the anchor"),
    ],
)
def test_bad_waves_are_counted(tmp_path, params, at, form, value, fault):
    """The last of three pulses: the number of its segments, samples, and its duration (not scaled: 2 s)."""
    path = one(tmp_path / "a.pls", [(1000.0, np.arange(50))], pulses=3)
    wvs = path.with_suffix(".wvs")
    patch(wvs, len(wvs.read_bytes()) - 57 + at, form, value)
    waves = read(path, params)
    assert waves.faults == {fault: 1} and waves.pulses["pulse"].tolist() == [0, 1]


@pytest.mark.parametrize(
    ("sampling", "text"),
    [
        (Sampling(bits=0), "0 bits per sample"),
        (Sampling(bits=12), "12 bits per sample"),
        (Sampling(spacing=0.0), "spacing of 0 ns"),
        (Sampling(spacing=np.nan), "spacing of nan ns"),
        (Sampling(spacing=1e9), "spacing of 1e"),
        (Sampling(spacing=1e-30), "spacing of 1e-30"),
        (Sampling(scale=np.nan), "scaled by nan"),
        (Sampling(offset=np.inf), "offset by inf"),
        (Sampling(scale=0.0), "scaled by 0"),
        (Sampling(compression=1), "compressed samples"),
        (Sampling(kind=3), "unknown type 3"),
    ],
)
def test_a_bad_descriptor_is_told_and_counted(tmp_path, params, sampling, text):
    good = Sampling()
    descriptors = {1: Descriptor([good]), 2: Descriptor([sampling])}
    segment = [[(1000.0, np.arange(9))]]
    pulses = [Pulse(ANCHOR, AWAY, segment), Pulse(ANCHOR, AWAY, [[]], descriptor=2)]
    path = write_pls(tmp_path / "a.pls", pulses, descriptors)
    waves = read(path, params)
    assert waves.faults == {"unusable pulse descriptor": 1} and waves.pulses["pulse"].tolist() == [0]
    assert any(text in f for f in open_source(path).faults)


@pytest.mark.parametrize("tail", [(0, 0), (0, 1), (1, 0), (3, 2)])
def test_compression_and_scanner_stand_in_either_order(tmp_path, params, tail):
    """The specification and its library disagree; a scanner's index alone is no compression."""
    descriptor = Descriptor([Sampling()], tail=tail)
    path = write_pls(tmp_path / "a.pls", [Pulse(ANCHOR, AWAY, [[(1000.0, np.arange(9))]])], {1: descriptor})
    waves = read(path, params)
    assert waves.faults == ({} if 0 in tail else {"unusable pulse descriptor": 1})
    assert any("compressed waves" in f for f in open_source(path).faults) == (0 not in tail)


def test_endless_empty_segments(tmp_path, params):
    sampling = Sampling(segment_bits=0, segments=65535, length_bits=0, samples=0, duration_bits=0)
    path = write_pls(tmp_path / "a.pls", [Pulse(ANCHOR, AWAY, [[]])] * 50, {1: Descriptor([sampling], extra=1)})
    assert read(path, params).faults == {"too many segments": 50}


def test_pulses_that_all_claim_the_same_waves_are_refused(tmp_path, params):
    path = one(tmp_path / "a.pls", [(1000.0, np.zeros(60_000))], pulses=1)
    raw, start = path.read_bytes(), record(path)
    path.write_bytes(raw[:184] + struct.pack("<q", 1000) + raw[192:start] + raw[start : start + 48] * 1000)
    with pytest.raises(InputError, match="overlap"):
        read(path, params)


def test_descriptors_of_several_kinds(tmp_path, params):
    rng = np.random.default_rng(5)
    kinds = {1: Sampling(bits=8), 2: Sampling(bits=16, spacing=0.5), 7: Sampling(bits=8, spacing=2.0)}
    owner = rng.permutation(np.repeat(list(kinds), 9)).tolist()
    blocks = [rng.integers(0, 2 ** kinds[k].bits, 20 + k) for k in owner]
    pulses = [Pulse(ANCHOR, AWAY, [[(1000.0, b)]], descriptor=k) for k, b in zip(owner, blocks, strict=True)]
    path = write_pls(tmp_path / "a.pls", pulses, {k: Descriptor([s]) for k, s in kinds.items()})
    waves = read(path, params)
    np.testing.assert_array_equal(waves.samples, np.concatenate(blocks))
    assert waves.pulses["saturation"].tolist() == [2.0 ** kinds[k].bits - 1 for k in owner]
    assert waves.pulses["sample_spacing"].tolist() == [kinds[k].spacing for k in owner]


@pytest.mark.parametrize("appended", [None, 1])
@pytest.mark.parametrize("extra", [0, 6])
def test_pulses_behind_those_that_the_header_counts_are_refused_and_other_bytes_are_not(tmp_path, appended, extra):
    path = survey(tmp_path / "a.pls", pulses=50, appended=appended, extra_bytes=extra).path
    raw = bytearray(path.read_bytes())
    open_source(path)
    if appended is None:
        for behind in (bytes(3000), bytes(range(256)) * 12, b"x"):
            path.write_bytes(raw + behind)
            open_source(path)
    for count in (30, 0):
        struct.pack_into("<q", raw, 184, count)
        path.write_bytes(raw)
        with pytest.raises(InputError, match="fewer pulses than the file holds") as error:
            open_source(path)
        assert f"room for {50 - count}" in str(error.value) or appended
    assert "fewer pulses" in fault_of(path, (path.with_suffix(".wvs"),), tmp_path, marked=True)


def test_maker_lengths():
    """The public lengths of the records: 196 bytes with one sampling, 300 with two."""
    assert [len(Descriptor([Sampling()] * n).pack()) for n in (1, 2)] == [196, 300]
    assert len(plsmaker.vlr("a", 1, b"")) == 96
