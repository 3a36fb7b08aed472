"""From a file to echoes: positions, numbering, links, and what happens to returns without a waveform."""

from __future__ import annotations

import numpy as np
import pytest
from lasmaker import digitise, gaussian, survey, write_las
from scipy.stats import spearmanr
from tolerances import FLOAT32_RTOL, FLOAT32_UNIT, MILLIMETRE

from fwclass.decompose.params import DecomposeParams, PulseParams
from fwclass.decompose.pulse_estimate import estimate_pulse
from fwclass.decompose.stage import LINK_COLUMNS, decompose
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.read.params import ReadParams
from fwclass.read.source import open_source
from fwclass.read.stage import index_source, read_span
from fwclass.schema import Table, canonical_key
from fwclass.waveforms import ECHO_COLUMNS, Waveforms


def spans(path, base, **read):
    params = ReadParams(**{**base["read"], **read})
    source = open_source(path)
    return [read_span(source, s, params) for s in index_source(source, params)]


def run(path, base, read=None, fwhm=3.5, **changes) -> tuple[Table, Table]:
    params = DecomposeParams(**{**base["decompose"], "tail_share": 0.0, **changes})
    parts = [decompose(w, 3, params, SystemPulse.gaussian(fwhm, 0.01)) for w in spans(path, base, **(read or {}))]
    return Table.concat(p[0] for p in parts), Table.concat(p[1] for p in parts)


def check_sound(echoes: Table, links: Table) -> None:
    """What holds for every result: declared columns, unique canonical rows, links that lead somewhere."""
    assert tuple(echoes) == ECHO_COLUMNS and tuple(links) == LINK_COLUMNS
    key = canonical_key(echoes)
    assert (np.diff(key.astype(np.int64)) > 0).all()
    assert (echoes["strip"] == 3).all() and (echoes["number_of_echoes"] >= echoes["echo_number"]).all()
    mine = (np.uint64(3) << np.uint64(40)) | (links["pulse"].astype(np.uint64) << np.uint64(8))
    assert np.isin(mine | links["echo_number"].astype(np.uint64), key).all()
    for axis in "xyz":
        np.testing.assert_array_equal(echoes[axis], np.rint(echoes[axis] / 0.001) * 0.001)


