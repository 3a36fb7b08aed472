"""From a file to echoes: positions, numbering, links, and what happens to returns without a waveform."""

from __future__ import annotations

import numpy as np
import pytest
from lasmaker import digitise, gaussian, survey, write_las
from scipy.stats import spearmanr

from fwclass.decompose.stage import ECHO_COLUMNS, LINK_COLUMNS, DecomposeParams, decompose
from fwclass.read.stage import ReadParams, index_source, open_source, read_span
from fwclass.schema import Table, canonical_key


def spans(path, base, **read):
    params = ReadParams(**{**base["read"], **read})
    source = open_source(path)
    return [read_span(source, s, params) for s in index_source(source, params)]


def run(path, base, read=None, **changes) -> tuple[Table, Table]:
    params = DecomposeParams(**{**base["decompose"], "tail_share": 0.0, **changes})
    parts = [decompose(w, 3, params) for w in spans(path, base, **(read or {}))]
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
    np.testing.assert_allclose(np.linalg.norm(beam, axis=1), 1.0, atol=1e-6)
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
        tmp_path / "a.las", [(0, 0, 5), (1, 0, 6), (1, 0, 4), (2, 0, 7)], return_number=[1, 2, 1, 1],
        number_of_returns=[1, 2, 2, 1], intensity=[9, 8, 7, 6], classification=[1, 2, 3, 4],
        waveforms=[y, y, y], pulse=[0, 1, 1, 2], location=20.0, wave={"size": [60, 6, 6, 6]},
        extra={"Pulse width": ("u2", 0.1, [40, 41, 42, 43])},
    )  # fmt: skip
    echoes, links = run(path, base)
    check_sound(echoes, links)
    assert echoes["origin"].tolist() == [0, 1, 1, 1]
    assert echoes["pulse"].tolist() == [0, 1, 1, 2]
    assert echoes["echo_number"].tolist() == [1, 1, 2, 1]
    assert echoes["number_of_echoes"].tolist() == [1, 2, 2, 1]
    assert echoes["z"].tolist() == [5, 4, 6, 7]  # in the order of the return numbers
    assert echoes["amplitude"].tolist()[1:] == [7, 8, 6]
    np.testing.assert_allclose(echoes["width"][1:], [4.2, 4.1, 4.3], rtol=1e-6)
    assert np.isnan(echoes["beam_x"][1:]).all() and not np.isnan(echoes["beam_x"][0])
    assert echoes["source_class"].tolist() == [1, 3, 2, 4]
    assert links["pulse"].tolist() == [0, 1, 1, 2] and links["echo_number"].tolist() == [1, 2, 1, 1]


def test_a_waveform_without_echo_keeps_the_vendors_return(tmp_path, base):
    path = write_las(
        tmp_path / "a.las", [(0, 0, 5), (0, 0, 4)], waveforms=[np.full(60, 12)], pulse=[0, 0], return_number=[1, 2],
        number_of_returns=2, location=[20.0, 27.0], intensity=[3, 4],
    )  # fmt: skip
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
        np.testing.assert_allclose(echoes["width"], width, rtol=1e-6)
        assert links["pulse"].tolist() == [0, 1, 2]


def test_missing_wdp_keeps_pulses_together(tmp_path, base):
    truth = survey(tmp_path / "a.las", pulses=40, seed=6)
    truth.path.with_suffix(".wdp").unlink()
    echoes, links = run(truth.path, base)
    check_sound(echoes, links)
    assert (echoes["origin"] == 1).all()
    np.testing.assert_array_equal(echoes["pulse"], truth.pulse)
    np.testing.assert_allclose(np.c_[echoes["x"], echoes["y"], echoes["z"]], truth.xyz, atol=0.00051)


def test_real_riegl_file(shared_data, base):
    """The vendor's echoes are found again: single returns of single-echo pulses, and the second echoes of others
    relative to the first, which the shift onto the anchor return says nothing about."""
    path = shared_data / "waveform" / "riegl_q680i.las"
    echoes, links = run(path, base, pulse_width=4.3, tail_share=0.05)
    check_sound(echoes, links)
    (waves,) = spans(path, base)
    returns = waves.returns
    at = np.searchsorted(canonical_key(echoes), key_of(links))
    distance = np.sqrt(sum((echoes[a][at] - returns[a]) ** 2 for a in "xyz"))
    isolated = (np.bincount(returns["pulse"])[returns["pulse"]] == 1) & (returns["number_of_returns"] == 1)
    assert isolated.sum() > 2000
    assert (distance[isolated] < 0.05).mean() >= 0.95
    later = (returns["return_number"] > 1) & (returns["number_of_returns"] > 1)
    assert np.median(distance[later]) < 0.02
    single = isolated & (echoes["number_of_echoes"][at] == 1)
    assert single.sum() > 1900
    width, vendor = echoes["width"][at][single], returns["vendor_width"][single]
    assert abs(np.median(width - vendor)) <= 0.1
    assert np.corrcoef(width, vendor)[0, 1] >= 0.85
    # the vendor's amplitude is in decibels, and the receiver bends at the top: only the order can agree
    order = spearmanr(echoes["amplitude"][at][single], returns["vendor_amplitude"][single]).statistic
    assert order > 0.95
    assert (echoes["fit_flags"][at] & 32 == 0).mean() > 0.99
