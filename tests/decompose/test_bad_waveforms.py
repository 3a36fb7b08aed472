"""Waveforms that no receiver should deliver, but some do: flagged or refused in words, never lost, never for ever."""

from __future__ import annotations

import contextlib
import struct
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
import wavemaker as wm
from commandline import fwclass
from lasmaker import METRES_PER_NS, Descriptor, digitise, gaussian, write_las
from numpy.typing import NDArray

from fwclass.decompose.fitted_echoes import SATURATED
from fwclass.decompose.fitting import Fits, fit_waveforms
from fwclass.decompose.odd_samples import odd_waveforms
from fwclass.decompose.params import DecomposeParams
from fwclass.decompose.stage import VENDOR_KEPT, decompose
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.errors import FwclassError
from fwclass.schema import Table
from fwclass.single_file.decompose import decompose_file
from fwclass.single_file.strip import FileStrip
from fwclass.waveforms import PULSE_COLUMNS, RETURN_COLUMNS, Waveforms

PULSE = SystemPulse.gaussian(3.5)
PATIENCE = 5.0
"""Processor seconds for a handful of waveforms, compilation left out: a thousand times what they need."""

LONG = 100_000
TRUE = ((120.0, 20.3, 3.6), (60.0, 38.7, 4.0))
"""The echoes of the good waveform: height [DN], time [ns], FWHM [ns]."""


@pytest.fixture(scope="module")
def params(base: dict[str, Any]) -> DecomposeParams:
    return DecomposeParams(**base["decompose"])


def good(n: int = 60, seed: int = 1) -> NDArray:
    return digitise(gaussian(n, TRUE) + np.random.default_rng(seed).normal(0, 1.0, n))


def waveforms(
    records: Sequence[NDArray], spacing: Any = 1.0, saturation: Any = 255.0, location: Any = 20.3
) -> Waveforms:
    """Pulses with one return each, straight below the sensor."""
    n = len(records)
    nothing = np.full(n, np.nan)
    pulses = dict.fromkeys(PULSE_COLUMNS, np.zeros(n))
    pulses |= {
        "pulse": np.arange(n),
        "step_z": np.full(n, METRES_PER_NS),
        "anchor_range": nothing,
        "outgoing_start": nothing,
        "anchor_time": np.broadcast_to(location, n),
        "sample_spacing": np.broadcast_to(spacing, n),
        "saturation": np.broadcast_to(saturation, n),
        "gain": np.ones(n),
    }
    returns = dict.fromkeys(RETURN_COLUMNS, nothing)
    returns |= {
        "pulse": np.arange(n),
        "return_number": np.ones(n),
        "number_of_returns": np.ones(n),
        "x": np.zeros(n),
        "y": np.zeros(n),
        "z": np.zeros(n),
        "gps_time": np.arange(n),
        "intensity": np.full(n, 7),
        "source_class": np.full(n, 2),
        "location": np.broadcast_to(location, n),
        "has_packet": np.ones(n, bool),
    }
    kind = np.result_type(np.uint8, *(r.dtype for r in records))
    offsets = np.concatenate([[0], np.cumsum([len(r) for r in records])]).astype(np.int64)
    samples = np.concatenate([np.asarray(r, kind) for r in records])
    return Waveforms(Table(pulses), Table(returns), samples, offsets)


def full(value: int, n: int = 60) -> NDArray:
    return np.full(n, value, np.uint8)


def bad_records() -> dict[str, NDArray]:
    rng = np.random.default_rng(8)
    return {
        "constant": full(7),
        "all zero": full(0),
        "all saturated": full(255),
        "all but one saturated": np.append(full(255, 59), np.uint8(10)),
        "one sample": full(9, 1),
        "one bright sample": full(250, 1),
        "one saturated sample": full(255, 1),
        "no sample": full(0, 0),
        "two samples": np.array([10, 200], np.uint8),
        "three samples": np.array([10, 200, 12], np.uint8),
        "a step": np.repeat(np.array([10, 200], np.uint8), 30),
        "a ramp": np.arange(60, dtype=np.uint8) * 4,
        "a saw": np.tile(np.array([0, 255], np.uint8), 30),
        "one spike": np.where(np.arange(60) == 30, 255, 10).astype(np.uint8),
        "a spike at the start": np.where(np.arange(60) == 0, 200, 10).astype(np.uint8),
        "noise over the whole range": rng.integers(0, 256, 60).astype(np.uint8),
        "coarse bits": rng.integers(0, 2, 60).astype(np.uint8) * 255,
    }


