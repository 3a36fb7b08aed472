"""Laws of the simulator's kernels: random streams, rays, pulses, echoes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tolerances import FLOAT64_UNIT, SMALL_COORDINATE

from fwclass.simulate.noise import normal_table, pulse_key, uniform
from fwclass.simulate.receiver import SHAPE_STEP, add_pulse, add_shape, cluster, detect, digitise, pulse_shape
from fwclass.simulate.scene import BUILDING
from fwclass.simulate.shapes import Place, Things
from fwclass.simulate.trace import _solid, footprint, to_ground
from fwclass.units import FWHM_PER_SIGMA

SIGMA = 3.5 / FWHM_PER_SIGMA


def test_uniform_numbers_are_uniform_and_independent_of_their_neighbours() -> None:
    values = np.array(
        [uniform(key, c) for key in (np.uint64(pulse_key(1, 0, p)) for p in range(200)) for c in range(50)]
    )
    counts, _ = np.histogram(values, 20, (0, 1))
    # chi-square of 19 degrees of freedom: above 43.8 with probability 0.001
    assert ((counts - 500) ** 2 / 500).sum() < 43.8
    assert abs(np.corrcoef(values[:-1], values[1:])[0, 1]) < 4 / math.sqrt(len(values))


def test_streams_of_all_pulses_differ() -> None:
    keys = {int(pulse_key(seed, strip, p)) for seed in (0, 1) for strip in range(8) for p in range(2000)}
    assert len(keys) == 2 * 8 * 2000


def test_normal_table_is_standard_normal() -> None:
    table = normal_table()
    assert abs(table.mean()) < 1e-12
    assert table.std() == pytest.approx(1.0, abs=FLOAT64_UNIT)
    # kurtosis of a normal variate; the 4096 quantiles cut the far tails
    assert (table**4).mean() == pytest.approx(3.0, abs=0.05)


@pytest.mark.parametrize("rings", [(1,), (1, 6), (1, 6, 12), (1, 6, 12, 18)])
def test_footprint_is_centred_and_weighs_one(rings: tuple[int, ...]) -> None:
    rays = footprint(rings)
    assert len(rays) == sum(rings)
    assert rays[:, 2].sum() == pytest.approx(1.0)
    assert rays[:, :2].T @ rays[:, 2] == pytest.approx([0.0, 0.0], abs=FLOAT64_UNIT)
    # second moment of exp(−2 r²) per axis is 1/4; a handful of rings comes near
    if len(rings) > 2:
        assert (rays[:, 2] * rays[:, 0] ** 2).sum() == pytest.approx(0.25, rel=0.15)


def test_ray_meets_a_tilted_plane_where_geometry_says() -> None:
    n, step, margin = 201, 0.5, 10.0
    x = np.arange(n) * step - margin
    height = (0.3 * x[None, :] + 0.1 * x[:, None] + 2.0).astype(np.float32)
    d = np.array([0.35, -0.1, -0.93])
    d /= np.linalg.norm(d)
    o = np.array([20.0, 40.0, 100.0])
    exact = (0.3 * o[0] + 0.1 * o[1] + 2.0 - o[2]) / (d[2] - 0.3 * d[0] - 0.1 * d[1])
    found = to_ground(height, margin, step, *o, *d, 90.0, 50)
    assert found == pytest.approx(exact, abs=1e-3)


def _things(things: Things) -> dict[str, np.ndarray]:
    return things.arrays()


def test_gabled_roof_has_its_pitch_and_its_eave() -> None:
    things, pitch = Things(), math.radians(30)
    ridge = things.roof(Place(50.0, 40.0, 0.4), 14.0, 10.0, 6.0, math.tan(pitch), False, 0.3)
    solid = _things(things)
    assert ridge == pytest.approx(6.0 + 5.0 * math.tan(pitch))
    for v in (-4.0, -1.0, 2.5):
        at = Place(50.0, 40.0, 0.4).at(3.0, v)
        t, cosine = _solid(solid["plane_start"], solid["planes"], 0, at.x, at.y, 100.0, 0.0, 0.0, -1.0, 200.0)
        assert 100.0 - t == pytest.approx(ridge - abs(v) * math.tan(pitch), abs=SMALL_COORDINATE)
        assert cosine == pytest.approx(math.cos(pitch))
    beside = Place(50.0, 40.0, 0.4).at(3.0, 5.1)
    t, cosine = _solid(solid["plane_start"], solid["planes"], 0, beside.x, beside.y, 100.0, 0.0, 0.0, -1.0, 200.0)
    assert (t, cosine) == (200.0, 0.0)


def test_hip_falls_to_all_four_sides() -> None:
    things = Things()
    things.roof(Place(0.0, 0.0, 0.0), 16.0, 10.0, 5.0, 0.5, True, 0.3)
    solid = _things(things)
    for x, y, z in ((0.0, 0.0, 7.5), (7.0, 0.0, 5.5), (0.0, -4.0, 5.5), (-7.5, 4.0, 5.25)):
        t, _ = _solid(solid["plane_start"], solid["planes"], 0, x, y, 50.0, 0.0, 0.0, -1.0, 99.0)
        assert 50.0 - t == pytest.approx(z)


def test_wall_is_hit_from_the_side() -> None:
    things = Things()
    things.block(Place(10.0, 0.0, math.pi / 6), 8.0, 4.0, 0.0, 5.0, BUILDING, 0.3)
    solid = _things(things)
    c, s = math.cos(math.pi / 6), math.sin(math.pi / 6)
    t, cosine = _solid(solid["plane_start"], solid["planes"], 0, 10.0 - 20 * c, -20 * s, 2.0, c, s, 0.0, 99.0)
    assert t == pytest.approx(16.0)
    assert cosine == pytest.approx(1.0)


@pytest.mark.parametrize("mean", [-3.0, 0.2, 20.0, 20.5, 33.71, 47.9])
def test_pulse_is_the_gaussian_it_stands_for(mean: float) -> None:
    wave = np.zeros(48)
    add_pulse(wave, mean, 90.0, SIGMA)
    exact = 90.0 * np.exp(-0.5 * ((np.arange(48) - mean) / SIGMA) ** 2)
    # beyond five sigma a Gaussian is below 4e-6 of its height
    np.testing.assert_allclose(wave, exact, atol=90.0 * 4e-6)


def test_shifted_waves_are_shifted_copies() -> None:
    first, second = np.zeros(64), np.zeros(64)
    add_pulse(first, 20.3, 50.0, SIGMA)
    add_pulse(second, 27.3, 50.0, SIGMA)
    np.testing.assert_allclose(first[10:40], second[17:47], atol=1e-9)


def test_digitiser_adds_the_noise_it_is_given_and_clips() -> None:
    wave = np.zeros(20000)
    samples = np.zeros(20000, np.uint16)
    digitise(wave, np.uint64(5), normal_table(), 1.5, 10.0, 255.0, samples)
    # variance of the noise plus that of rounding; standard error of a standard deviation is s / sqrt(2 n)
    expected = math.sqrt(1.5**2 + 1 / 12)
    assert samples.std() == pytest.approx(expected, abs=5 * expected / math.sqrt(40000))
    assert samples.mean() == pytest.approx(10.0, abs=0.06)
    digitise(wave + 400.0, np.uint64(5), normal_table(), 1.5, 10.0, 255.0, samples)
    assert np.all(samples == 255)


def _clustered(
    hits: list[tuple[float, float, int]], separation: float = 2.5, visible: float = 1.0
) -> list[tuple[float, float, float, int]]:
    time, energy = np.array([h[0] for h in hits]), np.array([h[1] for h in hits])
    code = np.array([h[2] for h in hits])
    echo, echo_code = np.zeros((len(hits), 4)), np.zeros(len(hits), np.int64)
    n = cluster(time, energy, code, len(hits), SIGMA, separation, visible, echo, echo_code, np.zeros(256))
    return [(echo[k, 0], echo[k, 1], echo[k, 2], int(echo_code[k])) for k in range(n)]


def test_echo_is_mean_variance_and_majority_of_its_hits() -> None:
    ((time, energy, variance, code),) = _clustered([(10.0, 30.0, 2), (10.5, 50.0, 6), (11.0, 25.0, 2)])
    weights = np.array([30.0, 50.0, 25.0])
    times = np.array([10.0, 10.5, 11.0])
    mean = np.average(times, weights=weights)
    assert (time, energy) == (pytest.approx(mean), pytest.approx(105.0))
    assert variance == pytest.approx(np.average((times - mean) ** 2, weights=weights))
    assert code == 2  # 55 of 105


def test_echoes_part_beyond_the_separation_only() -> None:
    assert len(_clustered([(10.0, 50.0, 5), (12.4, 50.0, 2)])) == 1
    assert len(_clustered([(10.0, 50.0, 5), (12.6, 50.0, 2)])) == 2


def test_weak_echo_on_the_flank_of_a_strong_one_is_not_seen() -> None:
    assert len(_clustered([(10.0, 100.0, 5), (13.0, 5.0, 2)])) == 1
    assert len(_clustered([(10.0, 100.0, 5), (16.0, 5.0, 2)])) == 2


def test_echo_below_the_noise_is_left_out() -> None:
    assert [e[3] for e in _clustered([(10.0, 3.0, 5), (30.0, 60.0, 2)], visible=5.0)] == [2]


def _detected(samples: np.ndarray) -> list[tuple[float, float]]:
    location, height = np.zeros(8), np.zeros(8)
    n = detect(samples, 10.0, 6.0, 4.0, location, height)
    return list(zip(location[:n], height[:n], strict=True))


def test_sensor_finds_separate_peaks_and_no_noise() -> None:
    wave = np.full(80, 10.0)
    for mean, height in ((20.3, 90.0), (40.0, 15.0), (60.5, 40.0)):
        add_pulse(wave, mean, height, SIGMA)
    found = _detected(np.rint(wave).astype(np.uint16))
    assert [round(t) for t, _ in found] == [20, 40, 60] or [round(t) for t, _ in found] == [20, 40, 61]
    assert np.allclose([t for t, _ in found], [20.3, 40.0, 60.5], atol=0.2)
    assert _detected(np.full(80, 12, np.uint16)) == []


def test_sensor_merges_what_decomposition_could_part() -> None:
    wave = np.full(60, 10.0)
    add_pulse(wave, 20.0, 60.0, SIGMA)
    add_pulse(wave, 22.8, 50.0, SIGMA)
    assert len(_detected(np.rint(wave).astype(np.uint16))) == 1


def test_a_pulse_without_tail_and_ringing_is_no_table() -> None:
    shape, first, sigma = pulse_shape(3.5, 0.0, 0.0, 10.0)
    assert (len(shape), first) == (0, 0.0)
    assert sigma == 3.5 / FWHM_PER_SIGMA  # the very number, so that nothing changes


@pytest.mark.parametrize("skew", [0.3, 0.9, 4.0])
def test_tail_has_the_moments_of_an_exponential(skew: float) -> None:
    shape, first, sigma = pulse_shape(3.5, skew, 0.0, 10.0)
    time = first + SHAPE_STEP * np.arange(len(shape))
    assert shape.max() == 1.0 and abs(time[shape.argmax()]) < 1e-9
    weight = shape / shape.sum()
    mean = (weight * time).sum()
    # variances and third moments of independent parts add: sigma² + skew², and 2 skew³
    assert (weight * (time - mean) ** 2).sum() == pytest.approx(SIGMA**2 + skew**2, rel=1e-3)
    assert (weight * (time - mean) ** 3).sum() == pytest.approx(2.0 * skew**3, rel=0.01)
    assert sigma > SIGMA


def test_ringing_is_a_second_lobe() -> None:
    shape, first, sigma = pulse_shape(3.5, 0.0, 0.03, 10.0)
    time = first + SHAPE_STEP * np.arange(len(shape))
    exact = np.exp(-0.5 * (time / SIGMA) ** 2) + 0.03 * np.exp(-0.5 * ((time - 10.0) / SIGMA) ** 2)
    np.testing.assert_allclose(shape, exact, atol=2e-4)
    assert sigma == pytest.approx(SIGMA, rel=0.01)


@pytest.mark.parametrize("mean", [-3.0, 0.2, 20.0, 20.5, 33.71, 47.9, 80.0])
def test_tabulated_pulse_lies_where_it_should(mean: float) -> None:
    shape, first, _ = pulse_shape(3.5, 0.9, 0.03, 10.0)
    wave = np.zeros(48)
    add_shape(wave, mean, 90.0, shape, first)
    time = first + SHAPE_STEP * np.arange(len(shape))
    exact = 90.0 * np.interp(np.arange(48) - mean, time, shape, left=0.0, right=0.0)
    np.testing.assert_allclose(wave, exact, atol=1e-9)
