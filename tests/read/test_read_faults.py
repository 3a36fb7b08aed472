"""Bad input: flagged and counted where a datum is bad, an `InputError` where the file is."""

from __future__ import annotations

import io
import re
import struct

import lazrs
import numpy as np
import pytest
import rasterio
from lasmaker import METRES_PER_NS, Descriptor, survey, to_laz, write_las
from pyproj import CRS, Transformer
from tolerances import FLOAT32_RTOL

from fwclass.errors import InputError
from fwclass.formats.crs import units_of
from fwclass.formats.linear_units import linear_units
from fwclass.read.info import describe, info
from fwclass.read.packets import LONGER, PADDED
from fwclass.read.params import ReadParams
from fwclass.read.source import open_source
from fwclass.read.stage import check_source, index_source, read_cloud, read_span
from fwclass.survey.systems import given_crs

N = 6


@pytest.fixture
def params(base) -> ReadParams:
    return ReadParams(**base["read"])


def six(path, **options):
    """Six pulses of one return each."""
    options.setdefault("waveforms", [np.arange(60)] * N)
    options.setdefault("location", 10.0)
    return write_las(path, np.arange(3 * N).reshape(N, 3), **options)


def read(path, params):
    source = open_source(path)
    (span,) = index_source(source, params)
    return read_span(source, span, params)


@pytest.mark.parametrize(
    ("name", "field", "value"),
    [
        ("no packet", "index", 0),
        ("unknown descriptor", "index", 5),
        ("packet size too small", "size", 59),
        ("packet past the end", "offset", 10**12),
        ("packet past the end", "offset", 2**64 - 1),
        ("packet cut short", "offset", 60 + N * 60 - 10),
        ("packet inside the record's header", "offset", 0),
        ("no sane return location or beam vector", "location", np.nan),
        ("no sane return location or beam vector", "location", 1e9),
        ("no sane return location or beam vector", "step", (0, 0, 0)),
        ("no sane return location or beam vector", "step", (np.nan, 0, 1.5e-4)),
        ("no sane return location or beam vector", "step", (0, 0, 0.15)),
    ],
)
def test_a_bad_reference_is_counted_and_its_return_kept(tmp_path, params, name, field, value):
    path = six(tmp_path / "a.las")
    raw = bytearray(path.read_bytes())
    start = int.from_bytes(raw[96:100], "little") + 2 * 59 + 30
    place = {"index": (0, "B"), "offset": (1, "Q"), "size": (9, "I"), "location": (13, "f"), "step": (17, "3f")}
    at, form = place[field]
    values = value if isinstance(value, tuple) else (value,)
    struct.pack_into("<" + form, raw, start + at, *values)
    path.write_bytes(raw)
    waves = read(path, params)
    assert waves.faults == {name: 1}
    assert waves.returns.rows == N
    assert waves.returns["has_packet"].tolist() == [True, True, False, True, True, True]
    assert np.isfinite(waves.returns["location"]).all()
    assert waves.pulses["pulse"].tolist() == [0, 1, 3, 4, 5]
    assert waves.samples.tolist() == list(range(60)) * 5
    found = info(path)
    assert any(f == f"1 of {N} returns: {name}" for f in found["faults"]), found["faults"]


@pytest.mark.parametrize(
    ("descriptor", "advice"),
    [
        (Descriptor(bits=32), "name 60 of 32 bits: export it with samples of 8 or 16 bits, or as a table"),
        (Descriptor(n_samples=0), "no waveform descriptor names samples: export it"),
        (Descriptor(n_samples=61), "name 61 of 8 bits, more than packets hold: export it again"),
    ],
)
def test_a_bad_descriptor_is_named(tmp_path, params, descriptor, advice):
    """It was said that file and waveforms do not fit each other, and to ask for both again."""
    path = six(tmp_path / "a.las", descriptors={1: descriptor})
    with pytest.raises(InputError, match=advice):
        check_source(open_source(path), params)