@pytest.mark.parametrize("point_format", [4, 10])
@pytest.mark.parametrize("spacing_ps", [500, 1000])
def test_echoes_lie_where_they_were_put(tmp_path, base, point_format, spacing_ps):
    options = {"n_samples": 60_000 // spacing_ps, "spacing_ps": spacing_ps, "noise": 0.7}
    truth = survey(tmp_path / "a.las", pulses=300, point_format=point_format, **options)
    echoes, links = run(truth.path, base, register_within=0.0)
    check_sound(echoes, links)
    assert (echoes["origin"] == 0).all()
    at = np.searchsorted(canonical_key(echoes), key_of(links))
    xyz = np.c_[echoes["x"], echoes["y"], echoes["z"]][at]
    distance = np.linalg.norm(xyz - truth.xyz, axis=1)
    # 20 DN over a noise of 0.7 DN: 1 sigma is 0.06 ns or 9 mm, shared echoes somewhat more
    assert np.median(distance) < 0.005 and np.percentile(distance, 99) < 0.05
    assert abs(np.median(echoes["width"][at] - truth.width)) < 0.02
    np.testing.assert_allclose(np.median(echoes["amplitude"][at] / truth.amplitude), 1.0, atol=0.005)
    # attributes come from the nearest return
    expected = np.where(np.r_[np.diff(truth.pulse), 1] != 0, 2, 5)
    assert (echoes["source_class"][at] == expected).mean() > 0.999
    assert (echoes["intensity"][at] == np.rint(truth.amplitude)).mean() > 0.999
    np.testing.assert_allclose(echoes["gps_time"][at], 1000 + 1e-5 * truth.pulse)
    beam = np.c_[echoes["beam_x"], echoes["beam_y"], echoes["beam_z"]]
    np.testing.assert_allclose(np.linalg.norm(beam, axis=1), 1.0, atol=FLOAT32_UNIT)
    assert (beam[:, 2] < -0.9).all()


def key_of(links: Table):
    return canonical_key(links.with_columns({"strip": np.full(links.rows, 3)}))


def test_jittering_locations_are_registered(tmp_path, base):
    """Locations that jitter by half a nanosecond per pulse; the positions of the returns are right."""
    truth = survey(tmp_path / "a.las", pulses=300, noise=0.7, jitter=0.5)
    for register, low, high in ((0.0, 0.03, 1.0), (0.75, 0.0, 0.02)):
        echoes, links = run(truth.path, base, register_within=register)
        at = np.searchsorted(canonical_key(echoes), key_of(links))
        xyz = np.c_[echoes["x"], echoes["y"], echoes["z"]][at]
        assert low < np.percentile(np.linalg.norm(xyz - truth.xyz, axis=1), 90) < high


@pytest.mark.statistics
@pytest.mark.parametrize("chunk", [1, 17, 64])
def test_chunks_change_nothing(tmp_path, base, chunk):
    truth = survey(tmp_path / "a.las", pulses=150, seed=5)
    whole = run(truth.path, base)
    parts = run(truth.path, base, read={"chunk_pulses": chunk})
    for a, b in zip(whole, parts, strict=True):
        for name in a:
            np.testing.assert_array_equal(a[name], b[name])


def test_returns_without_packet_stay(tmp_path, base):
    """Pulse 0 has a waveform, the others do not; nothing is lost and nothing is doubled."""
    y = digitise(gaussian(60, [(100.0, 20.0, 3.6)]))
    path = write_las(
        tmp_path / "a.las",
        [(0, 0, 5), (1, 0, 6), (1, 0, 4), (2, 0, 7)],
        return_number=[1, 2, 1, 1],
        number_of_returns=[1, 2, 2, 1],
        intensity=[9, 8, 7, 6],
        classification=[1, 2, 3, 4],
        waveforms=[y, y, y],
        pulse=[0, 1, 1, 2],
        location=20.0,
        wave={"size": [60, 6, 6, 6]},
        extra={"Pulse width": ("u2", 0.1, [40, 41, 42, 43])},
    )
    echoes, links = run(path, base)
    check_sound(echoes, links)
    assert echoes["origin"].tolist() == [0, 1, 1, 1]
    assert echoes["pulse"].tolist() == [0, 1, 1, 2]
    assert echoes["echo_number"].tolist() == [1, 1, 2, 1]
    assert echoes["number_of_echoes"].tolist() == [1, 2, 2, 1]
    assert echoes["z"].tolist() == [5, 4, 6, 7]  # in the order of the return numbers
    assert echoes["amplitude"].tolist()[1:] == [7, 8, 6]
    np.testing.assert_allclose(echoes["width"][1:], [4.2, 4.1, 4.3], rtol=FLOAT32_RTOL)
    assert np.isnan(echoes["beam_x"][1:]).all() and not np.isnan(echoes["beam_x"][0])
    assert echoes["source_class"].tolist() == [1, 3, 2, 4]
    assert links["pulse"].tolist() == [0, 1, 1, 2] and links["echo_number"].tolist() == [1, 2, 1, 1]


def test_a_waveform_without_echo_keeps_the_vendors_return(tmp_path, base):
    path = write_las(
        tmp_path / "a.las",
        [(0, 0, 5), (0, 0, 4)],
        waveforms=[np.full(60, 12)],
        pulse=[0, 0],
        return_number=[1, 2],
        number_of_returns=2,
        location=[20.0, 27.0],
        intensity=[3, 4],
    )
    echoes, links = run(path, base)
    check_sound(echoes, links)
    assert echoes["origin"].tolist() == [0, 0] and echoes["fit_flags"].tolist() == [16, 16]
    assert echoes["amplitude"].tolist() == [3, 4] and echoes["time"].tolist() == [20, 27]
    np.testing.assert_allclose(echoes["beam_z"], -1.0)


def test_an_echo_far_from_the_vendors_return_is_flagged(tmp_path, base):
    y = digitise(gaussian(60, [(100.0, 20.0, 3.6)]))
    path = write_las(tmp_path / "a.las", [(0, 0, 0)] * 2, waveforms=[y, y], location=[20.3, 45.0])
    echoes, _ = run(path, base)
    assert (echoes["fit_flags"] & 32).tolist() == [0, 32]
    np.testing.assert_allclose(echoes["z"][1], 25.0 * 0.149855, atol=0.01)  # the location is believed


@pytest.mark.parametrize("point_format", [1, 6])
def test_files_without_waveforms_enter_as_echoes(tmp_path, base, point_format):
    extra = {"Amplitude": ("i2", 0.01, [1500, 1600, 1700]), "Pulse width": ("u2", 0.1, [40, 41, 42])}
    options = {"point_format": point_format, "return_number": [1, 2, 0], "number_of_returns": [2, 2, 0]}
    xyz = [(0, 0, 3), (0, 0, 2), (0, 0, 1)]
    for given, amplitude, width in ((extra, [15, 16, 17], [4.0, 4.1, 4.2]), (None, [100] * 3, [np.nan] * 3)):
        echoes, links = run(write_las(tmp_path / "a.las", xyz, extra=given, **options), base)
        check_sound(echoes, links)
        assert echoes["origin"].tolist() == [2, 2, 2] and echoes["pulse"].tolist() == [0, 1, 2]
        assert echoes["echo_number"].tolist() == [1, 2, 1]
        assert echoes["number_of_echoes"].tolist() == [2, 2, 1]
        np.testing.assert_allclose(echoes["amplitude"], amplitude)
        np.testing.assert_allclose(echoes["width"], width, rtol=FLOAT32_RTOL)
        assert links["pulse"].tolist() == [0, 1, 2]


def test_missing_wdp_keeps_pulses_together(tmp_path, base):
    truth = survey(tmp_path / "a.las", pulses=40, seed=6)
    truth.path.with_suffix(".wdp").unlink()
    echoes, links = run(truth.path, base)
    check_sound(echoes, links)
    assert (echoes["origin"] == 1).all()
    np.testing.assert_array_equal(echoes["pulse"], truth.pulse)
    np.testing.assert_allclose(np.c_[echoes["x"], echoes["y"], echoes["z"]], truth.xyz, atol=MILLIMETRE)


def test_real_riegl_file(shared_data, base):
    """The vendor's echoes are found again: single returns of single-echo pulses, and the second echoes of others
    relative to the first, which the shift onto the anchor return says nothing about."""
    path = shared_data / "waveform" / "riegl_q680i.las"
    (waves,) = spans(path, base)
    pulse = estimate_pulse(waves, PulseParams(**base["pulse"]))
    assert pulse.shape == "measured" and 4.3 < pulse.fwhm < 4.5
    echoes, links, _ = decompose(waves, 3, DecomposeParams(**base["decompose"]), pulse)
    check_sound(echoes, links)
    returns = waves.returns
    at = np.searchsorted(canonical_key(echoes), key_of(links))
    distance = np.sqrt(sum((echoes[a][at] - returns[a]) ** 2 for a in "xyz"))
    isolated = (np.bincount(returns["pulse"])[returns["pulse"]] == 1) & (returns["number_of_returns"] == 1)
    assert isolated.sum() > 2000
    assert (distance[isolated] < 0.05).mean() >= 0.95
    single = isolated & (echoes["number_of_echoes"][at] == 1)
    assert single.sum() > 1850, "ringing is in the pulse's shape, not in echoes"
    width, vendor = echoes["width"][at][single], returns["vendor_width"][single]
    assert abs(np.median(width - vendor)) <= 0.07, "the vendor's are whole tenths"
    assert np.corrcoef(width, vendor)[0, 1] >= 0.9
    # the vendor's amplitude is in decibels, and the receiver bends at the top: only the order can agree
    order = spearmanr(echoes["amplitude"][at][single], returns["vendor_amplitude"][single]).statistic
    assert order > 0.95
    assert (echoes["fit_flags"][at] & 32 == 0).mean() > 0.99
    # between the echoes of a pulse the jitter of the stored location does not count; returns of 0 dB or less, or of a
    # wrapped amplitude, are what its receiver's ringing made of the first
    sound = (returns["vendor_amplitude"] > 0.9) & (returns["vendor_amplitude"] < 100.0)
    several = sound & (np.bincount(returns["pulse"], weights=sound)[returns["pulse"]] > 1)
    late = echoes["time"][at][several] - returns["location"][several].astype(float)
    pulses = returns["pulse"][several]
    mean = np.bincount(pulses, late) / np.maximum(np.bincount(pulses), 1)
    apart = late - mean[pulses]
    assert several.sum() > 280
    assert np.median(np.abs(apart)) < 0.05 and (np.abs(apart) < 0.3).mean() > 0.95


def sensor_view(waves, delay=0.0):
    """The same chunk as a format tells it that knows the sensor's place and the outgoing pulse, and no returns."""
    pulses, n = waves.pulses, waves.pulses.rows
    away = 2000.0  # ns from the outgoing pulse to the anchor return's echo
    sensor = {f"anchor_{a}": pulses[f"anchor_{a}"] + away * pulses[f"step_{a}"] for a in "xyz"}
    t = np.arange(24.0)
    outgoing = np.rint(10.0 + 150.0 * np.exp(-0.5 * ((t - 11.3) / 1.4863) ** 2)).astype(waves.samples.dtype)
    return Waveforms(
        pulses.with_columns(
            {
                **sensor,
                "anchor_range": np.zeros(n),
                "anchor_time": pulses["anchor_time"].astype(float) - away - delay,
                "outgoing_start": np.full(n, delay - 11.3),
            }
        ),
        Table.empty(waves.returns),
        waves.samples,
        waves.offsets,
        outgoing=np.tile(outgoing, n),
        outgoing_offsets=24 * np.arange(n + 1),
    )


@pytest.mark.parametrize("delay", [0.0, 7.25])
def test_the_outgoing_pulse_is_the_time_origin(tmp_path, base, delay):
    """Places do not depend on when the digitiser started; the range is the way from the sensor."""
    truth = survey(tmp_path / "a.las", pulses=100, noise=0.7)
    (waves,) = spans(truth.path, base)
    params = DecomposeParams(**{**base["decompose"], "tail_share": 0.0, "register_within": 0.0})
    plain, _, _ = decompose(waves, 3, params, SystemPulse.gaussian(3.5))
    echoes, links, _ = decompose(sensor_view(waves, delay), 3, params, SystemPulse.gaussian(3.5))
    check_sound(echoes, links)
    assert links.rows == 0 and echoes.rows == plain.rows
    for axis in "xyz":
        np.testing.assert_allclose(echoes[axis], plain[axis], atol=0.004)
    assert np.isnan(plain["beam_range"]).all()
    step = 0.299792458 / 2 / 1.000273
    np.testing.assert_allclose(echoes["beam_range"], 2000.0 * step, atol=12.0)
    first = echoes["echo_number"] == 1
    sensor = sensor_view(waves).pulses
    distance = np.sqrt(sum((echoes[a][first] - sensor[f"anchor_{a}"]) ** 2 for a in "xyz"))
    np.testing.assert_allclose(echoes["beam_range"][first], distance, atol=0.005)
    assert (echoes["fit_flags"] & 32 == 0).all() and (echoes["source_class"] == 0).all()


def test_segments_of_a_pulse_are_numbered_together(tmp_path, base):
    """A waveform cut in two rows that both know the anchor: the same echoes, numbered through."""
    truth = survey(tmp_path / "a.las", pulses=240, noise=0.7, n_samples=120)
    (waves,) = spans(truth.path, base)
    params = DecomposeParams(**{**base["decompose"], "tail_share": 0.0, "register_within": 0.0})
    whole, _, _ = decompose(waves, 3, params, SystemPulse.gaussian(3.5))
    cut = 60
    twice = waves.pulses.take(np.repeat(np.arange(240), 2))
    later = np.arange(480) % 2 == 1
    pulses = twice.with_columns(
        {"segment_start": np.where(later, cut, 0.0), "anchor_time": twice["anchor_time"] - np.where(later, cut, 0.0)}
    )
    offsets = np.sort(np.r_[waves.offsets, waves.offsets[:-1] + cut])
    parts, links, _ = decompose(
        Waveforms(pulses, waves.returns, waves.samples, offsets), 3, params, SystemPulse.gaussian(3.5)
    )
    check_sound(parts, links)
    near = np.abs(whole["time"] - cut) < 12.0  # an echo at the cut is seen twice, by halves
    counts = [np.bincount(t["pulse"], minlength=240) for t in (whole, parts)]
    clear = ~np.isin(np.arange(240), whole["pulse"][near])
    same = clear & (counts[0] == counts[1])
    assert clear.sum() > 50 and same.sum() > 0.9 * clear.sum()
    assert (counts[0][same] > 1).sum() > 10
    a, b = same[parts["pulse"]], same[whole["pulse"]]
    for name, atol in (("time", 0.3), ("z", 0.05), ("echo_number", 0), ("number_of_echoes", 0)):
        np.testing.assert_allclose(parts[name][a], whole[name][b], atol=atol)
