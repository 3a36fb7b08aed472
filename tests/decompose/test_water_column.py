"""Water under a green laser: laws of the bent beam and the column, a lake whose truth is known, bad waveforms."""

from __future__ import annotations

import laspy
import numpy as np
import pytest
from commandline import fwclass
from lasmaker import Descriptor, digitise, gaussian, write_las
from scipy.integrate import quad
from watermaker import AIR, FWHM, WATER, lake, scored

from fwclass.decompose.params import BathymetryParams, DecomposeParams
from fwclass.decompose.stage import decompose
from fwclass.decompose.system_pulse import Channel, SystemPulse
from fwclass.decompose.water_column import refract
from fwclass.decompose.water_model import ENDLESS, column_shape
from fwclass.read.params import ReadParams
from fwclass.read.source import open_source
from fwclass.read.stage import index_source, read_span
from fwclass.waveforms import BATHYMETRY_COLUMNS, ECHO_COLUMNS


def beams(n: int = 500, seed: int = 0) -> np.ndarray:
    r = np.random.default_rng(seed)
    v = r.normal(size=(n, 3))
    v[:, 2] = -np.abs(v[:, 2])
    return v / np.linalg.norm(v, axis=1)[:, None]


def test_a_beam_bends_as_snell_says():
    into = beams()
    bent = refract(into, AIR, WATER)
    np.testing.assert_allclose(np.linalg.norm(bent, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(AIR * np.cross(into, [0, 0, 1]), WATER * np.cross(bent, [0, 0, 1]), atol=1e-12)
    assert (bent[:, 2] <= into[:, 2]).all()


def test_light_takes_the_same_way_back():
    into = beams()
    np.testing.assert_allclose(refract(-refract(into, AIR, WATER), WATER, AIR), -into, atol=1e-9)


def test_straight_down_nothing_bends_and_beyond_the_limit_nothing_passes():
    np.testing.assert_array_equal(refract(np.array([[0.0, 0.0, -1.0]]), AIR, WATER), [[0.0, 0.0, -1.0]])
    for off, passes in ((-1e-6, True), (1e-6, False)):
        tilt = np.arcsin(AIR / WATER) + off
        out = refract(np.array([[np.sin(tilt), 0.0, np.cos(tilt)]]), WATER, AIR)
        assert np.isfinite(out).all() == passes


@pytest.mark.parametrize("decay", [0.005, 0.05, 0.3, 10.0])
@pytest.mark.parametrize("length", [3.0, 40.0, ENDLESS])
def test_the_column_is_the_integral_that_it_stands_for(decay, length):
    sigma = 1.5
    for u in (-12.0, -3.0, 0.0, 0.7, 5.0, 39.0, 43.0, 60.0):
        near = (max(0.0, u - 12.0 * sigma), min(length, u + 12.0 * sigma))
        true = 0.0
        if near[0] < near[1]:
            true = quad(lambda x, u=u: np.exp(-decay * x - 0.5 * ((u - x) / sigma) ** 2), *near, epsabs=1e-14)[0]
        assert column_shape(u, sigma, decay, length) == pytest.approx(true, rel=1e-7, abs=1e-13)


def test_the_column_is_finite_everywhere():
    for u in (-1e4, -1e3, 1e3, 1e4):
        for decay in (1e-6, 10.0):
            for length in (0.1, ENDLESS):
                assert 0.0 <= column_shape(u, 0.3, decay, length) < 1e7


@pytest.mark.parametrize("lag1", [pytest.param(0.0, marks=pytest.mark.slow), 0.5])
def test_a_lake_is_as_deep_as_it_was_made(tmp_path, lag1):
    truth = lake(tmp_path / "lake.las", 600 if lag1 == 0 else 250, lag1=lag1, seed=3, depths=(1.5, 15.0))
    words = ("decompose", truth.path, "--set", "plausibility.accept=true")
    ended = fwclass(*words[:2], tmp_path / "on.laz", *words[2:], "--set", "bathymetry.enabled=true")
    assert ended.returncode == 0 and "water: " in ended.stderr, ended.stderr
    assert fwclass(*words[:2], tmp_path / "off.laz", *words[2:]).returncode == 0
    on, off = laspy.read(tmp_path / "on.laz"), laspy.read(tmp_path / "off.laz")
    asked, plain = scored(truth, on), scored(truth, off)
    assert {"water", "water decay", "water depth"} <= set(on.point_format.dimension_names)
    assert not {"water", "water depth"} & set(off.point_format.dimension_names)
    assert asked.found[asked.visible > 8].mean() > 0.97 and asked.surfaces.mean() > 0.97 and asked.wrong.mean() < 0.01
    assert asked.false_water.mean() <= 0.005 and abs(asked.extra.mean()) < 0.5
    assert np.sqrt((asked.depth_error**2).mean()) < 0.08 and np.median(asked.place_error) < 0.02
    assert 0.8 < asked.standard.std() < 1.25
    assert np.median(plain.depth_error) > 0.5 and np.median(plain.place_error) > 0.5
    deep = np.asarray(on["water"]) == 2
    decay = np.asarray(on["water decay"])[deep & (np.asarray(on["water depth"]) > 5.0)]
    mine = np.asarray(on["pulse"])[deep & (np.asarray(on["water depth"]) > 5.0)]
    assert abs(np.median(decay - truth.decay[mine])) < 0.02


@pytest.mark.statistics
def test_land_keeps_its_echoes(tmp_path, base):
    truth = lake(tmp_path / "land.las", 200, shore=1.0, seed=4)
    plain, asked = (of_file(truth.path, base, on) for on in (False, True))
    assert tuple(plain) == ECHO_COLUMNS and tuple(asked) == (*ECHO_COLUMNS, *BATHYMETRY_COLUMNS)
    assert (asked["water"] == 0).all() and np.isnan(asked["water_depth"]).all()
    for name in ECHO_COLUMNS:
        np.testing.assert_array_equal(asked[name], plain[name])


def of_file(path, base, on: bool, receiver: bool = True, **changes):
    """The echoes of a file of one span."""
    source = open_source(path)
    (span,) = index_source(source, ReadParams(**base["read"]))
    waves = read_span(source, span, ReadParams(**base["read"]))
    pulse = SystemPulse.gaussian(3.5, 0.01)
    if receiver:
        channels = (Channel(1.0, 255.0, 12.0, 0.2, 1.2, 20.0, 255.0),)
        pulse = SystemPulse("gaussian", 3.5, shape_error=0.01, channels=channels)
    params = BathymetryParams(**base["bathymetry"] | changes) if on else None
    return decompose(waves, 3, DecomposeParams(**base["decompose"]), pulse, bathymetry=params)[0]


def under_water(n: int = 90) -> np.ndarray:
    """A record that begins in the column."""
    t = np.arange(n)
    return 40.0 * np.exp(-0.03 * t) + gaussian(n, [(60.0, 45.0, 3.5)], 12.0)


@pytest.mark.parametrize("receiver", [True, False])
def test_bad_waveforms_keep_their_plain_echoes(tmp_path, base, receiver):
    r = np.random.default_rng(1)
    fine = gaussian(90, [(120.0, 30.0, 3.5), (60.0, 60.0, 3.5)], 12.0)
    odd = [
        np.zeros(90),
        np.full(90, 255.0),
        np.full(90, 12.0),
        under_water() + r.normal(0.0, 1.0, 90),
        fine,
        np.where(np.arange(90) > 20, 255.0, 12.0),
        10.0 * fine,
        gaussian(90, [(120.0, 1.0, 3.5)], 12.0),
        gaussian(90, [(120.0, 88.0, 3.5)], 12.0),
        r.uniform(0.0, 255.0, 90),
    ]
    samples = [digitise(y) for y in odd]
    k = np.arange(len(samples))
    place = np.stack([500_000.0 + k, 5_400_000.0 + 0.0 * k, 200.0 + 0.0 * k], axis=1)
    kinds = {1: Descriptor(8, 90, 1000)}
    path = write_las(tmp_path / "odd.las", place, waveforms=samples, pulse=k, location=30.0, descriptors=kinds)
    plain, asked = (of_file(path, base, on, receiver) for on in (False, True))
    assert np.isfinite(asked["x"]).all() and np.isfinite(asked["z"]).all()
    for name in ECHO_COLUMNS:
        np.testing.assert_array_equal(asked[name], plain[name])


def test_short_waveforms_and_none(tmp_path, base):
    kinds = {1: Descriptor(8, 6, 1000)}
    samples = [np.array([12, 12, 90, 40, 12, 12], np.uint8)] * 3
    place = np.tile([500_000.0, 5_400_000.0, 200.0], (4, 1))
    path = write_las(tmp_path / "a.las", place, waveforms=samples, pulse=[0, 1, 2, -1], location=2.0, descriptors=kinds)
    echoes = of_file(path, base, True)
    assert (echoes["water"] == 0).all() and echoes.rows == 4


def test_a_surface_at_the_digitisers_limit_still_has_its_bottom(tmp_path, base):
    sigma = 3.5 / 2.3548
    t = np.arange(160.0)
    column = [20.0 * column_shape(u - 40.3, sigma, 0.03, 50.0) for u in t]
    y = gaussian(160, [(600.0, 40.3, 3.5), (80.0, 90.3, 3.5)], 12.0) + np.array(column) / 3.0
    y += np.random.default_rng(2).normal(0.0, 1.2, 160)
    kinds = {1: Descriptor(8, 160, 1000)}
    place = [[500_000.0, 5_400_000.0, 200.0]]
    path = write_las(tmp_path / "a.las", place, waveforms=[digitise(y)], pulse=[0], location=40.3, descriptors=kinds)
    echoes = of_file(path, base, True)
    assert echoes["water"].tolist() == [1, 2] and echoes["fit_flags"][0] & 1
    assert echoes["water_depth"][1] == pytest.approx(50.0 * 0.299792458 / 2 / 1.357, abs=0.05)


def test_water_alone_has_its_bottoms_where_the_width_is_given(tmp_path):
    truth = lake(tmp_path / "water.las", 300, shore=0.0, seed=6, depths=(1.5, 6.0))
    words = ("--set", "bathymetry.enabled=true", "--set", f"pulse.width={FWHM}")
    ended = fwclass("decompose", truth.path, tmp_path / "on.laz", *words)
    assert ended.returncode == 0, ended.stderr
    score = scored(truth, laspy.read(tmp_path / "on.laz"))
    assert score.found[score.visible > 6].mean() > 0.98 and score.surfaces.mean() > 0.98 and not score.wrong.any()
