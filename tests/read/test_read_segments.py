"""Several packets of one pulse: one pulse, in one row where they continue each other."""

from __future__ import annotations

import numpy as np
import pytest
from lasmaker import METRES_PER_NS, Descriptor, to_laz, write_las
from tolerances import FLOAT32_RTOL

from fwclass.read.info import info
from fwclass.read.packets import REPEATED
from fwclass.read.params import ReadParams
from fwclass.read.source import open_source
from fwclass.read.stage import check_source, index_source, read_span

N = 40
"""Samples of a packet, 1 ns apart."""


@pytest.fixture
def params(base) -> ReadParams:
    return ReadParams(**base["read"])


def segmented(path, starts, *, per_segment=1, pulses=1, tilt=0.1, change=None, wave_kinds=None, **options):
    """Pulses with a packet of N samples at every one of `starts` [ns], each with `per_segment` returns.

    Return k of a segment is at 5 + 10 k ns. `change` edits the arguments of `write_las` before writing.
    """
    rng = np.random.default_rng(1)
    xyz, number, packet, location, step, time, waveforms = [], [], [], [], [], [], []
    for p in range(pulses):
        beam = np.array([tilt * np.sin(p), tilt, 1.0])
        beam *= METRES_PER_NS / np.linalg.norm(beam)
        top = np.array([1000.0 + 0.4 * p, 2000.0, 300.0])
        for s, start in enumerate(starts):
            waveforms.append(rng.integers(0, 255, N))
            for k in range(per_segment):
                xyz.append(top - (start + 5 + 10 * k) * beam)
                number.append(s * per_segment + k + 1)
                packet.append(len(waveforms) - 1)
                location.append(5.0 + 10 * k)
                step.append(beam)
                time.append(1000.0 + 1e-5 * p)
    made = {
        "xyz": np.array(xyz),
        "return_number": np.array(number),
        "pulse": np.array(packet),
        "number_of_returns": np.full(len(xyz), len(starts) * per_segment),
        "location": np.array(location),
        "step": np.array(step),
        "gps_time": np.array(time),
        "waveforms": waveforms,
        "descriptors": {1: Descriptor(n_samples=N), 2: Descriptor(n_samples=N, spacing_ps=2000)},
        "descriptor_of": wave_kinds or [],
        **options,
    }
    if change:
        change(made)
    return write_las(path, made.pop("xyz"), **made), waveforms


def read(path, params):
    source = open_source(path)
    check_source(source, params)
    (span,) = index_source(source, params)
    return read_span(source, span, params)


def places(waves, row, times):
    """P(t) of a row, (n, 3)."""
    p = waves.pulses
    step = np.array([p[f"step_{a}"][row] for a in "xyz"])
    anchor = np.array([p[f"anchor_{a}"][row] for a in "xyz"])
    return anchor + (p["anchor_time"][row] - np.asarray(times, float))[:, None] * step


@pytest.mark.parametrize("point_format", [4, 9])
@pytest.mark.parametrize("per_segment", [1, 2])
def test_segments_apart_are_rows_of_one_pulse(tmp_path, params, point_format, per_segment):
    path, waveforms = segmented(
        tmp_path / "a.las", [0, 55, 300], per_segment=per_segment, pulses=7, point_format=point_format
    )
    waves = read(path, params)
    assert waves.pulses["pulse"].tolist() == np.repeat(np.arange(7), 3).tolist()
    assert waves.returns["pulse"].tolist() == np.repeat(np.arange(7), 3 * per_segment).tolist()
    np.testing.assert_allclose(waves.pulses["segment_start"], [0, 55, 300] * 7, atol=0.02)  # whole millimetres
    np.testing.assert_array_equal(waves.samples, np.concatenate(waveforms))
    assert np.diff(waves.offsets).tolist() == [N] * 21
    # a return's location counts from the pulse's first sample
    place = np.tile([s + 5 + 10 * k for s in (0, 55, 300) for k in range(per_segment)], 7)
    np.testing.assert_allclose(waves.returns["location"], place, atol=0.02)
    # the same instant has one place, whichever row tells it
    np.testing.assert_allclose(places(waves, 0, [310.0]), places(waves, 2, [10.0]), atol=0.003)
    # every row's anchor is a return of its own packet
    np.testing.assert_allclose(waves.pulses["anchor_time"], 5.0)


