"""Descriptors: several kinds in one file, those of other sensors, and damaged ones."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from lasmaker import Descriptor, digitise, gaussian, write_las

from fwclass.errors import InputError
from fwclass.read.info import info
from fwclass.read.params import ReadParams
from fwclass.read.source import open_source
from fwclass.read.stage import check_source, index_source, read_span

GAIN, OFFSET = 10, 18
"""Bytes of a descriptor's gain and offset."""


@pytest.fixture
def params(base) -> ReadParams:
    return ReadParams(**base["read"])


def read(path, params):
    source = open_source(path)
    (span,) = index_source(source, params)
    return read_span(source, span, params)


def patched(path, index, at, form, value):
    """Overwrite a field of descriptor `index`."""
    raw = bytearray(path.read_bytes())
    place = raw.index(b"LASF_Spec\0\0\0\0\0\0\0" + struct.pack("<H", 99 + index)) - 2 + 54
    struct.pack_into(form, raw, place + at, value)
    path.write_bytes(raw)
    return path


@pytest.mark.parametrize("where", ["internal", "external"])
@pytest.mark.parametrize("point_format", [4, 9])
def test_several_descriptors_in_one_file(tmp_path, params, where, point_format):
    """Lengths, spacings and widths of samples differ from pulse to pulse."""
    kinds = {
        1: Descriptor(8, 60, 1000),
        2: Descriptor(8, 256, 2000),
        5: Descriptor(12, 30, 500),
        7: Descriptor(16, 1, 1000),
        9: Descriptor(n_samples=0),
    }
    rng = np.random.default_rng(3)
    owner = rng.permutation(np.repeat([1, 2, 5, 7], 12))
    waveforms = [rng.integers(0, 2 ** kinds[k].bits, kinds[k].n_samples) for k in owner]
    path = write_las(
        tmp_path / "a.las",
        rng.uniform(0, 50, (48, 3)),
        waveforms=waveforms,
        descriptor_of=owner.tolist(),
        descriptors=kinds,
        location=1.0,
        where=where,
        point_format=point_format,
    )
    waves = read(path, params)
    assert waves.faults == {} and waves.samples.dtype == np.uint16
    np.testing.assert_array_equal(waves.samples, np.concatenate(waveforms))
    assert np.diff(waves.offsets).tolist() == [kinds[k].n_samples for k in owner]
    np.testing.assert_allclose(waves.pulses["sample_spacing"], [kinds[k].spacing_ps * 1e-3 for k in owner])
    assert waves.pulses["saturation"].tolist() == [2.0 ** kinds[k].bits - 1 for k in owner]


@pytest.mark.parametrize("point_format", [4, 9])
def test_256_samples_of_8_bits_every_2_ns_inside_the_file(tmp_path, params, point_format):
    """As other sensors deliver them; the pulse's returns lie where the samples say."""
    n, rng = 40, np.random.default_rng(4)
    peaks = rng.uniform(60, 440, n)
    waveforms = [digitise(gaussian(256, [(150.0, t, 8.0)], 12.0, 2.0) + rng.normal(0, 1, 256)) for t in peaks]
    path = write_las(
        tmp_path / "a.las",
        rng.uniform(0, 50, (n, 3)),
        waveforms=waveforms,
        location=peaks,
        where="internal",
        descriptors={1: Descriptor(8, 256, 2000)},
        point_format=point_format,
        gps_time=1000 + 1e-5 * np.arange(n),
    )
    source = open_source(path)
    check_source(source, params)
    waves = read(path, params)
    assert source.waves.kind == "internal" and waves.faults == {}
    block = waves.samples.reshape(n, 256).astype(float)
    weight = np.where(block > 18, block - 12, 0)
    found = (weight * 2.0 * np.arange(256)).sum(axis=1) / weight.sum(axis=1)
    np.testing.assert_allclose(found, waves.pulses["anchor_time"], atol=0.2)