@pytest.mark.parametrize("more", [8, 9])
def test_packets_that_hold_more_than_their_descriptor_names_are_told(tmp_path, params, more):
    path = six(tmp_path / "a.las", waveforms=[np.arange(60 + more)] * N)
    waves, words = read(path, params), f"{N} of {N} returns: {LONGER}"
    assert waves.faults == ({LONGER: N} if more > PADDED else {}) and len(waves.samples) == 60 * N
    assert (words in info(path)["faults"]) == (more > PADDED)


@pytest.mark.parametrize(
    ("name", "descriptor"),
    [
        ("unknown compression of packets", Descriptor(compression=2)),
        ("unsupported samples", Descriptor(bits=32)),
        ("unsupported samples", Descriptor(bits=0)),
        ("unsupported samples", Descriptor(n_samples=0)),
        ("invalid sample spacing", Descriptor(spacing_ps=0)),
        ("packet size too small", Descriptor(n_samples=2**32 - 1)),
    ],
)
def test_a_bad_descriptor(tmp_path, params, name, descriptor):
    path = six(tmp_path / "a.las", descriptors={1: descriptor})
    waves = read(path, params)
    assert waves.faults == {name: N} and waves.returns.rows == N and waves.pulses.rows == 0
    with pytest.raises(InputError, match=name):
        check_source(open_source(path), params)


def test_the_anchor_is_the_first_sane_return(tmp_path, params):
    """Numbered 2, 1, 3 in the file; return 1 has no sane location, so return 2 is the anchor."""
    path = write_las(
        tmp_path / "a.las",
        [(0, 0, 2), (0, 0, 1), (0, 0, 3)],
        return_number=[2, 1, 3],
        number_of_returns=3,
        waveforms=[np.arange(60)],
        pulse=[0, 0, 0],
        location=[20.0, 1e8, 30.0],
    )
    waves = read(path, params)
    assert waves.pulses["anchor_z"].tolist() == [2.0]
    assert waves.pulses["anchor_time"].tolist() == [20.0]
    assert waves.returns["has_packet"].all() and waves.faults == {}


def test_descriptors_that_make_packets_overlap_are_refused(tmp_path, params):
    n = 300
    path = write_las(
        tmp_path / "a.las",
        np.zeros((n, 3)),
        waveforms=[np.arange(60)] * n,
        location=10.0,
        descriptors={1: Descriptor(n_samples=6000)},
        wave={"size": 2**31},
    )
    with pytest.raises(InputError, match="overlap"):
        read(path, params)


def test_missing_wdp(tmp_path, params):
    truth = survey(tmp_path / "a.las", pulses=10)
    truth.path.with_suffix(".wdp").unlink()
    source = open_source(truth.path)
    assert source.waves.kind == "none" and any("put a.wdp beside a.las" in f for f in source.faults)
    with pytest.raises(InputError, match=r"put a\.wdp beside it"):
        check_source(source, params)
    check_source(source, params.model_copy(update={"missing_packets": "keep"}))
    waves = read(truth.path, params)
    assert waves.pulses.rows == 0 and waves.returns.rows == len(truth.pulse)
    assert waves.faults == {"waveforms missing": len(truth.pulse)}
    np.testing.assert_array_equal(waves.returns["pulse"], truth.pulse)


def test_one_usable_packet_is_enough(tmp_path, params):
    path = six(tmp_path / "a.las", wave={"index": [0, 0, 0, 0, 0, 1]})
    check_source(open_source(path), params)


@pytest.mark.parametrize(
    ("name", "change", "text"),
    [
        ("a.las", lambda b: b"", "empty"),
        ("a.las", lambda b: b"PK\3\4" + b[4:], "no LAS"),
        ("a.las", lambda b: b[:100], "ends inside its header"),
        ("a.las", lambda b: b[:-30], "cut short"),
        ("a.las", lambda b: b[:104] + b"\x0b" + b[105:], "unknown point format"),
        ("a.las", lambda b: b[:105] + b"\x05\0" + b[107:], "too short"),
        ("a.las", lambda b: b[:24] + b"\x02\x05" + b[26:], "unknown LAS version"),
        ("a.las", lambda b: b[:96] + b"\xff\xff\xff\xff" + b[100:], "do not fit"),
        ("a.las", lambda b: b[:131] + struct.pack("<d", np.nan) + b[139:], "scales"),
        ("a.las", lambda b: b[:131] + struct.pack("<d", 0.0) + b[139:], "scales"),
        ("a.wdp", lambda b: b, "not points"),
    ],
)
def test_a_useless_file_is_an_input_error(tmp_path, name, change, text):
    path = six(tmp_path / "a.las")
    raw = change(path.read_bytes())
    target = tmp_path / name
    target.write_bytes(raw)
    with pytest.raises(InputError, match=text) as caught:
        open_source(target)
    assert str(target) in str(caught.value) and "what to do" in str(caught.value)


