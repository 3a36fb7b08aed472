"""Echoes of several pulses together, on waveforms written here with numpy alone."""

import numpy as np
import pytest
import wavemaker as wm
from woodmaker import SIDE, flown

from fwclass import conf
from fwclass.decompose.placement import AS_STORED
from fwclass.decompose.stack_candidates import Candidates, Surface, candidates
from fwclass.decompose.stacking import STACKED, roughness_of, stack, threshold_of
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.grid import Box, Window
from fwclass.waveforms import Waveforms

FIT = conf.section("decompose", ())


def params(**changed):
    return conf.section("stack", tuple(f"stack.{k}={v}" for k, v in changed.items()))


def surface(height, slope=0.0, off=0.0):
    window = Window(1.0, -10, -10, 60, 60)
    x = np.arange(-10, 50) + 0.5
    return Surface(np.broadcast_to(height + off + slope * x, (60, 60)).astype(np.float32), window)


NOWHERE = np.empty((0, 2))
INNER = Box(3.0, 3.0, 21.0, 21.0)


def shown(waves, seen, asked, pulse=None, roughness=0.0):
    box = INNER.grown(asked.radius)
    found, _ = candidates(waves, 1, seen, box, asked, FIT, pulse or SystemPulse.gaussian(wm.PULSE_WIDTH), AS_STORED)
    return (*stack(found, NOWHERE, INNER, roughness, asked), found)


def many(ratio, runs, **kind):
    """Echoes, counts and errors [m] along the vertical over several woods."""
    counts, errors, sigmas = {}, [], []
    for seed in range(runs):
        waves, ground = flown(
            100.0, ratio, seed=seed, **{k: v for k, v in kind.items() if k in ("phi", "slope", "rough")}
        )
        seen = surface(100.0, kind.get("slope", 0.0), kind.get("off", 0.0))
        table, told, _ = shown(waves, seen, params(), roughness=kind.get("rough", 0.0))
        for name, value in told.items():
            counts[name] = counts.get(name, 0) + value
        truth = dict(enumerate(ground))
        errors.append(
            table["z"] - np.array([truth[p][2] for p in table["pulse"].tolist()]) if table.rows else np.empty(0)
        )
        sigmas.append(table["range_sigma"])
    return counts, np.concatenate(errors), np.concatenate(sigmas)


def test_nine_pulses_show_what_one_cannot():
    told, errors, sigma = many(1.5, 3)
    assert told["candidates"] > 1500 and told["stacked"] / told["candidates"] >= 0.95, told
    assert told["false"] / told["decoys"] <= 2e-3, told
    assert abs(np.median(errors)) < 0.02 and np.std(errors) < 0.12
    assert 0.85 < np.sqrt(np.mean((errors / sigma) ** 2)) < 1.15


@pytest.mark.statistics
def test_noise_alone_and_what_the_surface_is_off_by():
    told, _, _ = many(0.0, 12)
    assert told["candidates"] > 10_000 and told["stacked"] == 0 and told["false"] <= 1e-3 * told["decoys"] + 4.0, told
    told, errors, _ = many(2.0, 1, off=0.5)
    assert told["stacked"] >= 0.95 * told["candidates"] and abs(np.median(errors)) < 0.02
    told, errors, sigma = many(2.0, 2, rough=0.1)
    assert 0.8 < np.sqrt(np.mean((errors / sigma) ** 2)) < 1.2
    told, errors, _ = many(2.0, 1, slope=0.4)
    assert told["stacked"] >= 0.95 * told["candidates"] and abs(np.median(errors)) < 0.02


def test_what_is_told_of_an_echo():
    waves, _ = flown(100.0, 2.0, seed=5)
    table, told, found = shown(waves, surface(100.0), params())
    assert table.rows == told["stacked"] and (table["origin"] == STACKED).all() and (table["classification"] == 2).all()
    assert (table["stacked_pulses"] == 9).all() and (table["echo_number"] == 2).all()
    assert (table["significance"] > 4.0).all() and (np.diff(table["pulse"].astype(int)) > 0).all()
    assert abs(np.median(table["amplitude"]) - 3.0) < 0.4
    assert np.allclose(table["amplitude"] / table["amplitude_sigma"], table["significance"], rtol=1e-5)
    assert INNER.contains(found.place[:, 0], found.place[:, 1]).sum() == told["candidates"]


