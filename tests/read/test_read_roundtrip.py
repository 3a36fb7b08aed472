"""What was written byte by byte is what is read."""

from __future__ import annotations

import json
import shutil

import laspy
import lazrs
import numpy as np
import pytest
from lasmaker import METRES_PER_NS, Descriptor, digitise, survey, to_laz, vlr, write_las
from tolerances import FLOAT32_CHAIN_RTOL, FLOAT32_RTOL, MILLIMETRE

from fwclass.read.info import describe, info
from fwclass.read.params import ReadParams
from fwclass.read.points import PointReader
from fwclass.read.source import open_source
from fwclass.read.stage import check_source, index_source, read_cloud, read_span
from fwclass.waveforms import PULSE_COLUMNS, RETURN_COLUMNS


@pytest.fixture
def params(base) -> ReadParams:
    return ReadParams(**base["read"])


@pytest.mark.parametrize("point_format", [4, 5, 9, 10])
@pytest.mark.parametrize("where", ["internal", "external"])
@pytest.mark.parametrize("bits", [8, 12, 16])
def test_samples_and_fields_of_waveform_formats(tmp_path, params, point_format, where, bits):
    truth = survey(tmp_path / "a.las", pulses=40, point_format=point_format, where=where, bits=bits)
    source = open_source(truth.path)
    assert source.faults == ()
    assert (source.point_format, source.waves.kind, source.crs.to_epsg()) == (point_format, where, 32633)
    (span,) = index_source(source, params)
    waves = read_span(source, span, params)
    assert tuple(waves.pulses) == PULSE_COLUMNS
    assert tuple(waves.returns) == RETURN_COLUMNS
    assert waves.samples.dtype == (np.uint8 if bits == 8 else np.uint16)
    np.testing.assert_array_equal(waves.samples, np.concatenate(truth.waveforms))
    np.testing.assert_array_equal(waves.offsets, np.arange(41) * 60)
    np.testing.assert_array_equal(waves.returns["pulse"], truth.pulse)
    np.testing.assert_allclose(waves.returns["location"], truth.time, atol=1e-4)
    xyz = np.c_[waves.returns["x"], waves.returns["y"], waves.returns["z"]]
    np.testing.assert_allclose(xyz, truth.xyz, atol=MILLIMETRE)
    assert waves.returns["has_packet"].all()
    assert (waves.pulses["saturation"] == 2**bits - 1).all()
    assert waves.faults == {}


def test_position_law_of_the_anchor(tmp_path, params):
    """P(t) = P_anchor + (anchor_time - t) step leads from the anchor to every other return of the pulse."""
    truth = survey(tmp_path / "a.las", pulses=60, seed=3)
    source = open_source(truth.path)
    waves = read_span(source, index_source(source, params)[0], params)
    row = waves.returns["pulse"]
    for axis in "xyz":
        behind = waves.pulses["anchor_time"][row] - waves.returns["location"]
        expected = waves.pulses[f"anchor_{axis}"][row] + behind * waves.pulses[f"step_{axis}"][row]
        np.testing.assert_allclose(waves.returns[axis], expected, atol=0.0015)
    length = np.sqrt(sum(waves.pulses[f"step_{axis}"] ** 2 for axis in "xyz"))
    np.testing.assert_allclose(length, METRES_PER_NS, rtol=FLOAT32_RTOL)


@pytest.mark.parametrize("point_format", [4, 5, 9, 10])
def test_laz_of_waveform_formats_reads_like_las(tmp_path, params, point_format):
    channel = {"channel": 1} if point_format >= 9 else {}
    truth = survey(tmp_path / "a.las", pulses=50, point_format=point_format, **channel)
    laz = to_laz(truth.path, tmp_path / "b.laz")
    shutil.copy(truth.path.with_suffix(".wdp"), laz.with_suffix(".WDP"))
    las_source, laz_source = open_source(truth.path), open_source(laz)
    assert laz_source.compressed and not las_source.compressed
    a = read_span(las_source, index_source(las_source, params)[0], params)
    b = read_span(laz_source, index_source(laz_source, params)[0], params)
    np.testing.assert_array_equal(a.samples, b.samples)
    for name in RETURN_COLUMNS:
        np.testing.assert_array_equal(a.returns[name], b.returns[name])


def test_stale_start_of_internal_waveforms_is_found_among_the_records(tmp_path, params):
    truth = survey(tmp_path / "a.las", pulses=20, where="internal")
    raw = bytearray(truth.path.read_bytes())
    raw[227:235] = (5).to_bytes(8, "little")
    truth.path.write_bytes(raw)
    source = open_source(truth.path)
    assert source.waves.kind == "internal" and any("stale" in f for f in source.faults)
    waves = read_span(source, index_source(source, params)[0], params)
    np.testing.assert_array_equal(waves.samples, np.concatenate(truth.waveforms))


