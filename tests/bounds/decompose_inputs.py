"""Waveforms that try to lead the kernels of decomposition out of their buffers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from defaults import BASE

from fwclass.decompose import fitting
from fwclass.decompose.deconvolution import backscatter_samples
from fwclass.decompose.fitting import fit_waveforms
from fwclass.decompose.least_squares import evaluate, lay, moments
from fwclass.decompose.matching import nearest_of_pulse, rank_in_pulse
from fwclass.decompose.params import BathymetryParams, DecomposeParams, PulseParams, SampleParams
from fwclass.decompose.placement import AS_STORED
from fwclass.decompose.pulse_estimate import estimate_pulse
from fwclass.decompose.quiet import with_correlated_noise
from fwclass.decompose.shapes import lookup
from fwclass.decompose.signal_noise import with_misfit, with_signal_noise
from fwclass.decompose.stack_kernels import match_around, stack_groups
from fwclass.decompose.system_pulse import Channel, SystemPulse
from fwclass.decompose.water_column import with_water
from fwclass.schema import Table
from fwclass.waveforms import PULSE_COLUMNS, Waveforms

PARAMS = DecomposeParams(**BASE["decompose"])
WATER = BathymetryParams(**BASE["bathymetry"] | {"gain": 0.1})
MANY = {"max_echoes": 64, "detection": 0.5, "split_gain": 0.1, "widest": 20.0, "tail_share": 0.0}
LENGTHS = (0, 1, 2, 3, 4, 5, 6, 8, 12, 40, 64, 98)

WIDE_AT_THE_EDGE = (
    7,
    5,
    7,
    6,
    5,
    8,
    5,
    5,
    7,
    2,
    7,
    10,
    5,
    18,
    152,
    638,
    1001,
    590,
    131,
    15,
    7,
    7,
    7,
    9,
    13,
    17,
    23,
    34,
    48,
    80,
    110,
    160,
    225,
    301,
    394,
    499,
    609,
    718,
    826,
    914,
)
"""A wide skewed echo that a waveform's end cuts off: its halves were tried outside the buffers."""


def long_pulse(lead: float = 5.1, tail: float = 42.6, foot: float = 0.015) -> SystemPulse:
    """A pulse of 2 ns on a long low foot, as a receiver with ringing leaves it."""
    t = np.arange(-round(lead / 0.08), round(tail / 0.08) + 1) * 0.08
    value = (1.0 - foot) * np.exp(-0.5 * (t / 0.87) ** 2) + foot * np.clip(np.minimum(t - t[0], t[-1] - t), 0.0, 1.0)
    return SystemPulse("measured", 2.05, float(t[0]), 0.08, value / value.max(), 0.004, 1000)


def waves(samples: list, spacing: float = 1.0) -> Waveforms:
    """Waveforms of the given samples; what places them in space is unknown."""
    n = len(samples)
    columns = {name: np.full(n, np.nan) for name in PULSE_COLUMNS}
    columns |= {"pulse": np.arange(n), "sample_spacing": np.full(n, spacing), "saturation": np.full(n, 65535.0)}
    offsets = np.concatenate([[0], np.cumsum([len(s) for s in samples])]).astype(np.int64)
    return Waveforms(Table(columns), Table({}), np.concatenate(samples).astype(np.uint16), offsets)


def samples(rng: np.random.Generator) -> np.ndarray:
    """One waveform: wide and skewed echoes at both ends, spikes, steps, saturation, or nothing at all."""
    n = int(rng.choice(LENGTHS))
    t = np.arange(n)
    y = np.full(n, rng.choice([0.0, 5.0, 200.0, 60_000.0]))
    for _ in range(rng.integers(0, 5)):
        at, rise, fall = rng.uniform(-4.0, n + 3.0), rng.uniform(0.3, 5.0), rng.uniform(0.3, 16.0)
        if rng.random() < 0.5:
            rise, fall = fall, rise
        high = rng.choice([10.0, 300.0, 10_000.0, 90_000.0])
        y += high * np.exp(-0.5 * ((t - at) / np.where(t < at, rise, fall)) ** 2)
    if rng.random() < 0.2:
        y += np.where(t < rng.integers(0, n + 1), 900.0, 0.0)
    if rng.random() < 0.2:
        y[rng.random(n) < 0.3] = 65535.0
    return np.clip(np.rint(y + rng.normal(0.0, rng.choice([0.0, 0.5, 30.0]), n)), 0, 65535).astype(np.uint16)


COLOURED = tuple(
    Channel(step, 65535.0, 5.0, 1.0, 2.0, 20.0, 65535.0, phi, growth, misfit=misfit)
    for step, phi, growth, misfit in (
        (0.5, (0.5, 0.1, -0.2, 0.3), 0.0, 1.0),
        (1.0, (-0.6,), 0.2, 1.1),
        (2.0, (1.4, -0.5), 1e4, None),
    )
)
"""Receivers whose noise is correlated, and grows with the signal; what echoes leave is known of two."""