@pytest.mark.parametrize(
    ("at", "value"), [(GAIN, np.nan), (GAIN, np.inf), (GAIN, 0.0), (OFFSET, np.nan), (OFFSET, -np.inf)]
)
def test_a_gain_that_is_no_number_is_told_and_counted(tmp_path, params, at, value):
    """Samples stay as the digitiser wrote them: gain and offset only turn them into volts."""
    kinds = {1: Descriptor(), 2: Descriptor()}
    path = write_las(
        tmp_path / "a.las",
        np.zeros((6, 3)),
        waveforms=[np.arange(60)] * 6,
        descriptor_of=[1, 1, 2, 2, 2, 2],
        descriptors=kinds,
        location=10.0,
    )
    patched(path, 1, at, "<d", value)
    waves = read(path, params)
    assert waves.pulses.rows == 6
    assert waves.faults == {"descriptor without a usable gain or offset (taken for the gain of the others)": 2}
    assert any("descriptor 1 has gain" in f for f in info(path)["faults"])
    check_source(open_source(path), params)


def test_gain_and_offset_leave_the_samples_alone(tmp_path, params):
    path = write_las(tmp_path / "a.las", np.zeros((1, 3)), waveforms=[np.arange(60)], location=10.0)
    patched(path, 1, GAIN, "<d", 0.25)
    patched(path, 1, OFFSET, "<d", -3.0)
    waves = read(path, params)
    assert waves.samples.tolist() == list(range(60)) and waves.faults == {}
    assert waves.pulses["saturation"].tolist() == [255.0]


@pytest.mark.parametrize(
    ("name", "descriptor"),
    [
        ("invalid sample spacing", Descriptor(spacing_ps=0)),
        ("invalid sample spacing", Descriptor(spacing_ps=2**32 - 1)),
        ("unsupported samples", Descriptor(bits=0)),
        ("unsupported samples", Descriptor(bits=17)),
        ("packet size too small", Descriptor(n_samples=2**32 - 1)),
        ("packet size too small", Descriptor(n_samples=61)),
    ],
)
def test_one_bad_descriptor_of_two(tmp_path, params, name, descriptor):
    path = write_las(
        tmp_path / "a.las",
        np.zeros((6, 3)),
        waveforms=[np.arange(60)] * 6,
        descriptor_of=[1, 2] * 3,
        descriptors={1: Descriptor(), 2: descriptor},
        location=10.0,
        wave={"size": 60},
        return_number=[1] * 6,
    )
    waves = read(path, params)
    assert waves.faults[name] == 3 and waves.pulses.rows <= 3 and waves.returns.rows == 6


def test_one_bad_descriptor_alone_is_refused(tmp_path, params):
    path = write_las(
        tmp_path / "a.las",
        np.zeros((6, 3)),
        waveforms=[np.arange(60)] * 6,
        location=10.0,
        descriptors={1: Descriptor(spacing_ps=0)},
    )
    with pytest.raises(InputError, match="6 returns: invalid sample spacing"):
        check_source(open_source(path), params)


@pytest.mark.parametrize("value", [0, 1, 255])
@pytest.mark.parametrize("n", [1, 100_000])
def test_constant_waveforms_of_any_length(tmp_path, params, value, n):
    path = write_las(
        tmp_path / "a.las",
        np.zeros((2, 3)),
        waveforms=[np.full(n, value)] * 2,
        location=0.0,
        descriptors={1: Descriptor(n_samples=n)},
    )
    waves = read(path, params)
    assert np.diff(waves.offsets).tolist() == [n, n] and (waves.samples == value).all()


@pytest.mark.parametrize(
    "gains, relative",
    [((0.5, 2.5), (1.0, 5.0)), ((0.5, -2.5), (1.0, 1.0)), ((np.nan, 2.5), (1.0, 1.0)), ((1.0, 1e9), (1.0, 1.0))],
)
def test_gains_are_told_relative_to_the_first_descriptor(tmp_path, params, gains, relative):
    """What a DN is worth; of a gain that is no positive number, or absurd, nothing is made."""
    path = write_las(
        tmp_path / "a.las",
        [(0, 0, 5), (1, 0, 6)],
        waveforms=[digitise(gaussian(60, [(90.0, 20.0, 3.5)]))] * 2,
        descriptor_of=[1, 4],
        descriptors={1: Descriptor(), 4: Descriptor()},
        location=20.0,
    )
    for index, gain in zip((1, 4), gains, strict=True):
        patched(path, index, GAIN, "<d", gain)
    waves = read(path, params)
    np.testing.assert_allclose(waves.pulses["gain"], relative)
    assert set(waves.samples.tolist()) <= set(range(256)), "samples stay as they are"