def test_no_such_file(tmp_path):
    with pytest.raises(InputError, match="cannot open"):
        open_source(tmp_path / "none.las")
    with pytest.raises(InputError, match=r"cannot open|no LAS"):
        open_source(tmp_path)


@pytest.mark.parametrize("point_format", [3, 9])
@pytest.mark.parametrize("keep", [0.3, 0.6, 0.95])
def test_a_cut_laz_is_an_input_error(tmp_path, params, point_format, keep):
    n = 3000
    path = write_las(
        tmp_path / "a.las",
        np.random.default_rng(0).uniform(0, 99, (n, 3)),
        point_format=point_format,
        waveforms=[np.arange(60)] * n,
        location=10.0,
    )
    laz = to_laz(path, tmp_path / "a.laz")
    raw = laz.read_bytes()
    start = int.from_bytes(raw[96:100], "little")
    laz.write_bytes(raw[: start + int(keep * (len(raw) - start))])
    with pytest.raises(InputError):
        read_cloud(laz)


def test_header_promises_more_points_than_a_laz_holds(tmp_path):
    path = to_laz(write_las(tmp_path / "a.las", np.zeros((50, 3)), point_format=1), tmp_path / "a.laz")
    raw = bytearray(path.read_bytes())
    struct.pack_into("<I", raw, 107, 4_000_000_000)
    path.write_bytes(raw)
    with pytest.raises(InputError):
        info(path)


def test_crs_faults(tmp_path):
    assert any("no usable CRS" in f for f in open_source(six(tmp_path / "a.las", keys=None)).faults)
    degrees = open_source(six(tmp_path / "b.las", keys={2048: 4326}))
    assert any("degrees" in f for f in degrees.faults) and degrees.crs.is_geographic
    unknown = open_source(six(tmp_path / "c.las", keys={3072: 31}))
    assert unknown.crs is None and any("EPSG:31" in f for f in unknown.faults)
    junk = open_source(six(tmp_path / "d.las", keys=None, wkt="PROJCS[nonsense"))
    assert junk.crs is None and any("no valid WKT" in f for f in junk.faults)
    by_wkt = open_source(six(tmp_path / "e.las", keys=None, wkt=degrees.crs.to_wkt("WKT1_GDAL")))
    assert by_wkt.crs.is_geographic


def test_angles_of_a_projection_in_metres_are_degrees(tmp_path):
    """A RIEGL's central meridian of 15 "Meter" was taken for 15 radians."""
    stated = CRS.from_epsg(32633).to_wkt("WKT2_2019")
    begin = stated.index("CONVERSION")
    end = stated.index("CS[")
    angles = re.sub(r'ANGLEUNIT\["degree",[0-9.]+[^\]]*\]', 'ANGLEUNIT["Meter",1]', stated[begin:end])
    assert angles.count('ANGLEUNIT["Meter",1]') == 2
    source = open_source(six(tmp_path / "a.las", keys=None, wkt=stated[:begin] + angles + stated[end:]))
    assert any("angles in metres" in f for f in source.faults)
    lon, lat = Transformer.from_crs(source.crs, "EPSG:4326", always_xy=True).transform(500_000.0, 5_400_000.0)
    assert abs(lon - 15.0) < 1e-9 and 48.7 < lat < 48.8


