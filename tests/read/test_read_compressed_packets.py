"""Packets that LASzip compressed: what an independent encoder wrote is read, and what is damaged is told."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lasmaker import Descriptor, survey, to_laz, write_las
from wdzmaker import packed

from fwclass.errors import InputError
from fwclass.publish.strips import write_strip_laz
from fwclass.read.compressed_packets import decompress
from fwclass.read.info import info
from fwclass.read.packet_references import References
from fwclass.read.params import ReadParams
from fwclass.read.points import PointReader
from fwclass.read.source import open_source
from fwclass.read.stage import check_source, index_source, read_span

DAMAGED = "compressed packet damaged, or another file's"
HEADER = 60


@pytest.fixture
def params(base) -> ReadParams:
    return ReadParams(**base["read"])


def read(path, params):
    source = open_source(path)
    (span,) = index_source(source, params)
    return read_span(source, span, params)


def strip(path, bits=8, pulses=40, compression=1, **options):
    return survey(path, pulses=pulses, bits=bits, descriptors={1: Descriptor(bits, 60, 1000, compression)}, **options)


@pytest.mark.parametrize("where", ["internal", "external"])
@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("point_format", [4, 9])
def test_the_samples_are_those_that_were_written(tmp_path, params, where, bits, point_format):
    truth = strip(tmp_path / "a.las", bits, where=where, point_format=point_format)
    plain = strip(tmp_path / "b.las", bits, where=where, point_format=point_format, compression=0)
    check_source(open_source(truth.path), params)
    waves, same = read(truth.path, params), read(plain.path, params)
    assert waves.faults == {} and waves.samples.dtype == same.samples.dtype
    np.testing.assert_array_equal(waves.samples, np.concatenate(truth.waveforms))
    np.testing.assert_array_equal(waves.offsets, same.offsets)
    for name in waves.pulses:
        np.testing.assert_array_equal(waves.pulses[name], same.pulses[name])
    found = info(truth.path)
    assert found["faults"] == [] and found["waveforms"]["usable"] == len(waves.returns["x"])


def test_compressed_and_plain_packets_in_one_file(tmp_path, params):
    rng = np.random.default_rng(5)
    wide, narrow = rng.integers(0, 2**16, (3, 50)), rng.integers(0, 2**8, (3, 40))
    path = write_las(
        tmp_path / "a.las",
        np.arange(18).reshape(6, 3),
        waveforms=[*wide, *narrow],
        descriptor_of=[1, 1, 1, 2, 2, 2],
        descriptors={1: Descriptor(16, 50, compression=1), 2: Descriptor(8, 40)},
        location=10.0,
    )
    np.testing.assert_array_equal(read(path, params).samples, np.concatenate([wide.ravel(), narrow.ravel()]))


KINDS = {
    "level": lambda rng, n, top: np.full(n, 7),
    "any": lambda rng, n, top: rng.integers(0, top, n),
    "quiet": lambda rng, n, top: np.rint(rng.normal(100.0, 2.0, n)).astype(int),
    "spikes": lambda rng, n, top: np.where(rng.random(n) < 0.02, top - 1, 0),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize("n", [1, 2, 256, 5000])
def test_waveforms_of_every_kind(kind, wide, n):
    bits = 16 if wide else 8
    values = KINDS[kind](np.random.default_rng(n), n, 1 << bits)
    found, sound = unpacked(packed(values, bits), wide, n)
    assert sound
    np.testing.assert_array_equal(found, values)


def unpacked(packet: bytes, wide: bool, n: int):
    """Samples of one packet that lies between other bytes, and whether it is sound."""
    data = np.frombuffer(b"\xff" * 3 + packet + b"\xff" * 9, np.uint8)
    one = (np.array([3]), np.array([len(packet)]), np.array([wide]), np.array([True]), np.array([n]))
    found, _, sound = decompress(data, *one)
    return found, bool(sound[0])


@settings(deadline=None, max_examples=300)
@given(packet=st.binary(min_size=6, max_size=300), wide=st.booleans(), n=st.integers(1, 400))
def test_any_bytes_are_decoded_inside_of_their_arrays(packet, wide, n):
    found, _ = unpacked(packet, wide, n)
    assert len(found) == n and found.max(initial=0) < (1 << 16 if wide else 1 << 8)


NOISE = packed(np.rint(np.random.default_rng(1).normal(100.0, 4.0, 256)).astype(int), 8)


@settings(deadline=None, max_examples=200)
@given(at=st.integers(1, 200), value=st.integers(1, 255), cut=st.integers(0, 4))
def test_a_changed_byte_gives_other_samples_or_no_packet(at, value, cut):
    """What reads past its packet, or not to its end, is none; a change that keeps the length cannot be seen."""
    packet = bytearray(NOISE)
    packet[at % (len(packet) - 3)] ^= value
    _, sound = unpacked(bytes(packet[: len(packet) - cut]), False, 256)
    assert not (sound and cut and unpacked(bytes(packet), False, 256)[1])


def test_another_files_packets_are_told(tmp_path, params):
    """The .wdz of another flight has its packets elsewhere: not one ends where the points say."""
    truth, other = strip(tmp_path / "a.las"), strip(tmp_path / "b.las", seed=9, noise=3.0)
    other.path.with_suffix(".wdz").rename(truth.path.with_suffix(".wdz"))
    with pytest.raises(InputError, match="do not fit each other"):
        check_source(open_source(truth.path), params)
    assert any(DAMAGED in fault for fault in info(truth.path)["faults"])
    waves = read(truth.path, params)
    assert waves.faults[DAMAGED] > 0.8 * waves.returns.rows


def test_a_damaged_packet_costs_its_own_returns_only(tmp_path, params):
    truth = strip(tmp_path / "a.las")
    source = open_source(truth.path)
    with PointReader(source) as reader:
        refs = References.of(reader.read(0, source.n_points))
    beside = truth.path.with_suffix(".wdz")
    raw, lost = bytearray(beside.read_bytes()), int(refs.offset[truth.pulse == 7][0])
    raw[lost + 2 : lost + 12] = bytes(255 - b for b in raw[lost + 2 : lost + 12])
    beside.write_bytes(raw)
    waves, mine = read(truth.path, params), truth.pulse == 7
    assert waves.faults == {DAMAGED: int(mine.sum())}
    np.testing.assert_array_equal(waves.returns["has_packet"], ~mine)
    np.testing.assert_array_equal(waves.samples, np.concatenate([w for k, w in enumerate(truth.waveforms) if k != 7]))


def test_a_file_cut_short(tmp_path, params):
    truth = strip(tmp_path / "a.las")
    beside = truth.path.with_suffix(".wdz")
    beside.write_bytes(beside.read_bytes()[: HEADER + 700])
    waves = read(truth.path, params)
    assert set(waves.faults) <= {"packet past the end", "packet cut short"} and waves.pulses.rows > 5


def test_without_its_packets_the_name_that_is_missing_is_told(tmp_path, params):
    truth = strip(tmp_path / "a.las")
    truth.path.with_suffix(".wdz").rename(tmp_path / "moved.wdz")
    assert "put a.wdz beside a.las" in open_source(truth.path).waves.why_not
    with pytest.raises(InputError, match=r"put a\.wdz beside it"):
        check_source(open_source(truth.path), params)
    with pytest.raises(InputError, match="waveforms, not points"):
        open_source(tmp_path / "moved.wdz")


def test_a_wdz_beside_points_of_plain_packets_is_told(tmp_path):
    truth = strip(tmp_path / "a.las", compression=0)
    truth.path.with_suffix(".wdp").rename(tmp_path / "a.wdz")
    assert "a.wdz is there, but its descriptors" in open_source(truth.path).waves.why_not


def test_sizes_are_looked_at_before_memory_is_taken(tmp_path, params):
    truth = strip(tmp_path / "a.las")
    raw = bytearray(truth.path.read_bytes())
    at = raw.index(Descriptor(8, 60, 1000, 1).pack()) + 2
    raw[at : at + 4] = (2**32 - 1).to_bytes(4, "little")
    truth.path.write_bytes(raw)
    assert read(truth.path, params).faults == {"packet size too small": open_source(truth.path).n_points}
    raw[at : at + 4] = (30_000).to_bytes(4, "little")
    truth.path.write_bytes(raw)
    assert DAMAGED in read(truth.path, params).faults


def test_a_delivered_strip_takes_its_packets_along(tmp_path, base):
    from fwclass.publish.params import PublishParams

    truth = strip(tmp_path / "a.las", point_format=4)
    laz = to_laz(truth.path, tmp_path / "c.laz")
    beside = truth.path.with_suffix(".wdz").read_bytes()
    laz.with_suffix(".wdz").write_bytes(beside)
    classes = np.full(len(truth.pulse), 2, np.uint8)
    said = write_strip_laz(laz, tmp_path / "o.laz", classes, None, PublishParams(**base["publish"]))
    assert said["wdp"] == str(tmp_path / "o.wdz") and (tmp_path / "o.wdz").read_bytes() == beside
    assert open_source(tmp_path / "o.laz").waves.kind == "external"


relaxed = settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> list[tuple[str, bytes]]:
    """A strip's files, as (name, bytes): points, then packets."""
    path = strip(tmp_path_factory.mktemp("sound") / "a.las", pulses=15).path
    return [(one.name, one.read_bytes()) for one in (path, path.with_suffix(".wdz"))]