@contextlib.contextmanager
def patience(seconds: float = PATIENCE) -> Iterator[None]:
    before = time.process_time()
    yield
    assert time.process_time() - before < seconds, "as good as hanging"


def sane(fits: Fits, waves: Waveforms, params: DecomposeParams) -> None:
    """What holds whatever the samples were."""
    n, m = waves.pulses.rows, len(fits.row)
    assert [len(getattr(fits, k)) for k in ("count", "baseline", "noise", "misfit")] == [n] * 4
    assert all(
        len(getattr(fits, f.name)) == m for f in fields(Fits) if f.name not in ("count", "baseline", "noise", "misfit")
    )
    assert np.array_equal(np.bincount(fits.row, minlength=n), fits.count) and (fits.count <= params.max_echoes).all()
    assert (np.lexsort((fits.time, fits.row)) == np.arange(m)).all()
    spacing = waves.pulses["sample_spacing"].astype(float)[fits.row]
    lasts = np.diff(waves.offsets)[fits.row] * spacing
    assert (np.isfinite(fits.amplitude) & (fits.amplitude > 0)).all()
    assert (np.isfinite(fits.width) & (fits.width > 0)).all() and (
        fits.width <= 1.01 * params.widest * PULSE.fwhm
    ).all()
    reach = params.widest * PULSE.fwhm
    assert ((fits.time > -reach) & (fits.time < lasts + reach)).all()
    for name in ("amplitude_sigma", "time_sigma", "width_sigma"):
        sigma = getattr(fits, name)
        assert (np.isnan(sigma) | (sigma >= 0)).all(), name
    known = fits.count > 0
    assert np.isfinite(fits.baseline[known]).all() and (fits.noise[known] > 0).all()
    assert (fits.flags < 16).all()


@pytest.mark.parametrize("name", bad_records())
def test_a_bad_waveform_ends_in_a_sane_answer(name: str, params: DecomposeParams) -> None:
    record = bad_records()[name]
    waves = waveforms([good(), record, good(seed=2)])
    fit_waveforms(waveforms([good()]), params, PULSE)
    with patience():
        fits = fit_waveforms(waves, params, PULSE)
    sane(fits, waves, params)
    alone = fit_waveforms(waveforms([good(), good(seed=2)]), params, PULSE)
    for f in fields(Fits):
        if f.name in ("count", "baseline", "noise", "misfit"):
            assert np.array_equal(getattr(fits, f.name)[[0, 2]], getattr(alone, f.name)), "its neighbours do not notice"
    assert np.array_equal(fits.time[fits.row != 1], alone.time)
    assert np.array_equal(alone.count, [2, 2])


@pytest.mark.parametrize("name", ["constant", "all zero", "one sample", "no sample"])
def test_what_holds_nothing_has_no_echo(name: str, params: DecomposeParams) -> None:
    fits = fit_waveforms(waveforms([bad_records()[name]]), params, PULSE)
    assert fits.count.tolist() == [0] and np.isnan(fits.misfit).all()


@pytest.mark.parametrize("name", ["all saturated", "all but one saturated", "one saturated sample"])
def test_an_echo_made_of_saturated_samples_is_flagged(name: str, params: DecomposeParams) -> None:
    fits = fit_waveforms(waveforms([bad_records()[name]]), params, PULSE)
    assert ((fits.flags & SATURATED) > 0).all()


@pytest.mark.parametrize("name", bad_records())
def test_no_pulse_of_the_vendor_loses_all_its_echoes(name: str, params: DecomposeParams) -> None:
    waves = waveforms([good(), bad_records()[name]])
    echoes, links, _ = decompose(waves, 0, params, PULSE)
    mine = echoes.take(np.flatnonzero(echoes["pulse"] == 1))
    assert mine.rows >= 1
    fitted = fit_waveforms(waves, params, PULSE).count[1]
    if fitted == 0:
        assert mine.rows == 1 and (mine["fit_flags"] & VENDOR_KEPT > 0).all(), "kept, and flagged as kept"
        assert mine["z"][0] == 0.0 and mine["intensity"][0] == 7
    assert np.isfinite([mine[axis] for axis in "xyz"]).all()
    assert links.rows == 2 and (links["echo_number"] >= 1).all()


