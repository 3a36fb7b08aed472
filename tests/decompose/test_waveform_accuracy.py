"""The fit against what theory allows. Every limit is the asked figure plus three sampling errors of the test's sample.

Fast tests take a few thousand waveforms; the slow ones take enough to see the asked figure itself.
"""

from __future__ import annotations

import numpy as np
import pytest
import wavemaker as wm
from scipy.stats import binom, norm

from fwclass.decompose.fitting import fit_waveforms
from fwclass.decompose.params import DecomposeParams
from fwclass.decompose.system_pulse import Channel, SystemPulse

HALF = 0.5 * wm.PULSE_WIDTH
ALONE = SystemPulse.gaussian(wm.PULSE_WIDTH)
# noise uniform from 1 to 2 DN has a coefficient of variation of the variance as 18 degrees of freedom have
KNOWN = SystemPulse("gaussian", wm.PULSE_WIDTH, channels=(Channel(1.0, 255.0, 10.0, 0.05, 1.5, 18.0, 255.0),))
RECEIVERS = pytest.mark.parametrize("pulse", [ALONE, KNOWN], ids=["alone", "known-receiver"])


def sizes(few, many):
    """A fast sample, and a slow one."""
    return pytest.mark.parametrize("n", [few, pytest.param(many, marks=pytest.mark.slow)])


@pytest.fixture(scope="module")
def params(base):
    return DecomposeParams(**{**base["decompose"], "tail_share": 0.0})


def clear(truth, ratio):
    """Waveforms whose echoes all reach `ratio` times the noise, without saturation."""
    least = np.minimum.reduceat(truth.ratio, np.cumsum(truth.count) - truth.count)
    return (least >= ratio) & ~truth.clipped


def counted(truth, fits, wrong):
    """Clear waveforms (A/sigma >= 20) with the right number of echoes; at most a share of `wrong` has another.

    Errors are judged on these: a false split moves its echo by many standard errors, so that 0.2 % of them would by
    themselves double the root mean square.
    """
    use = clear(truth, 20.0)
    missed = (fits.count != truth.count) & use
    assert at_most(missed.sum(), use.sum(), wrong), missed.sum() / use.sum()
    return use & ~missed


def at_most(hits, n, share):
    """`hits` of `n` are no evidence (1e-3) that the share is above `share`."""
    return hits <= binom.ppf(0.999, n, share)


@RECEIVERS
@sizes(6000, 100_000)
def test_isolated_echoes_reach_the_cramer_rao_bound(params, pulse, n):
    """RMSE / bound <= 1.02, standardised errors 1.00 +- 0.03, no bias, for A/sigma >= 20 and widths of 1 to 1.6."""
    waves, truth = wm.mix(n, (1.0,), amplitude=(20, 200), seed=31)
    fits = fit_waveforms(waves, params, pulse)
    i, error, sigma = wm.errors(truth, fits, HALF)
    use = counted(truth, fits, 0.002)[truth.row[i]]
    bound = wm.bounds(truth)[i]
    ratio, sd = wm.rms((error / bound)[use])
    assert (ratio <= 1.02 + 3 * sd).all(), (ratio, sd)
    assert (ratio >= 0.85).all(), "better than the bound: the bound would be wrong"
    standard, sd = wm.rms((error / sigma)[use])
    assert (np.abs(standard - 1.0) <= 0.03 + 3 * sd).all(), (standard, sd)
    bias = (error / bound)[use].mean(axis=0)
    assert (np.abs(bias) < 0.05 + 3 / np.sqrt(use.sum())).all(), bias


@RECEIVERS
@sizes(4000, 60_000)
def test_pairs_five_to_eight_ns_apart(params, pulse, n):
    """RMSE / bound <= 1.10 and honest standard errors, both echoes of the system's width, A/sigma >= 20."""
    waves, truth = wm.mix(n, (0.0, 1.0), amplitude=(25, 120), gap=(5, 8), widest=1.0, seed=32)
    fits = fit_waveforms(waves, params, pulse)
    i, error, sigma = wm.errors(truth, fits, HALF)
    use = counted(truth, fits, 0.005)[truth.row[i]]
    ratio, sd = wm.rms((error / wm.bounds(truth)[i])[use])
    assert (ratio <= 1.10 + 3 * sd).all() and (sd < 0.2).all(), (ratio, sd)
    standard, sd = wm.rms((error / sigma)[use])
    assert (np.abs(standard - 1.0) <= 0.03 + 3 * sd).all(), (standard, sd)