@pytest.mark.statistics
@relaxed
@given(changes=st.lists(st.tuples(st.integers(0, 1 << 20), st.integers(0, 255)), min_size=1, max_size=6))
def test_damaged_points_and_packets(tmp_path, params, sound, changes):
    """Damage anywhere ends in waveforms or in words."""
    for name, data in sound:
        raw = bytearray(data)
        for at, value in changes:
            raw[at % len(raw)] = value
        (tmp_path / name).write_bytes(raw)
    path = tmp_path / sound[0][0]
    try:
        info(path)
        for span in index_source(open_source(path), params):
            read_span(open_source(path), span, params)
    except InputError as error:
        assert "where" in str(error)


def test_real_packets(shared_data, params):
    """Every packet of a Leica file, written anew by the encoder of the tests, is the same byte for byte."""
    path = shared_data / "waveform" / "leica_2ns.laz"
    if not path.exists():
        pytest.skip("no leica_2ns.laz")
    waves, stored = read(path, params), path.with_suffix(".wdz").read_bytes()
    source = open_source(path)
    with PointReader(source) as reader:
        refs = References.of(reader.read(0, source.n_points))
    first = np.unique(waves.returns["pulse"], return_index=True)[1]
    assert waves.pulses.rows == 1778 and waves.faults == {}
    for k in range(0, 1778, 7):
        at, size = int(refs.offset[first[k]]), int(refs.size[first[k]])
        assert packed(waves.samples[waves.offsets[k] : waves.offsets[k + 1]], 8) == stored[at : at + size]