def test_a_waveform_of_a_hundred_thousand_samples(params: DecomposeParams) -> None:
    rng = np.random.default_rng(4)
    far = [(120.0, 20.3, 3.6), (90.0, 77_777.25, 3.6), (60.0, LONG - 40.5, 4.0)]
    echoes = digitise(gaussian(LONG, far) + rng.normal(0, 1, LONG))
    noise = digitise(10 + rng.normal(0, 1, LONG))
    many = [(100.0, 50.0 + 997.0 * k, 3.5) for k in range(100)]
    crowd = digitise(gaussian(LONG, many) + rng.normal(0, 1, LONG))
    wild = rng.integers(0, 256, LONG).astype(np.uint8)
    records = [echoes, noise, crowd, wild, np.full(LONG, 255, np.uint8), np.zeros(LONG, np.uint8), good()]
    waves = waveforms(records)
    fit_waveforms(waveforms([good()]), params, PULSE)
    with patience(20.0):
        fits = fit_waveforms(waves, params, PULSE)
    sane(fits, waves, params)
    found = fits.time[fits.row == 0]
    for _, at, _ in far:
        assert np.abs(found - at).min() < 0.1, "an echo anywhere in a long waveform is found"
    at_most = 3 + 2e-4 * LONG / 60 + 5  # the false echoes that so many waveforms' worth of noise may have
    assert fits.count[0] <= at_most and fits.count[1] <= at_most
    assert fits.count[2] == params.max_echoes
    assert fits.count[6] == 2


@pytest.mark.parametrize("spacing", [0.0, -1.0, np.nan, np.inf, 1e-30, 1e30])
def test_a_spacing_that_cannot_be(spacing: float, params: DecomposeParams) -> None:
    waves = waveforms([good(), good()], spacing=[1.0, spacing])
    fit_waveforms(waveforms([good()]), params, PULSE)
    with patience():
        try:
            fits = fit_waveforms(waves, params, PULSE)
        except FwclassError as fault:
            assert "spacing" in str(fault) and fault.do
            return
    assert fits.count[0] == 2
    assert np.isfinite(fits.time).all() and np.isfinite(fits.width).all() and (fits.amplitude > 0).all()
    echoes, _, _ = decompose(waves, 0, params, PULSE)
    second = echoes.take(np.flatnonzero(echoes["pulse"] == 1))
    assert second.rows >= 1, "the vendor's return is kept"
    assert np.isfinite([second[axis] for axis in "xyz"]).all()
    if fits.count[1] == 0:
        assert (second["fit_flags"] & VENDOR_KEPT).all()


@pytest.mark.parametrize("saturation", [np.nan, 0.0, -5.0, np.inf])
def test_a_saturation_that_cannot_be(saturation: float, params: DecomposeParams) -> None:
    waves = waveforms([good(), good()], saturation=[255.0, saturation])
    fits = fit_waveforms(waves, params, PULSE)
    assert fits.count[0] == 2 and np.isfinite(fits.amplitude).all()
    echoes, _, _ = decompose(waves, 0, params, PULSE)
    assert set(echoes["pulse"].tolist()) == {0, 1}


@pytest.mark.parametrize("location", [np.nan, np.inf, 1e30])
def test_a_return_location_that_cannot_be(location: float, params: DecomposeParams) -> None:
    waves = waveforms([good(), good()], location=[20.3, location])
    try:
        echoes, _, _ = decompose(waves, 0, params, PULSE)
    except FwclassError as fault:
        assert fault.do
        return
    assert set(echoes["pulse"].tolist()) == {0, 1}
    first = echoes.take(np.flatnonzero(echoes["pulse"] == 0))
    assert np.isfinite(first["z"]).all()


# whole files


@dataclass
class Odd(Descriptor):
    """A descriptor with a gain and an offset of one's own."""

    gain: float = 1.0
    offset: float = 0.0

    def pack(self) -> bytes:
        head = struct.pack("<BBII", self.bits, self.compression, self.n_samples, self.spacing_ps)
        return head + struct.pack("<dd", self.gain, self.offset)