@sizes(8000, 60_000)
@pytest.mark.parametrize(("maker", "least", "false"), [(wm.survey_mix, 0.97, 0.015), (wm.hard_mix, 0.92, 0.04)])
def test_completeness(params, maker, least, false, n):
    """All true echoes count, found within half a pulse width, one to one. The rest of the fitted are false."""
    waves, truth = maker(n, seed=33)
    fits = fit_waveforms(waves, params, KNOWN)
    i, _ = wm.match(truth, fits, HALF)
    sd = np.sqrt(least * (1 - least) / len(truth.row))
    assert len(i) / len(truth.row) >= least - 3 * sd
    assert (len(fits.row) - len(i)) / n <= false
    assert (fits.count == np.bincount(fits.row, minlength=n)).all()


def test_detection_follows_theory(params):
    """A matched filter sees an isolated echo of height A with A / sd(A) = A (sqrt(pi) s)^(1/2) / noise: the share found
    is that of a normal variable above the threshold. The peak is sought over several samples, which helps a little."""
    n, sigma = 4000, wm.PULSE_WIDTH / wm.FWHM
    for ratio in (2.0, 2.5, 3.0, 3.5, 4.0, 5.0):
        waves, truth = wm.fixed(n, [ratio * 1.5], noise=1.5, first=30.0, seed=34)
        found = len(wm.match(truth, fit_waveforms(waves, params, KNOWN), HALF)[0]) / n
        height = ratio * 1.5 / np.sqrt(1.5**2 + 1 / 12) * np.sqrt(np.sqrt(np.pi) * sigma)
        # at most one standard deviation lost to the fit's freedom and to a threshold raised against false echoes
        assert (
            norm.cdf(height - params.detection - 1.0) - 0.02
            <= found
            <= norm.cdf(height - params.detection + 0.7) + 0.02
        )


@sizes(2000, 10_000)
@pytest.mark.parametrize(("gap", "ratio", "noise"), [(2.5, 50, 1.5), (2.0, 100, 1.0)])
@RECEIVERS
def test_close_equal_pairs_are_resolved(params, pulse, gap, ratio, noise, n):
    """Two equal echoes closer than the pulse is wide (3.5 ns), with no second maximum: >= 95 % of the waveforms."""
    waves, truth = wm.fixed(n, [ratio * noise] * 2, gap=gap, noise=noise, seed=35)
    fits = fit_waveforms(waves, params, pulse)
    i, _ = wm.match(truth, fits, HALF)
    both = (fits.count == 2) & (np.bincount(truth.row[i], minlength=n) == 2)
    assert at_most((~both).sum(), n, 0.05), both.mean()


@sizes(2000, 40_000)
@pytest.mark.parametrize("factor", [1.0, 1.5, 2.0, 2.5])
@pytest.mark.parametrize("ratio", [20, 50, 100])
def test_single_echoes_stay_single(params, ratio, factor, n):
    """<= 0.2 % of single echoes are split, whatever their width and height."""
    waves, _ = wm.fixed(n, [1.5 * ratio], width=factor * wm.PULSE_WIDTH, first=30.0, seed=36)
    count = fit_waveforms(waves, params, KNOWN).count
    assert (count >= 1).all()
    assert at_most((count > 1).sum(), n, 0.002), (count > 1).mean()


@sizes(30_000, 300_000)
@RECEIVERS
def test_noise_makes_no_echoes(params, pulse, n):
    """<= 2e-4 false echoes per waveform with the receiver known, as every command has it; else a waveform's own noise
    is the only measure, and twice as many."""
    waves, _ = wm.noise_only(n, seed=37)
    count = fit_waveforms(waves, params, pulse).count
    assert at_most(count.sum(), n, 2e-4 if pulse.channels else 4e-4), count.mean()