def test_who_has_seen_the_ground_is_not_looked_at():
    waves, _ = flown(100.0, 20.0, seed=6)
    pulse = SystemPulse.gaussian(wm.PULSE_WIDTH)
    none, _ = candidates(waves, 1, surface(100.0), INNER, params(), FIT, pulse, AS_STORED)
    assert none is None or len(none.pulse) < 0.01 * SIDE**2
    nowhere = Surface(np.full((60, 60), np.nan, np.float32), Window(1.0, -10, -10, 60, 60))
    assert candidates(waves, 1, nowhere, INNER, params(), FIT, pulse, AS_STORED)[0] is None


def test_the_cut_of_the_strip_does_not_matter():
    waves, _ = flown(100.0, 1.5, seed=7)
    asked, box, pulse = params(), INNER.grown(2.0), SystemPulse.gaussian(wm.PULSE_WIDTH)
    whole, _ = candidates(waves, 1, surface(100.0), box, asked, FIT, pulse, AS_STORED)
    halves = [
        Waveforms(
            waves.pulses.take(rows),
            waves.returns,
            waves.samples[170 * rows[0] : 170 * (rows[-1] + 1)],
            waves.offsets[: len(rows) + 1],
        )
        for rows in (np.arange(700, SIDE**2), np.arange(700))
    ]
    parts = [candidates(h, 1, surface(100.0), box, asked, FIT, pulse, AS_STORED)[0] for h in halves]
    again = Candidates.joined(p for p in parts if p is not None)
    one, two = (stack(c, NOWHERE, INNER, 0.0, asked)[0] for c in (whole, again))
    assert one.rows and all(np.array_equal(one[n], two[n]) for n in one)


def test_noise_that_stands_out_raises_the_threshold():
    """Of 100 echoes at most 2 may be noise: as many decoys as echoes leave none."""
    rng = np.random.default_rng(3)
    asked, noise = params(threshold=4.0, max_false=0.02), rng.normal(2.0, 0.7, 20_000)
    high = threshold_of(np.concatenate([noise[:10_000], rng.normal(6.0, 1.0, 500)]), noise[10_000:], asked)
    assert 4.0 < high < 5.5
    assert threshold_of(noise[:10_000], noise[10_000:], asked) == np.inf
    assert threshold_of(rng.normal(8.0, 0.5, 1000), noise[:1000] - 2.0, asked) == 4.0
    assert threshold_of(noise, np.empty(0), asked) == np.inf


def test_where_the_ground_is_known_nothing_is_looked_for():
    waves, ground = flown(100.0, 1.5, seed=8)
    asked = params()
    box = INNER.grown(asked.radius)
    found, _ = candidates(waves, 1, surface(100.0), box, asked, FIT, SystemPulse.gaussian(wm.PULSE_WIDTH), AS_STORED)
    table, told = stack(found, ground[:1, :2] * 0.0 + 12.0, INNER, 0.0, asked)
    assert table.rows and np.hypot(table["x"] - 12.0, table["y"] - 12.0).min() > asked.gap - 0.3
    assert told["candidates"] < INNER.contains(found.place[:, 0], found.place[:, 1]).sum()


def test_roughness():
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0.0, 60.0, (2, 5000))
    z = 0.4 * x - 0.2 * y + rng.normal(0.0, 0.1, 5000)
    assert roughness_of(x, y, z) == pytest.approx(0.1, rel=0.1)
    other = rng.permutation(5000)
    assert roughness_of(x[other], y[other], z[other]) == roughness_of(x, y, z)
    assert roughness_of(x[:5], y[:5], z[:5]) == 0.0
    assert surface(3.0, 0.5).at(np.array([1.25, 100.0]), np.array([2.0, 0.0])).tolist()[0] == pytest.approx(3.625)


def test_settings_that_cannot_be():
    for changed in ({"least": 10}, {"decoy": 1.0}):
        with pytest.raises(Exception, match=r"least|decoy"):
            params(**changed)