def evaluate_anywhere() -> None:
    """The model at times and widths that no fit should ask for."""
    n, look = 12, lookup(long_pulse(), 1.0, PARAMS.narrowest, PARAMS.widest)
    size = n + look.before + look.after + 4
    y, weight, residual = np.zeros(size), np.ones(size), np.zeros(size)
    basis, window = np.empty((1, 3, look.table.shape[2])), np.zeros((1, 4), np.int64)
    for t in (np.nan, -np.inf, -1e12, -60.0, -2.001, 0.5, n + 1.001, n + 60.0, 1e12, np.inf):
        for s in (-1e9, 0.0, 1.0, 3.0, 1e9, np.inf):
            p, pad = np.array([0.0, 5.0, t, s]), look.before + 2
            lay(p, 1, y, pad, n, look, residual, basis, window)
            assert 0 <= window[0, 0] <= window[0, 1] <= size
            evaluate(p, 1, y, weight, pad, n, look, moments(y, weight, pad, n), residual, basis, window)
            assert 0 <= window[0, 0] <= window[0, 1] <= size


def match_anywhere(batch: list, rng: np.random.Generator) -> None:
    """Waveforms stacked around any sample that leaves the window inside, in groups of any members."""
    long = [k for k, one in enumerate(batch) if len(one) > 20]
    if not long:
        return
    offsets = np.concatenate([[0], np.cumsum([len(one) for one in batch])]).astype(np.int64)
    white, half = np.concatenate(batch).astype(np.float64), rng.uniform(0.6, 9.0)
    at = np.array([rng.uniform(half, len(batch[k]) - 1 - half) for k in long])
    shape, lags = rng.normal(size=int(rng.integers(2, 200))), np.linspace(-5.0, 5.0, int(rng.integers(1, 12)))
    found = [np.empty((len(long), len(lags))) for _ in range(3)]
    match_around(white, offsets, np.array(long), at, half, shape, 16, float(rng.uniform(-9.0, 9.0)), lags, *found)
    members = rng.integers(-1, len(long), (7, 9))
    stack_groups(members, *found, rng.uniform(0.0, 2.0, len(long)), np.empty((7, 6)))


def tables_once() -> None:
    """Tables of profiles are made once for every pulse and spacing: they take most of the time, and are not tried."""
    made: dict = {}

    def kept(make):  # type: ignore[no-untyped-def]
        def table(pulse, *words):  # type: ignore[no-untyped-def]
            key = make.__name__, pulse.shape, pulse.fwhm, pulse.first, pulse.step, pulse.values.tobytes(), words
            if key not in made:
                made[key] = make(pulse, *words)
            return made[key]

        return table

    fitting.lookup, fitting.widths_of = kept(fitting.lookup), kept(fitting.widths_of)


MANY_INPUTS = 5000
"""From so many on the settings that look for ever weaker echoes, a hundred times as long, get every 20th batch."""


def drive(inputs: int, seed: int) -> int:
    rng = np.random.default_rng(seed)
    tables_once()
    evaluate_anywhere()
    fit_waveforms(waves([np.array(WIDE_AT_THE_EDGE)]), PARAMS, long_pulse())
    many = DecomposeParams(**(BASE["decompose"] | MANY))
    few = DecomposeParams(**(BASE["decompose"] | {"max_echoes": 1, "narrowest": 0.05}))
    pulses = (long_pulse(), long_pulse(8.0, 60.0), long_pulse(60.0, 5.0), *map(SystemPulse.gaussian, (0.7, 2.0, 60.0)))
    pulses += tuple(replace(p, channels=COLOURED) for p in pulses)
    for number, done in enumerate(range(0, inputs, 50)):
        batch = [samples(rng) for _ in range(min(inputs - done, 50))]
        for w in ([one] for one in batch[:3]):
            fit_waveforms(waves(w), PARAMS, long_pulse())
        pulse, rare = pulses[number % len(pulses)], inputs >= MANY_INPUTS and number % 20 > 0
        for params in (PARAMS, many, few) if inputs > 100 and not rare else (PARAMS,):
            fit_waveforms(waves(batch, float(rng.choice([0.5, 1.0, 2.0]))), params, pulse)
        if not rare:
            for method in ("gold", "richardson-lucy"):
                asked = SampleParams(**BASE["samples"] | {"method": method, "iterations": 3})
                backscatter_samples(waves(batch), 0, asked, PARAMS, pulse, AS_STORED)
            match_anywhere(batch, rng)
            step = float(rng.choice([0.5, 1.0, 2.0]))
            with_water(fit_waveforms(waves(batch, step), PARAMS, pulse), waves(batch, step), PARAMS, pulse, WATER)
            estimated = estimate_pulse(waves(batch), PulseParams(**BASE["pulse"] | {"min_echoes": 8}))
            estimated = with_correlated_noise(estimated, waves(batch), PARAMS)
            with_misfit(with_signal_noise(estimated, waves(batch), PARAMS)[0], waves(batch), PARAMS)
    for rows in (0, 1, 2, 9):
        pulse, xyz, found = np.sort(rng.integers(0, 4, rows)), rng.normal(0, 1e300, (rows, 3)), np.empty(rows, np.int64)
        nearest_of_pulse(pulse, xyz, pulse[: rows // 2], xyz * np.nan, found)
        rank_in_pulse(pulse, np.empty(rows, np.int64), found)
    return inputs