@pytest.mark.parametrize("jitter", [0.0, 0.4])
def test_segments_that_continue_each_other_are_one_row(tmp_path, params, jitter):
    """Stored locations jitter by half a sample."""
    shift = np.array([0.0, jitter, -jitter / 2])

    def shifted(made):
        made["location"] = made["location"] + np.tile(shift, 5)

    path, waveforms = segmented(tmp_path / "a.las", [0, N, 2 * N], pulses=5, change=shifted)
    waves = read(path, params)
    assert waves.pulses["pulse"].tolist() == list(range(5))
    assert waves.pulses["segment_start"].tolist() == [0.0] * 5
    assert np.diff(waves.offsets).tolist() == [3 * N] * 5
    np.testing.assert_array_equal(waves.samples, np.concatenate(waveforms))
    expected = np.tile(np.array([5.0, N + 5.0, 2 * N + 5.0]) + shift, 5)
    np.testing.assert_allclose(waves.returns["location"], expected, rtol=FLOAT32_RTOL)
    np.testing.assert_allclose(places(waves, 0, [5.0, N + 5.0])[0], [waves.returns[a][0] for a in "xyz"], atol=1e-3)


def test_some_joined_some_apart(tmp_path, params):
    path, waveforms = segmented(tmp_path / "a.las", [0, N, 3 * N, 4 * N], pulses=3)
    waves = read(path, params)
    assert waves.pulses["pulse"].tolist() == [0, 0, 1, 1, 2, 2]
    np.testing.assert_allclose(waves.pulses["segment_start"], [0, 3 * N] * 3, atol=0.02)
    assert np.diff(waves.offsets).tolist() == [2 * N] * 6
    np.testing.assert_array_equal(waves.samples, np.concatenate(waveforms))


def test_other_spacing_is_a_row_of_its_own(tmp_path, params):
    path, _ = segmented(tmp_path / "a.las", [0, N], pulses=2, wave_kinds=[1, 2, 1, 2])
    waves = read(path, params)
    assert waves.pulses["pulse"].tolist() == [0, 0, 1, 1]
    assert waves.pulses["sample_spacing"].tolist() == [1.0, 2.0, 1.0, 2.0]


def _set(name, value):
    def change(made):
        made[name] = value(made[name]) if callable(value) else value

    return change