def test_misspelt_user_id(tmp_path, params):
    truth = survey(tmp_path / "a.las", pulses=5, wave_user="LAS_Spec", where="internal", point_format=4)
    source = open_source(truth.path)
    assert source.faults == () and set(source.descriptors) == {1}
    assert read_span(source, index_source(source, params)[0], params).pulses.rows == 5


def test_several_descriptors_of_different_bits_and_spacing(tmp_path, params):
    descriptors = {1: Descriptor(8, 40, 1000), 7: Descriptor(16, 30, 500), 9: Descriptor(8, 0, 0)}
    rng = np.random.default_rng(0)
    waveforms = [rng.integers(0, 255, 40), rng.integers(0, 65535, 30), rng.integers(0, 255, 40)]
    path = write_las(
        tmp_path / "a.las",
        np.zeros((3, 3)),
        waveforms=[digitise(w, 16) for w in waveforms],
        descriptor_of=[1, 7, 1],
        descriptors=descriptors,
        location=[3.0, 4.0, 5.0],
    )
    source = open_source(path)
    waves = read_span(source, index_source(source, params)[0], params)
    np.testing.assert_array_equal(waves.offsets, [0, 40, 70, 110])
    np.testing.assert_array_equal(waves.samples, np.concatenate(waveforms))
    np.testing.assert_allclose(waves.pulses["sample_spacing"], [1.0, 0.5, 1.0])
    np.testing.assert_array_equal(waves.pulses["saturation"], [255, 65535, 255])


@pytest.mark.parametrize("point_format", [0, 1, 2, 3, 6, 7, 8])
@pytest.mark.parametrize("compress", [False, True])
def test_files_without_waveforms(tmp_path, params, point_format, compress):
    n = 30
    rng = np.random.default_rng(1)
    xyz = rng.uniform(0, 50, (n, 3))
    extra = {"Amplitude": ("i2", 0.01, np.arange(n) * 10), "Pulse width": ("u2", 0.1, np.arange(n))}
    path = write_las(
        tmp_path / "a.las",
        xyz,
        point_format=point_format,
        return_number=np.arange(n) % 3 + 1,
        number_of_returns=3,
        classification=np.arange(n) % 6,
        gps_time=np.arange(n) * 0.5,
        extra=extra,
    )
    path = to_laz(path, tmp_path / "a.laz") if compress else path
    source = open_source(path)
    spans = index_source(source, params.model_copy(update={"chunk_pulses": 7}))
    assert [s.n_points for s in spans] == [7, 7, 7, 7, 2]
    tables = [read_span(source, s, params) for s in spans]
    assert not any(t.pulses.rows for t in tables)
    joined = {k: np.concatenate([t.returns[k] for t in tables]) for k in RETURN_COLUMNS}
    np.testing.assert_array_equal(joined["pulse"], np.arange(n))
    np.testing.assert_allclose(np.c_[joined["x"], joined["y"], joined["z"]], xyz, atol=MILLIMETRE)
    np.testing.assert_array_equal(joined["source_class"], np.arange(n) % 6)
    np.testing.assert_allclose(joined["vendor_amplitude"], np.arange(n) * 0.1, rtol=FLOAT32_CHAIN_RTOL)
    np.testing.assert_allclose(joined["vendor_width"], np.arange(n) * 0.1, rtol=FLOAT32_CHAIN_RTOL)
    assert np.isnan(joined["location"]).all()
    timed = point_format not in (0, 2)
    np.testing.assert_array_equal(joined["gps_time"], np.arange(n) * 0.5 if timed else np.full(n, np.nan))
    cloud = read_cloud(path, 10, 20)
    np.testing.assert_array_equal(cloud["source_class"], joined["source_class"][10:20])
    np.testing.assert_array_equal(cloud["x"], joined["x"][10:20])


@pytest.mark.parametrize("point_format", [3, 7])
def test_any_run_of_points_of_a_laz(tmp_path, point_format):
    """Seeking across the compressor's chunks (50 000 points) gives the same as reading from the start."""
    n = 120_000
    xyz = np.random.default_rng(0).uniform(0, 100, (n, 3))
    laz = to_laz(write_las(tmp_path / "a.las", xyz, point_format=point_format), tmp_path / "b.laz")
    for first, last in ((0, n), (49_990, 50_010), (50_000, 50_001), (99_999, n), (n, n), (n - 5, n + 5)):
        found = read_cloud(laz, first, last)
        np.testing.assert_allclose(found["x"], xyz[first:last, 0], atol=MILLIMETRE)