@sizes(3000, 40_000)
@pytest.mark.parametrize(
    ("shape", "asked"), [(wm.skewed(), 0.002), (wm.ringing(), 0.01)], ids=["tail-0.9-ns", "ringing-3-percent"]
)
def test_the_true_pulse_needs_no_second_echo(params, shape, asked, n):
    """Bright single echoes of a pulse that is not Gaussian, fitted with that pulse; with a Gaussian for contrast."""
    t, h = shape.values(0.05)
    given = SystemPulse("measured", shape.fwhm, first=float(t[0]), step=0.05, values=h, channels=KNOWN.channels)
    waves, truth = wm.mix(n, (1.0,), amplitude=(75, 200), noise=(1.5, 1.5), pulse=shape, seed=38)
    fits = fit_waveforms(waves, params, given)
    assert at_most((fits.count > 1).sum(), n, asked), (fits.count > 1).mean()
    wrong = SystemPulse("gaussian", shape.fwhm, channels=KNOWN.channels)
    assert (fit_waveforms(waves, params, wrong).count > 1).mean() > 0.05
    _, error, sigma = wm.errors(truth, fits, HALF)
    standard, sd = wm.rms((error / sigma)[:, :2])  # the width of such a pulse is not 2.3548 sigma
    assert (np.abs(standard - 1.0) <= 0.03 + 3 * sd).all(), (standard, sd)
    assert np.abs((error / sigma)[:, :2].mean(axis=0)).max() < 0.1


def test_bounds_hold_for_other_spacings_and_depths(params):
    """The same echoes at 0.5 ns and 16 bits, at 2 ns and 8 bits."""
    for spacing, bits, samples, scale in ((0.5, 16, 144, 20.0), (2.0, 8, 40, 1.0)):
        waves, truth = wm.fixed(
            4000,
            [90.0 * scale],
            width=4.0,
            spacing=spacing,
            bits=bits,
            samples=samples,
            noise=1.5 * scale,
            baseline=15.0 * scale,
            seed=39,
        )
        fits = fit_waveforms(waves, params, ALONE)
        assert at_most((fits.count > 1).sum(), 4000, 0.005)
        i, error, sigma = wm.errors(truth, fits, HALF)
        ratio, sd = wm.rms(error / wm.bounds(truth)[i])
        assert (ratio <= 1.02 + 3 * sd).all(), (spacing, ratio, sd)
        standard, sd = wm.rms(error / sigma)
        assert (np.abs(standard - 1.0) <= 0.03 + 3 * sd).all(), (spacing, standard, sd)


def test_the_bound_is_that_of_the_model():
    """Fisher information by numerical derivatives of another implementation of the model."""
    p = np.array([10.0, 90.0, 20.3, 1.5, 60.0, 26.0, 1.9])
    t = np.arange(72.0)

    def model(q):
        return q[0] + sum(q[k] * np.exp(-((t - q[k + 1]) ** 2) / (2 * q[k + 2] ** 2)) for k in (1, 4))

    step = 1e-5 * np.eye(len(p))
    j = np.array([(model(p + s) - model(p - s)) / 2e-5 for s in step])
    expected = np.sqrt(np.diag(np.linalg.inv(j @ j.T / (1.5**2 + 1 / 12))))
    found = wm.crb(p[1::3], p[2::3], p[3::3], 1.5)[0]
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    # far from everything, the textbook value: var(t) = 2 s sigma^2 / (sqrt(pi) A^2) for unit spacing
    one = wm.crb([100.0], [40.0], [1.5], 1.5, samples=80)[0]
    np.testing.assert_allclose(one[2], np.sqrt(2 * 1.5 * (1.5**2 + 1 / 12) / np.sqrt(np.pi)) / 100.0, rtol=1e-3)


def test_the_maker_of_waveforms_makes_what_it_says():
    """Mean of many noisy records is the model, their spread the noise; truth is ordered; a perfect fit matches."""
    waves, truth = wm.fixed(4000, [100.0, 40.0], gap=7.0, noise=2.0, seed=40, pulse=wm.skewed())
    y = waves.samples.reshape(4000, -1).astype(float)
    assert abs(y[:, :8].mean() - 10.0) < 0.05 and abs(y[:, :8].std() - np.sqrt(4 + 1 / 12)) < 0.03
    area = (y - 10.0).sum(axis=1).mean()
    np.testing.assert_allclose(area, truth.energy.reshape(-1, 2).sum(axis=1).mean(), rtol=0.005)
    waves, truth = wm.hard_mix(500, seed=41)
    assert (np.lexsort((truth.time, truth.row)) == np.arange(len(truth.row))).all()
    i, j = wm.match(truth, truth, 0.1)
    assert len(i) == len(truth.row) and (i == j).all()