def survey(path: Path, records: Sequence[NDArray], kinds: Sequence[int], descriptors: dict[int, Descriptor]) -> Path:
    """A file of pulses with one return each at 20.3 ns (or in the middle of what is shorter), and its packets."""
    n = len(records)
    location = [
        min(20.3, 0.5 * (len(r) - 1) * max(descriptors[k].spacing_ps, 0) * 1e-3)
        for r, k in zip(records, kinds, strict=True)
    ]
    xyz = np.c_[500000.0 + np.arange(n), np.full(n, 5400000.0), np.full(n, 200.0)]
    return write_las(
        path,
        xyz,
        waveforms=list(records),
        descriptor_of=list(kinds),
        pulse=np.arange(n),
        location=location,
        gps_time=1000.0 + np.arange(n),
        descriptors=descriptors,
        classification=2,
        intensity=np.arange(n) + 1,
    )


def mixed(path: Path) -> tuple[Path, list[str]]:
    """Every bad record among good ones; the name of every pulse."""
    records, kinds, names = [], [], []
    descriptors: dict[int, Descriptor] = {1: Descriptor()}
    for name, record in {**bad_records(), "long": digitise(gaussian(LONG, TRUE))}.items():
        if len(record) == 0:
            continue
        kind = next((k for k, d in descriptors.items() if d.n_samples == len(record)), len(descriptors) + 1)
        descriptors.setdefault(kind, Descriptor(n_samples=len(record)))
        records += [record, good(seed=len(names))]
        kinds += [kind, 1]
        names += [name, "good"]
    for name, odd in {
        "no spacing": Odd(spacing_ps=0),
        "gain NaN": Odd(gain=np.nan),
        "offset NaN": Odd(offset=np.nan),
        "gain infinite": Odd(gain=np.inf),
        "gain 0": Odd(gain=0.0),
    }.items():
        descriptors[len(descriptors) + 1] = odd
        records.append(good(seed=99))
        kinds.append(len(descriptors))
        names.append(name)
    return survey(path, records, kinds, descriptors), names


def pulses_of(path: Path) -> NDArray[np.int64]:
    """Index of the pulse of every echo in an output of the command."""
    return np.rint(np.asarray(laspy.read(path).gps_time) - 1000.0).astype(np.int64)


def test_a_file_with_everything_wrong_is_decomposed(tmp_path: Path) -> None:
    source, names = mixed(tmp_path / "bad.las")
    result = fwclass("decompose", source, tmp_path / "o.laz")
    assert result.returncode == 4 and "implausible" in result.stderr, result.stderr
    assert "Traceback" not in result.stderr and not result.stdout
    assert "invalid sample spacing: 1" in result.stderr, "what could not be used is said and counted"
    line = ("features", source, tmp_path / "o.parquet", "--features", "amplitude")
    result = fwclass(*line)
    assert result.returncode == 4 and "implausible" in result.stderr, result.stderr
    assert fwclass(*line, "--overwrite", "--accept-implausible").returncode == 0
    count = np.bincount(pulses_of(tmp_path / "o.laz"), minlength=len(names))
    assert [name for name, c in zip(names, count, strict=True) if c == 0] == [], "no return is lost"
    assert (count[[k for k, name in enumerate(names) if name == "good"]] == 2).all()
    assert count[names.index("long")] >= 2 and count[names.index("no spacing")] == 1
    las = laspy.read(tmp_path / "o.laz")
    assert np.isfinite([las.x, las.y, las.z]).all()
    assert (np.abs(np.asarray(las.z) - 200.0) < LONG * METRES_PER_NS).all()


def test_a_gain_that_is_no_number_does_not_change_raw_samples(tmp_path: Path) -> None:
    """Samples are used as recorded [DN]: a gain that cannot be is told, and the echoes are those without it."""
    answers = []
    for name, gain in (("one", 1.0), ("nan", np.nan)):
        source = survey(tmp_path / f"{name}.las", [good(seed=k) for k in range(5)], [1] * 5, {1: Odd(gain=gain)})
        try:
            decompose_file(source, tmp_path / f"{name}.laz", (), False)
        except FwclassError as fault:
            assert name == "nan" and "gain" in str(fault) and fault.do
            return
        las = laspy.read(tmp_path / f"{name}.laz")
        answers.append(np.c_[las.z, las["amplitude DN"]])
    assert np.array_equal(*answers) and len(answers[0]) == 10