@pytest.mark.parametrize("code", [0, 999_999])
def test_a_system_with_a_code_that_epsg_does_not_have_goes_by_its_other_words(tmp_path, code):
    """GDAL wrote rasters of such a one, which RIEGL's files name, into no system at all."""
    stated = CRS.from_epsg(32633).to_wkt("WKT1_GDAL")
    named = stated.replace('AUTHORITY["EPSG","32633"]', f'AUTHORITY["EPSG","{code}"]')
    source = open_source(six(tmp_path / "a.las", keys=None, wkt=named))
    assert source.crs.to_epsg(min_confidence=25) == 32633 and any(f"(EPSG:{code})" in f for f in source.faults)
    assert rasterio.crs.CRS.from_wkt(source.crs.to_wkt()).to_epsg() == 32633
    assert given_crs(named, "survey.crs").equals(source.crs)
    sound = open_source(six(tmp_path / "b.las", keys=None, wkt=stated))
    assert sound.crs.to_epsg() == 32633 and not any("EPSG" in f for f in sound.faults)


@pytest.mark.parametrize("vertical", [None, 5703])
def test_heights_are_in_the_feet_that_the_key_of_their_unit_names(tmp_path, vertical):
    """As US surveys have it: NAVD88 by the code of its metres, or by none, and the unit in a key of its own."""
    named = {4096: vertical} if vertical else {}
    source = open_source(six(tmp_path / "a.las", keys={3072: 26918, **named, 4099: 9003}))
    assert linear_units(source.crs, source.header, "") == linear_units(source.crs, None, "")
    assert [a.unit_name for a in source.crs.axis_info] == ["metre", "metre", "US survey foot"]
    assert source.crs.sub_crs_list[0].to_epsg() == 26918 and any("in US survey foot" in f for f in source.faults)
    metres = open_source(six(tmp_path / "b.las", keys={3072: 26918, **named, 4099: 9001}))
    assert units_of(metres.crs) == [] and not any("foot" in f for f in metres.faults)
    feet = open_source(six(tmp_path / "c.las", keys={3072: 2263, 4099: 9003}))
    assert feet.crs.to_epsg() == 2263 and any("in US survey foot" in f for f in feet.faults)


def test_info_tells_faults_of_the_points(tmp_path):
    xyz = np.random.default_rng(0).uniform(0, 20, (500, 3))
    xyz[7, 2] = 2000.0
    path = write_las(
        tmp_path / "a.las",
        xyz,
        point_format=1,
        intensity=0,
        return_number=np.r_[0, 2, [1] * 498],
        number_of_returns=np.r_[1, 2, [1] * 498],
    )
    raw = bytearray(path.read_bytes())
    struct.pack_into("<d", raw, 179, 5.0)
    path.write_bytes(raw)
    text = "\n".join(info(path)["faults"])
    for expected in (
        "1 z outliers",
        "all intensities are zero",
        "1 points have return number 0",
        "at least 1 returns",
        "header's bounds disagree",
    ):
        assert expected in text


def test_counts_of_thousands_are_read_at_a_glance(tmp_path):
    n = 2_000
    waves = [np.arange(80)] * n
    path = write_las(tmp_path / "a.las", np.zeros((n, 3)), waveforms=waves, intensity=np.arange(n) % 2, location=10.0)
    faults = info(path)["faults"]
    assert "1,000 of 2,000 intensities are zero" in faults
    assert f"2,000 of 2,000 returns: {LONGER}" in faults


@pytest.mark.parametrize(("values", "told"), [(255, True), (np.arange(500) % 2 + 254, False)])
def test_info_tells_intensities_that_nobody_measured(tmp_path, values, told):
    xyz = np.random.default_rng(0).uniform(0, 20, (500, 3))
    path = write_las(tmp_path / "a.las", xyz, point_format=1, intensity=values)
    assert ("all 500 intensities are 255" in "\n".join(info(path)["faults"])) is told


def test_empty_file_of_points(tmp_path):
    path = write_las(tmp_path / "a.las", np.empty((0, 3)), point_format=9)
    found = info(path)
    assert found["points"] == 0 and "no points" in describe(found)
    assert read_cloud(path).rows == 0