@pytest.mark.parametrize(
    "change",
    [
        _set("gps_time", 0.0),
        _set("gps_time", np.nan),
        _set("gps_time", lambda t: t + 1e-6 * np.arange(len(t))),
        _set("number_of_returns", 1),
        _set("number_of_returns", lambda n: n + np.arange(len(n)) % 2),
        _set("return_number", 1),
        _set("xyz", lambda p: p + [[0.3, 0, 0], [0, 0, 0]] * (len(p) // 2)),
        _set("step", lambda v: v * [[1.0, 1.01, 1.0], [1, 1, 1]]),
    ],
    ids=["time 0", "time NaN", "other time", "single returns", "other count", "same number", "beside", "turned"],
)
def test_other_pulses_are_not_glued(tmp_path, params, change):
    path, _ = segmented(tmp_path / "a.las", [0, 55], change=change)
    waves = read(path, params)
    assert waves.pulses["pulse"].tolist() == [0, 1]
    assert waves.pulses["segment_start"].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("starts", [[0, 20], [0, 0], [0, 39.0], [50, 0], [0, 10_000]])
def test_packets_that_overlap_go_back_or_are_kilometres_apart_are_not_glued(tmp_path, params, starts):
    waves = read(segmented(tmp_path / "a.las", starts)[0], params)
    assert waves.pulses["pulse"].tolist() == [0, 1]


def test_pulses_that_share_a_coarse_time_are_not_glued(tmp_path, params):
    """All pulses carry one GPS time; only the segments of a pulse are on one line."""
    path, _ = segmented(tmp_path / "a.las", [0, 55], pulses=30, change=_set("gps_time", 1000.0))
    waves = read(path, params)
    assert waves.pulses["pulse"].tolist() == np.repeat(np.arange(30), 2).tolist()


@pytest.mark.parametrize("chunk", [1, 3, 10])
@pytest.mark.parametrize("kind", ["las", "laz"])
def test_cutting_changes_nothing(tmp_path, base, monkeypatch, chunk, kind):
    """Neither spans nor the blocks of the stream, one of which ends in the middle of a pulse, matter."""
    path, _ = segmented(tmp_path / "a.las", [0, N, 55 + N], per_segment=2, pulses=20)
    if kind == "laz":
        laz = to_laz(path, tmp_path / "b.laz")
        path.with_suffix(".wdp").rename(laz.with_suffix(".wdp"))
        path = laz
    source = open_source(path)
    one = read(path, ReadParams(**base["read"]))
    monkeypatch.setattr("fwclass.read.points.BLOCK", 7)
    params = ReadParams(**{**base["read"], "chunk_pulses": chunk})
    spans = index_source(source, params)
    assert len(spans) == -(-20 // chunk) and sum(s.n_pulses for s in spans) == 20
    parts = [read_span(source, s, params) for s in spans]
    for name in one.pulses:
        np.testing.assert_array_equal(np.concatenate([p.pulses[name] for p in parts]), one.pulses[name])
    for name in one.returns:
        np.testing.assert_array_equal(np.concatenate([p.returns[name] for p in parts]), one.returns[name])
    np.testing.assert_array_equal(np.concatenate([p.samples for p in parts]), one.samples)


def test_real_segments(shared_data, params):
    """Five pulses of the RIEGL file have two packets each, whole samples apart."""
    waves = read(shared_data / "waveform" / "riegl_q680i.las", params)
    second = waves.pulses.take(waves.pulses["segment_start"] > 0)
    assert second.rows == 5
    gaps = second["segment_start"] - 60.0
    np.testing.assert_allclose(gaps, np.rint(gaps), atol=0.01)
    assert sorted(np.rint(gaps).astype(int).tolist()) == [4, 4, 8, 8, 12]


def overlapping(path, starts, *, pulses=6, jitter=0.0, **options):
    """Pulses whose returns have a window each of one record of 120 samples, from every one of `starts` on."""
    records = [np.random.default_rng(p).integers(0, 255, 120) for p in range(pulses)]
    rng = np.random.default_rng(9)

    def cut(made):
        made["waveforms"] = [record[s : s + N] for record in records for s in starts]
        made["location"] = made["location"] + rng.uniform(-jitter, jitter, len(made["location"]))

    return segmented(path, starts, pulses=pulses, change=cut, **options)[0], records


@pytest.mark.parametrize("jitter", [0.0, 0.2])
@pytest.mark.parametrize("starts", [[0, 0], [0, 20], [0, 13, 13, 50], [0, 0, 39, 79], [0, 0, 0, 20, 20]])
@pytest.mark.parametrize("kind", ["u1", "u2"])
def test_windows_of_one_record_are_one_waveform(tmp_path, params, starts, jitter, kind):
    descriptors = {1: Descriptor(n_samples=N, bits=8 * int(kind[1]))}
    path, records = overlapping(tmp_path / "a.las", starts, jitter=jitter, descriptors=descriptors)
    waves = read(path, params)
    last = max(starts) + N
    assert waves.pulses["pulse"].tolist() == list(range(6))
    np.testing.assert_array_equal(waves.samples, np.concatenate([r[:last] for r in records]))
    np.testing.assert_allclose(waves.returns["location"], np.tile(np.array(starts) + 5, 6), atol=0.02 + jitter)
    repeats = sum(b < a + N for a, b in zip(starts[:-1], starts[1:], strict=True))
    assert waves.faults == {REPEATED: 6 * repeats}
    assert f"{6 * repeats} of {6 * len(starts)} returns: {REPEATED}" in info(path)["faults"]


def test_windows_of_one_record_and_apart(tmp_path, params):
    path, records = overlapping(tmp_path / "a.las", [0, 20, 75])
    waves = read(path, params)
    assert waves.pulses["segment_start"].tolist() == pytest.approx([0, 75] * 6, abs=0.02)
    np.testing.assert_array_equal(waves.samples, np.concatenate([np.r_[r[:60], r[75:115]] for r in records]))


def test_sound_segments_repeat_nothing(tmp_path, params):
    path, _ = segmented(tmp_path / "a.las", [0, N, 55 + N], pulses=6)
    assert read(path, params).faults == {}
    assert not [f for f in info(path)["faults"] if REPEATED in f]