def test_a_gain_that_is_no_number_is_told(tmp_path: Path) -> None:
    source = survey(tmp_path / "nan.las", [good()], [1], {1: Odd(gain=np.nan)})
    result = fwclass("info", source)
    assert result.returncode == 0 and "gain" in result.stdout


def test_a_file_without_any_spacing_is_refused_in_words(tmp_path: Path) -> None:
    source = survey(tmp_path / "zero.las", [good()] * 3, [1] * 3, {1: Odd(spacing_ps=0)})
    with pytest.raises(FwclassError) as fault:
        decompose_file(source, tmp_path / "o.laz", (), False)
    assert "spacing" in str(fault.value) and "missing_packets" in fault.value.do
    assert not (tmp_path / "o.laz").exists()
    decompose_file(source, tmp_path / "o.laz", ("read.missing_packets=keep",), False)
    assert pulses_of(tmp_path / "o.laz").tolist() == [0, 1, 2], "on request the returns are kept without waveforms"


@pytest.mark.parametrize("name", ["constant", "all zero", "all saturated", "one sample", "a saw"])
def test_a_file_of_nothing_but_bad_waveforms_keeps_its_returns(name: str, tmp_path: Path) -> None:
    """Nor does the system's pulse come from them."""
    record = bad_records()[name]
    source = survey(tmp_path / "b.las", [record] * 200, [1] * 200, {1: Descriptor(n_samples=len(record))})
    with patience(20.0):
        decompose_file(source, tmp_path / "o.laz", (), False)
    assert set(pulses_of(tmp_path / "o.laz").tolist()) == set(range(200))


def test_a_long_waveform_in_a_file_is_read_once(tmp_path: Path) -> None:
    """Its returns and echoes lie where they should along the beam."""
    at = 98_765.4
    record = digitise(gaussian(LONG, [(150.0, at, 3.5)]) + np.random.default_rng(0).normal(0, 1, LONG))
    source = write_las(
        tmp_path / "l.las",
        [[0, 0, 0]],
        waveforms=[record],
        pulse=[0],
        location=[at],
        gps_time=1000.0,
        descriptors={1: Descriptor(n_samples=LONG)},
    )
    with patience(30.0):
        decompose_file(source, tmp_path / "o.laz", (), False)
    z = np.asarray(laspy.read(tmp_path / "o.laz").z)
    assert np.abs(z).min() < 0.02


@pytest.mark.parametrize(("samples", "phi"), [(10, ()), (16, (0.6,)), (40, (0.9,)), (72, ())])
def test_noise_and_broad_echoes_do_not_point_down(samples, phi):
    """At most 3 of 20 000 waveforms of noise; none that one echo fills; nearly all that are turned and hold a level."""
    noise, _ = wm.noise_only(20_000, samples=samples, phi=phi, seed=samples)
    assert odd_waveforms(noise)["downward"] <= 3
    time = np.full((500, 1), samples / 2.0)
    for width in (4.0, 0.5 * samples, 1.5 * samples):
        broad, _ = wm.simulate(np.full((500, 1), 80.0), time, np.full((500, 1), width / wm.FWHM), samples=samples)
        assert odd_waveforms(broad)["downward"] == 0
    one, _ = wm.simulate(np.full((500, 1), 80.0), time, np.full((500, 1), 4.0 / wm.FWHM), samples=samples)
    turned = replace(one, samples=255 - one.samples)
    assert odd_waveforms(turned)["downward"] >= (480 if samples >= 40 else 0)


def test_a_file_that_changes_while_it_is_decomposed_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, noise = survey(tmp_path / "a.las", [good(seed=k) for k in range(5)], [1] * 5, {1: Odd()}), FileStrip.noise

    def change(strip: FileStrip) -> Any:
        source.write_bytes(source.read_bytes())
        return noise(strip)

    monkeypatch.setattr(FileStrip, "noise", change)
    with pytest.raises(FwclassError, match="changed while it was read"):
        decompose_file(source, tmp_path / "out.laz", (), False)
    assert not (tmp_path / "out.laz").exists()