def test_truncated_leica_file(shared_data, params):
    path = shared_data / "waveform" / "leica_truncated_internal.las"
    source = open_source(path)
    with pytest.raises(InputError, match="999 returns: packet past the end"):
        check_source(source, params)
    waves = read(path, params)
    assert waves.returns.rows == 999 and waves.faults == {"packet past the end": 999}
    assert "NO WAVEFORM CAN BE READ" in describe(info(path))


def test_yellowscan_without_wdp(shared_data, params):
    path = shared_data / "waveform" / "yellowscan_missing_wdp.laz"
    source = open_source(path)
    with pytest.raises(InputError, match=r"yellowscan_missing_wdp\.wdp"):
        check_source(source, params)
    waves = read(path, params)
    assert waves.returns.rows == 10750 and waves.faults == {"waveforms missing": 10750}
    assert source.crs.to_epsg() == 32723


def test_step_is_metres_per_nanosecond(tmp_path, params):
    waves = read(six(tmp_path / "a.las"), params)
    np.testing.assert_allclose(waves.pulses["step_z"], METRES_PER_NS, rtol=FLOAT32_RTOL)


@pytest.mark.parametrize("waves", [True, False])
def test_points_behind_those_that_the_header_counts_are_refused_and_other_bytes_are_not(tmp_path, waves):
    xyz, waveforms = np.arange(300).reshape(100, 3), [np.arange(60)] * 100 if waves else ()
    path = write_las(tmp_path / "a.las", xyz, point_format=4 if waves else 1, waveforms=waveforms, where="internal")
    raw = bytearray(path.read_bytes())
    open_source(path)
    for behind in (bytes(3000), bytes(range(256)) * 12, b"x"):
        path.write_bytes(raw + behind)
        open_source(path)
    for count in (80, 0):
        struct.pack_into("<I", raw, 107, count)
        path.write_bytes(raw)
        with pytest.raises(InputError, match="fewer points than the file holds") as error:
            open_source(path)
        assert f"room for {100 - count} more" in str(error.value)


@pytest.mark.parametrize("fewer", [3, 300, 700])
@pytest.mark.parametrize("point_format", [1, 6])
def test_compressed_points_behind_those_that_the_header_counts_are_refused(tmp_path, point_format, fewer):
    xyz = np.random.default_rng(0).integers(0, 100_000, (700, 3))
    las = write_las(tmp_path / "a.las", xyz, point_format=point_format)
    raw = bytearray(to_laz(las, tmp_path / "a.laz").read_bytes())
    open_source(tmp_path / "a.laz")
    struct.pack_into("<Q", raw, 247, 700 - fewer) if point_format == 6 else struct.pack_into(
        "<I", raw, 107, 700 - fewer
    )
    (tmp_path / "b.laz").write_bytes(raw)
    with pytest.raises(InputError, match="fewer points than the file holds"):
        open_source(tmp_path / "b.laz")


@pytest.mark.statistics
def test_a_large_last_chunk_is_asked_for_points_behind_those_that_are_counted(tmp_path):
    points = 620_000  # more than 16 MiB
    xyz = np.random.default_rng(0).integers(0, 100, (points, 3))
    las = write_las(tmp_path / "a.las", xyz, point_format=1, scale=1.0)
    head = bytearray(to_laz(las, tmp_path / "a.laz").read_bytes())
    start = struct.unpack_from("<I", head, 96)[0]
    record = head.index(b"laszip encoded") + 52
    struct.pack_into("<I", head, record + 12, 1_000_000)
    packed = io.BytesIO()
    packer = lazrs.LasZipCompressor(packed, lazrs.LazVlr(bytes(head[record:start])))
    plain = las.read_bytes()
    packer.compress_many(plain[struct.unpack_from("<I", plain, 96)[0] :])
    packer.done()
    body = bytearray(packed.getvalue())
    struct.pack_into("<q", body, 0, struct.unpack_from("<q", body)[0] + start)
    (tmp_path / "a.laz").write_bytes(head[:start] + body)
    assert open_source(tmp_path / "a.laz").header.n_points == points
    struct.pack_into("<I", head, 107, points - 1000)
    (tmp_path / "b.laz").write_bytes(head[:start] + body)
    with pytest.raises(InputError, match="fewer points than the file holds"):
        open_source(tmp_path / "b.laz")