def test_chunks_of_varying_size_as_in_copc(tmp_path):
    """A LAZ file with chunks of 70, 5 and 25 points: any run of points is right, whatever lazrs' seek does."""
    n, ends = 100, (70, 75, 100)
    xyz = np.random.default_rng(0).uniform(0, 100, (n, 3))
    las = write_las(tmp_path / "a.las", xyz, point_format=6)
    raw = las.read_bytes()
    start = int.from_bytes(raw[96:100], "little")
    record = lazrs.LazVlr.new_for_compression(6, 0, True)
    body = bytes(record.record_data())
    with (tmp_path / "b.laz").open("wb") as out:
        head = bytearray(raw[:start] + vlr("laszip encoded", 22204, body))
        head[96:100] = len(head).to_bytes(4, "little")
        head[100:104] = (int.from_bytes(raw[100:104], "little") + 1).to_bytes(4, "little")
        head[104] |= 0x80
        out.write(head)
        packer = lazrs.LasZipCompressor(out, record)
        for first, last in zip((0, *ends), ends, strict=False):
            packer.compress_many(raw[start + 30 * first : start + 30 * last])
            if last < n:
                packer.finish_current_chunk()
        packer.done()
    for first, last in ((0, n), (69, 76), (71, 90), (75, 76), (99, n)):
        found = read_cloud(tmp_path / "b.laz", first, last)
        np.testing.assert_allclose(found["x"], xyz[first:last, 0], atol=MILLIMETRE)


def test_any_reader_agrees(tmp_path, params):
    """laspy, reading all at once, has the same packet fields and coordinates."""
    truth = survey(tmp_path / "a.las", pulses=30, point_format=10)
    las = laspy.read(truth.path)
    source = open_source(truth.path)
    waves = read_span(source, index_source(source, params)[0], params)
    np.testing.assert_allclose(waves.returns["x"], np.asarray(las.x))
    np.testing.assert_array_equal(waves.returns["intensity"], las.intensity)
    np.testing.assert_allclose(waves.returns["location"], las["return_point_wave_location"] * 1e-3, rtol=FLOAT32_RTOL)


def test_info_is_plain_data_and_counts_right(tmp_path):
    truth = survey(tmp_path / "a.las", pulses=80, seed=2)
    found = info(truth.path)
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert found["faults"] == []
    assert found["points"] == sum(found["returns"].values()) == len(truth.pulse)
    assert found["classes"]["2"] == 80
    assert found["waveforms"]["usable"] == len(truth.pulse)
    assert found["crs"]["epsg"] == 32633
    np.testing.assert_allclose(found["bounds"], [*truth.xyz.min(0), *truth.xyz.max(0)], atol=0.001)
    text = describe(found)
    assert "point format 9" in text and "no faults found" in text


def test_real_riegl_file(shared_data, params):
    path = shared_data / "waveform" / "riegl_q680i.las"
    source = open_source(path)
    check_source(source, params)
    (span,) = index_source(source, params)
    waves = read_span(source, span, params)
    assert (waves.returns.rows, waves.pulses.rows, span.n_pulses) == (2535, 2375, 2370)
    assert set(np.diff(waves.offsets)) == {60, 120}
    assert waves.samples.dtype == np.uint16 and waves.faults == {}
    assert np.nanmin(waves.returns["vendor_width"]) > 2
    # the vendor's returns of one pulse lie on one line: the packet geometry holds
    row = np.searchsorted(waves.pulses["pulse"], waves.returns["pulse"])
    behind = waves.pulses["anchor_time"].astype(float)[row] - waves.returns["location"]
    off = [waves.pulses[f"anchor_{a}"][row] + behind * waves.pulses[f"step_{a}"][row] - waves.returns[a] for a in "xyz"]
    assert np.abs(off).max() < 0.003
    found = info(path)
    assert any("z outliers" in f for f in found["faults"]) and found["waveforms"]["empty_descriptors"] == 98


def test_a_declared_no_data_value_is_no_value(tmp_path):
    """-32768 of a scaled extra byte that says so; another extra byte with the same number keeps it."""
    header = laspy.LasHeader(version="1.4", point_format=6)
    for name, no_data in (("Amplitude", [-32768]), ("Deviation", None)):
        header.add_extra_dim(
            laspy.ExtraBytesParams(name, "i2", scales=np.array([0.01]), offsets=np.array([0.0]), no_data=no_data)
        )
    las = laspy.LasData(header)
    las.x = las.y = las.z = np.arange(3.0)
    for name in ("Amplitude", "Deviation"):
        las[name] = np.array([12.34, -327.68, -1.5])
    las.write(tmp_path / "a.laz")
    with PointReader(open_source(tmp_path / "a.laz")) as reader:
        points = reader.read(0, 3)
        np.testing.assert_allclose(reader.extra_byte(points, "amplitude"), [12.34, np.nan, -1.5], rtol=FLOAT32_RTOL)
        np.testing.assert_allclose(
            reader.extra_byte(points, "nothing", "Deviation"), [12.34, -327.68, -1.5], rtol=FLOAT32_RTOL
        )
        assert np.isnan(reader.extra_byte(points, "Reflectance")).all()
