"""Waveform decomposition beside curve_fit and gdecomp, and against what theory allows, on one thread.

``python tests/bench/bench_waveforms.py [--quick] [--json]``

Every line gives a figure, its sampling error (one standard deviation), and what is asked of it. An echo is found if a
fitted one lies within half a pulse width (1.75 ns), one to one, nearest first; the rest of the fitted are false.
Completeness counts every true echo, the undetectable ones (5 DN under a noise of 2 DN, 1 ns beside a bright one) too.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.optimize import curve_fit
from scipy.signal import find_peaks

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))

import wavemaker as wm  # noqa: E402
import woodmaker  # noqa: E402
from watermaker import Score, lake, scored  # noqa: E402

from fwclass.classes import BUILDING, WATER  # noqa: E402
from fwclass.decompose.fitting import fit_waveforms  # noqa: E402
from fwclass.decompose.params import BathymetryParams, DecomposeParams, PulseParams, StackParams  # noqa: E402
from fwclass.decompose.placement import AS_STORED  # noqa: E402
from fwclass.decompose.plane_surface import planar, plane_surface  # noqa: E402
from fwclass.decompose.pulse_estimate import estimate_pulse  # noqa: E402
from fwclass.decompose.pulse_sample import join_samples  # noqa: E402
from fwclass.decompose.quiet import with_correlated_noise  # noqa: E402
from fwclass.decompose.signal_noise import with_misfit, with_signal_noise  # noqa: E402
from fwclass.decompose.stack_candidates import Surface, candidates  # noqa: E402
from fwclass.decompose.stacking import stack  # noqa: E402
from fwclass.decompose.stage import decompose  # noqa: E402
from fwclass.decompose.system_pulse import SystemPulse  # noqa: E402
from fwclass.errors import FwclassError  # noqa: E402
from fwclass.grid import Box, Window  # noqa: E402
from fwclass.read.params import ReadParams  # noqa: E402
from fwclass.read.source import open_source  # noqa: E402
from fwclass.read.stage import index_source, read_span  # noqa: E402
from fwclass.single_file.decompose import decompose_file  # noqa: E402
from fwclass.units import METRES_PER_NS  # noqa: E402

BASE = yaml.safe_load((ROOT / "conf" / "base.yaml").read_text())
PARAMS = DecomposeParams(**BASE["decompose"])
ALL = DecomposeParams(**{**BASE["decompose"], "tail_share": 0.0})
"""As delivered, but echoes after a brighter one are kept whatever their height."""
PULSE = PulseParams(**BASE["pulse"])
GAUSSIAN = SystemPulse.gaussian(wm.PULSE_WIDTH)
RECEIVER = ", receiver estimated"
"""Lines with this in their name: as a survey is processed, its receiver's level and noise estimated beforehand."""
HALF = 0.5 * wm.PULSE_WIDTH
NAMES = ("A", "t", "width")


@cache
def receiver() -> SystemPulse:
    """The Gaussian pulse with the receiver that `estimate_pulse` sees in 20 000 waveforms of a survey."""
    waves, _ = wm.survey_mix(20_000, seed=2)
    return with_misfit(replace(GAUSSIAN, channels=estimate_pulse(waves, PULSE).channels), waves, PARAMS)


def both_ways() -> tuple[tuple[str, SystemPulse], ...]:
    return ("", GAUSSIAN), (RECEIVER, receiver())


@dataclass
class Figure:
    """One line of the table."""

    group: str
    name: str
    value: float
    error: float = np.nan
    asked: str = ""
    note: str = ""

    @property
    def verdict(self) -> str:
        """Whether `asked` is met; "?" where two sampling errors could change that."""
        if not self.asked or np.isnan(self.value):
            return ""
        if self.asked.startswith("1.00"):
            within = float(self.asked.split()[-1])
            low, high = 1.0 - within, 1.0 + within
        else:
            bound = float(self.asked.split()[1])
            low, high = (bound, np.inf) if self.asked.startswith(">=") else (-np.inf, bound)
        slack = 0.0 if np.isnan(self.error) else 2.0 * self.error
        if low <= self.value <= high:
            return "yes"
        return "?" if low <= self.value + slack and self.value - slack <= high else "NO"


def share(group: str, name: str, hits: NDArray, asked: str = "", note: str = "") -> Figure:
    """A mean of counts per item, with its sampling error (that of one count at least)."""
    hits = np.asarray(hits, float)
    error = max(hits.std() / np.sqrt(len(hits)), 1.0 / len(hits))
    return Figure(group, name, float(hits.mean()), float(error), asked, note)


def spread(group: str, name: str, standard: NDArray, asked: str = "") -> Figure:
    """Root mean square of standardised errors, with its sampling error (from their own fourth moment)."""
    square = standard**2
    value = np.sqrt(square.mean())
    return Figure(group, name, float(value), float(square.std() / np.sqrt(len(square)) / (2 * value)), asked)


def paired(
    waves: Any, truth: wm.Truth, pulse: SystemPulse, params: DecomposeParams = ALL
) -> tuple[Any, NDArray, NDArray, NDArray]:
    """(fits, indices of truth, of fits, errors (pairs, 3) of A, t, width)."""
    fits = fit_waveforms(waves, params, pulse)
    i, j = wm.match(truth, fits, HALF)
    error = np.stack([getattr(fits, n)[j] - getattr(truth, n)[i] for n in ("amplitude", "time", "width")], axis=1)
    return fits, i, j, error


def errors_of(fits: Any, j: NDArray) -> NDArray:
    return np.stack([fits.amplitude_sigma[j], fits.time_sigma[j], fits.width_sigma[j]], axis=1)


# ---------------------------------------------------------------------------------------------------------- peers
class Model:
    """Sum of Gaussians over a level for curve_fit; the exponentials are shared by model and Jacobian."""

    def __init__(self, t: NDArray) -> None:
        self.t, self.last = t, np.empty(0)

    def _basis(self, p: NDArray) -> None:
        if not np.array_equal(p, self.last):
            self.last = p.copy()
            self.d = (self.t[:, None] - p[2::3]) / p[3::3]
            self.g = np.exp(-0.5 * self.d * self.d)

    def value(self, _t: NDArray, *p: float) -> NDArray:
        v = np.asarray(p)
        self._basis(v)
        return v[0] + self.g @ v[1::3]

    def slope(self, _t: NDArray, *p: float) -> NDArray:
        v = np.asarray(p)
        self._basis(v)
        out = np.empty((len(self.t), len(v)))
        out[:, 0] = 1.0
        out[:, 1::3] = self.g
        out[:, 2::3] = self.g * self.d * (v[1::3] / v[3::3])
        out[:, 3::3] = out[:, 2::3] * self.d
        return out


def curve_fits(rows: NDArray, starts: list[NDArray]) -> list[NDArray]:
    """What `curve_fit` makes of every waveform from its `starts`; the start itself where it gives up."""
    t = np.arange(rows.shape[1], dtype=float)
    model, found = Model(t), []
    for y, p in zip(rows, starts, strict=True):
        try:
            found.append(curve_fit(model.value, t, y, p, jac=model.slope, maxfev=200)[0])
        except (RuntimeError, np.linalg.LinAlgError):
            found.append(p)
    return found


def true_starts(rows: NDArray, truth: wm.Truth) -> list[NDArray]:
    """The right number of echoes, at the nearest samples, with their recorded heights and the pulse's width."""
    starts = []
    for i, y in enumerate(rows):
        at = np.rint(truth.time[truth.row == i])
        each = np.c_[np.maximum(y[at.astype(int)] - 10.0, 1.0), at, np.full(len(at), wm.PULSE_WIDTH / wm.FWHM)]
        starts.append(np.r_[10.0, each.ravel()])
    return starts


def peak_starts(rows: NDArray, noise: NDArray) -> list[NDArray]:
    """As `true_starts`, from `find_peaks` told the level and the noise."""
    starts = []
    for y, sd in zip(rows, noise, strict=True):
        at, _ = find_peaks(y, height=10.0 + PARAMS.detection * sd, prominence=3.0 * sd, distance=2)
        each = np.c_[y[at] - 10.0, at, np.full(len(at), wm.PULSE_WIDTH / wm.FWHM)]
        starts.append(np.r_[10.0, each.ravel()])
    return starts


@dataclass
class Flat:
    row: NDArray
    time: NDArray


def flat(times: list[NDArray]) -> Flat:
    return Flat(np.repeat(np.arange(len(times)), [len(t) for t in times]), np.concatenate([np.sort(t) for t in times]))


def head(truth: wm.Truth, n: int) -> wm.Truth:
    """Truth of the first `n` waveforms."""
    m = truth.row < n
    cut = {k: getattr(truth, k)[m] for k in ("row", "amplitude", "time", "sigma", "energy", "gap")}
    per = {k: getattr(truth, k)[:n] for k in ("noise", "baseline", "count", "clipped")}
    return wm.Truth(**cut, **per, samples=truth.samples, spacing=truth.spacing, saturation=truth.saturation)


def _gdecomp(rows: NDArray, noise: NDArray, answer: Any) -> None:
    import gdecomp

    start = time.process_time()
    made = [gdecomp.GaussianDecomposition(y, thres=PARAMS.detection * sd) for y, sd in zip(rows, noise, strict=True)]
    answer.put((time.process_time() - start, [np.reshape(m, (-1, 3))[:, 1] for m in made]))


def gdecomp_run(rows: NDArray, noise: NDArray, limit: float = 60.0) -> tuple[float, list[NDArray]] | str:
    """Seconds and times, or why there are none; in a process of its own, since it can run for ever."""
    try:
        import gdecomp  # noqa: F401
    except ImportError:
        return "not installed"
    context = multiprocessing.get_context("spawn")
    answer = context.Queue()
    child = context.Process(target=_gdecomp, args=(rows, noise, answer), daemon=True)
    child.start()
    try:
        return answer.get(timeout=limit)
    except Exception:
        return f"no end within {limit:.0f} s"
    finally:
        child.terminate()
        child.join()


# ---------------------------------------------------------------------------------------------------------- figures
def speed(scale: float) -> list[Figure]:
    """Waveforms per CPU second, every repeat beside the peers; and what each of them finds."""
    out = []
    n, few, repeats = int(60_000 * scale) + 2000, int(400 * scale) + 150, 5 if scale >= 1 else 3
    for name, maker, least, ratio in (
        ("survey mix", wm.survey_mix, ">= 150000", ">= 80"),
        ("hard mix", wm.hard_mix, ">= 40000", ""),
    ):
        waves, truth = maker(n, seed=11)
        rows = waves.samples.reshape(n, -1)[:few].astype(float)
        small, starts = head(truth, few), true_starts(rows, truth)
        found = peak_starts(rows, truth.noise[:few])
        rates: dict[str, list[float]] = {k: [] for k in ("ours", "receiver", "stage", "curve_fit")}
        for _ in range(repeats):
            for key, count, work in (
                ("ours", n, lambda w=waves: fit_waveforms(w, PARAMS, GAUSSIAN)),
                ("receiver", n, lambda w=waves: fit_waveforms(w, PARAMS, receiver())),
                ("stage", n, lambda w=waves: decompose(w, 1, PARAMS, receiver())),
                ("curve_fit", few, lambda r=rows, s=starts: curve_fits(r, s)),
            ):
                begin = time.process_time()
                work()
                rates[key].append(count / (time.process_time() - begin))
        rate = {k: float(np.median(v)) for k, v in rates.items()}
        sd = {k: float(np.std(v) / np.sqrt(repeats)) for k, v in rates.items()}
        quotient = np.array(rates["ours"]) / np.array(rates["curve_fit"])
        out += [
            Figure(name, "fit_waveforms [waveforms/s]", rate["ours"], sd["ours"], least),
            Figure(name, "  receiver estimated", rate["receiver"], sd["receiver"]),
            Figure(name, "stage decompose [waveforms/s]", rate["stage"], sd["stage"]),
            Figure(name, "curve_fit, true starts [waveforms/s]", rate["curve_fit"], sd["curve_fit"]),
            Figure(name, "  ratio", float(np.median(quotient)), float(quotient.std() / np.sqrt(repeats)), ratio),
        ]
        made = [("curve_fit from find_peaks", flat([p[2::3] for p in curve_fits(rows, found)]))]
        other = gdecomp_run(rows - 10.0, truth.noise[:few])
        if isinstance(other, str):
            out.append(Figure(name, f"gdecomp: {other}", np.nan))
        else:
            out.append(Figure(name, "gdecomp [waveforms/s]", few / other[0]))
            out.append(Figure(name, "  ratio", rate["ours"] * other[0] / few))
            made.append(("gdecomp", flat(other[1])))
        for label, got in made:
            out += [
                share(name, f"completeness, {label}", hits_of(small, got)),
                share(name, f"false echoes per waveform, {label}", false_of(small, got)),
            ]
    return out


def hits_of(truth: wm.Truth, got: Any) -> NDArray:
    hit = np.zeros(len(truth.row), bool)
    hit[wm.match(truth, got, HALF)[0]] = True
    return hit


def false_of(truth: wm.Truth, got: Any) -> NDArray:
    """False echoes of every waveform."""
    spare = np.ones(len(got.row), bool)
    spare[wm.match(truth, got, HALF)[1]] = False
    return np.bincount(np.asarray(got.row)[spare], minlength=len(truth.count))


def completeness(scale: float) -> list[Figure]:
    out = []
    for name, maker, least in (("survey mix", wm.survey_mix, ">= 0.97"), ("hard mix", wm.hard_mix, ">= 0.92")):
        waves, truth = maker(int(60_000 * scale), seed=12)
        for label, params, pulse in (
            ("as delivered", PARAMS, receiver()),
            ("tail_share 0", ALL, receiver()),
            ("no receiver", ALL, GAUSSIAN),
        ):
            fits = fit_waveforms(waves, params, pulse)
            hit = hits_of(truth, fits)
            out.append(share(name, f"completeness, all echoes, {label}", hit, least))
            if label == "tail_share 0":
                fair = (truth.ratio >= 4.0) & (truth.gap >= 2.5)
                out.append(share(name, "completeness, A/σ >= 4 and gap >= 2.5 ns", hit[fair]))
            out.append(share(name, f"false echoes per waveform, {label}", false_of(truth, fits)))
    return out


def at_the_bound(scale: float) -> list[Figure]:
    """Errors over the Cramér-Rao bound (free baseline, known noise), and over the reported standard errors.

    Of waveforms with the right number of echoes: a false split moves its echo by many standard errors, so that the
    0.2 % of them that are allowed would by themselves double the root mean square. Their share has its own line.
    """
    out, n = [], int(40_000 * scale)
    cases = (
        ("isolated, A/σ >= 20", wm.mix(n, (1.0,), amplitude=(20, 200), seed=13), "<= 1.02"),
        ("gap 5-8 ns, system width", wm.mix(n, (0, 1), amplitude=(20, 120), gap=(5, 8), widest=1, seed=14), "<= 1.10"),
        ("gap 5-8 ns, width 1-1.6", wm.mix(n, (0, 1), amplitude=(20, 120), gap=(5, 8), seed=15), ""),
    )
    for name, (waves, truth), asked in cases:
        clear = (np.minimum.reduceat(truth.ratio, np.cumsum(truth.count) - truth.count) >= 20) & ~truth.clipped
        bound = wm.bounds(truth)
        for label, pulse in both_ways():
            fits, i, j, error = paired(waves, truth, pulse)
            right = (fits.count == truth.count) & clear
            out.append(share(name, f"wrong number of echoes{label}", fits.count[clear] != truth.count[clear]))
            every = spread(
                name, f"  RMSE/CRB of t, wrong numbers too{label}", (error / bound[i])[clear[truth.row[i]], 1]
            )
            use = right[truth.row[i]]
            i, j, error = i[use], j[use], error[use]
            for c in range(3):
                out.append(spread(name, f"RMSE/CRB of {NAMES[c]}{label}", error[:, c] / bound[i, c], asked))
            out.append(every)
            standard = error / errors_of(fits, j)
            for c in range(3):
                out.append(spread(name, f"standardised {NAMES[c]}{label}", standard[:, c], "1.00 +- 0.03"))
    for name, maker in (("survey mix", wm.survey_mix), ("hard mix", wm.hard_mix)):
        waves, truth = maker(n, seed=16)
        fits, i, j, error = paired(waves, truth, GAUSSIAN)
        right = (fits.count == truth.count)[truth.row[i]] & ~truth.clipped[truth.row[i]]
        right &= (truth.ratio[i] >= 10) & (truth.gap[i] >= 5)
        standard = error[right] / errors_of(fits, j[right])
        for c in range(3):
            out.append(spread(name, f"standardised {NAMES[c]}, A/σ >= 10, gap >= 5 ns, right count", standard[:, c]))
    return out


def resolution(scale: float) -> list[Figure]:
    out, n = [], int(10_000 * scale)
    for gap, ratio, asked in ((2.5, 50, ">= 0.95"), (2.0, 100, ">= 0.95"), (3.0, 20, ""), (4.0, 10, "")):
        noise = 1.5 if ratio <= 50 else 1.0
        for label, pulse in both_ways():
            waves, truth = wm.fixed(n, [ratio * noise] * 2, gap=gap, noise=noise, seed=17)
            fits, i, _, _ = paired(waves, truth, pulse)
            both = (fits.count == 2) & (np.bincount(truth.row[i], minlength=n) == 2)
            out.append(share(f"equal pair {gap} ns, A/σ {ratio}", f"resolved{label}", both, asked))
    return out


def false_splits(scale: float) -> list[Figure]:
    """Share of single echoes taken for several, by width and height."""
    out, n = [], int(20_000 * scale)
    for ratio in (20, 50, 100):
        for factor in (1.0, 1.5, 2.0, 2.5):
            waves, _ = wm.fixed(n, [1.5 * ratio], width=factor * wm.PULSE_WIDTH, first=30.0, seed=18)
            name = f"false splits, A/σ {ratio}, {factor} x width"
            for label, pulse in both_ways():
                fits = fit_waveforms(waves, ALL, pulse)
                out.append(share("single echo", name + label, fits.count > 1, "<= 0.002"))
    return out


def noise(scale: float) -> list[Figure]:
    """False echoes where there is nothing."""
    out, n = [], int(300_000 * scale)
    waves, _ = wm.noise_only(n, seed=19)
    for label, pulse in both_ways():
        got = fit_waveforms(waves, ALL, pulse).count
        out.append(share("noise only", f"false echoes per waveform{label}", got, "<= 2e-4"))
    waves, _ = wm.noise_only(n // 2, noise=0.6, bits=16, samples=160, baseline=200.0, seed=20)
    got = fit_waveforms(waves, ALL, GAUSSIAN).count
    out.append(share("noise only", "  160 samples, noise 0.6 DN", got, note="2.2 x as many samples"))
    return out


def other_pulses(scale: float) -> list[Figure]:
    """Single echoes of a pulse that is not Gaussian: waveforms with a false second echo."""
    out, n = [], int(20_000 * scale)
    for name, pulse, asked in (
        ("tail 0.9 ns", wm.skewed(), "<= 0.002"),
        ("ringing 3 % at 10 ns", wm.ringing(), "<= 0.01"),
    ):
        step = 0.05
        t, h = pulse.values(step)
        given = SystemPulse("measured", pulse.fwhm, first=float(t[0]), step=step, values=h)
        for bits, heights in ((8, (75.0, 200.0)), (8, (5.0, 200.0)), (16, (300.0, 3000.0))):
            top = {"bits": bits, "amplitude": heights, "pulse": pulse}
            training, _ = wm.survey_mix(int(40_000 * scale) + 4000, seed=21, **top)
            waves, _ = wm.mix(n, (1.0,), widest=1.0, noise=(1.5, 1.5), seed=22, **top)
            estimated = estimate_pulse(training, PULSE)
            for shape, what, wish in (
                (SystemPulse.gaussian(pulse.fwhm), "Gaussian fit", ""),
                (given, "true pulse", asked),
                (estimated, f"estimated ({estimated.shape})", asked),
            ):
                got = fit_waveforms(waves, ALL, shape).count
                label = f"two echoes, {bits} bit, A {heights[0]:.0f}-{heights[1]:.0f} DN, {what}"
                out.append(share(name, label, got > 1, wish))
    return out


def asked(waves: Any) -> SystemPulse:
    """The pulse and receiver as the stage `pulse` sees them in a survey."""
    pulse = with_correlated_noise(estimate_pulse(waves, PULSE), waves, PARAMS)
    return with_misfit(with_signal_noise(pulse, waves, PARAMS)[0], waves, PARAMS)


def real_noise() -> dict[str, tuple[float, ...]]:
    """Coefficients of the noise of the real files in ../shared/data/waveform, where they are."""
    found = {}
    for path in sorted((ROOT.parent / "shared" / "data" / "waveform").glob("*.*")):
        if path.name not in ("riegl_q680i.las", "leica_2ns.laz", "geolas_example2.pls"):
            continue
        source, read = open_source(path), ReadParams(**BASE["read"])
        try:
            waves = join_samples([read_span(source, span, read) for span in index_source(source, read)])
        except FwclassError as fault:
            print(f"{path.name}: {fault}", file=sys.stderr)
            continue
        found[path.stem] = max((c.phi for c in asked(waves).channels), key=len, default=())
    return found


def other_noise(scale: float) -> list[Figure]:
    """Noise whose neighbours are correlated, as in real receivers, and noise that grows with the signal."""
    out, n = [], int(40_000 * scale)
    kinds: dict[str, dict[str, Any]] = {"AR 0.5": {"phi": (0.5,)}}
    kinds |= {f"as {name}": {"phi": phi} for name, phi in real_noise().items()}
    kinds |= {f"grows by {b} DN": {"growth": b, "noise": (1.3, 1.3)} for b in (0.05, 0.15)}
    for name, kind in kinds.items():
        grows, steady = "growth" in kind, kind | ({"noise": 1.3} if "growth" in kind else {})
        pulse = asked(wm.survey_mix(20_000, seed=2, **kind)[0])
        got = fit_waveforms(wm.noise_only(int(300_000 * scale), seed=19, **steady)[0], ALL, pulse).count
        out.append(share(name, "false echoes per waveform of noise", got, "<= 2e-4"))
        waves, truth = wm.mix(n, (1.0,), amplitude=(20, 200), seed=13, **kind)
        clear = (truth.ratio >= 20) & ~truth.clipped
        fits, i, j, error = paired(waves, truth, pulse)
        out.append(share(name, "false splits, width 1-1.6", fits.count[clear] > 1, "<= 0.004" if grows else "<= 0.003"))
        for factor in (1.0, 2.0):
            wide, _ = wm.fixed(n // 2, [75.0], width=factor * wm.PULSE_WIDTH, first=30.0, seed=18, **steady)
            split = fit_waveforms(wide, ALL, pulse).count > 1
            out.append(share(name, f"  75 DN, {factor} x width", split, "<= 0.004" if grows else "<= 0.003"))
        use = ((fits.count == 1) & clear)[truth.row[i]]
        standard = (error / errors_of(fits, j))[use]
        for c in range(3):
            out.append(
                spread(name, f"standardised {NAMES[c]}", standard[:, c], "1.00 +- 0.07" if grows else "1.00 +- 0.05")
            )
        if not grows:
            bound = wm.bounds(truth, phi=kind["phi"])[i]
            for c in range(3):
                out.append(spread(name, f"RMSE/CRB of {NAMES[c]}", (error / bound)[use, c], "<= 1.03"))
        waves, truth = wm.survey_mix(n, seed=12, **kind)
        fits = fit_waveforms(waves, ALL, pulse)
        out.append(share(name, "completeness of the survey mix", hits_of(truth, fits)))
        out.append(share(name, "  false echoes per waveform", false_of(truth, fits)))
    return out


def long_records(scale: float) -> list[Figure]:
    """Waveforms of 256 samples a CPU second, beside curve_fit."""
    out = []
    for name, kind in (("256 samples, white", {}), ("256 samples, AR 0.5", {"phi": (0.5,)})):
        waves, truth = wm.survey_mix(int(20_000 * scale) + 2000, seed=11, samples=256, **kind)
        pulse, few = asked(waves), 150
        rows = waves.samples.reshape(-1, 256)[:few].astype(float)
        starts, rates = true_starts(rows, truth), ([], [])
        fit_waveforms(waves, PARAMS, pulse)
        for _ in range(5):
            for rate, count, work in (
                (rates[0], truth.count.size, lambda w=waves, p=pulse: fit_waveforms(w, PARAMS, p)),
                (rates[1], few, lambda r=rows, s=starts: curve_fits(r, s)),
            ):
                begin = time.process_time()
                work()
                rate.append(count / (time.process_time() - begin))
        ours, peer = (np.array(r) for r in rates)
        sd = float(ours.std() / np.sqrt(5))
        out.append(Figure(name, "fit_waveforms [waveforms/s]", float(np.median(ours)), sd, ">= 60000"))
        out.append(Figure(name, "  ratio to curve_fit, true starts", float(np.median(ours / peer)), asked=">= 80"))
    return out


def stacking(scale: float) -> list[Figure]:
    """Ground echoes of several pulses together, in woods 0.6 m between pulses."""
    out, woods, asked = [], max(int(6 * scale), 2), StackParams(**BASE["stack"])
    box, heights = Box(3.0, 3.0, 21.0, 21.0), np.full((60, 60), 100.0, np.float32)
    for ratio in (1.0, 1.5, 2.0, 0.0):
        name, standard, single = f"ground of A/σ {ratio}", [], []
        there, decoys = [], []
        for seed in range(woods if ratio else 6 * woods):
            waves, ground = woodmaker.flown(100.0, ratio, seed=100 + seed)
            told = Surface(heights, Window(1.0, -10, -10, 60, 60)), box.grown(asked.radius), asked, PARAMS
            found, _ = candidates(waves, 1, *told, GAUSSIAN, AS_STORED)
            table, counts = stack(found, np.empty((0, 2)), box, 0.0, asked)
            there += [1.0] * int(counts["stacked"]) + [0.0] * int(counts["candidates"] - counts["stacked"])
            decoys += [1.0] * int(counts["false"]) + [0.0] * int(counts["decoys"] - counts["false"])
            standard.append((table["z"] - ground[table["pulse"], 2]) / table["range_sigma"])
            single.append(fit_waveforms(waves, PARAMS, GAUSSIAN).count > 1)
        aim = {1.5: ">= 0.95", 0.0: "<= 1e-3"}.get(ratio, "")
        out.append(share(name, "found with nine pulses", np.array(there), aim))
        out.append(share(name, "  with one", np.concatenate(single)))
        out.append(share(name, "  decoys above the threshold", np.array(decoys), "<= 1e-3"))
        if ratio:
            out.append(spread(name, "  standardised height", np.concatenate(standard)))
    return out


def stacked_planes(scale: float) -> list[Figure]:
    """Echoes of several pulses together on a roof that a tree hides, and on water that mirrors the light away."""
    out, scenes, asked, nowhere = [], max(int(12 * scale), 2), StackParams(**BASE["stack"]), np.empty((0, 2))
    box, window = Box(3.0, 3.0, 21.0, 21.0), Window(1.0, -10, -10, 60, 60)
    level = Surface(np.full((60, 60), 100.0, np.float32), window)
    for what, code in (("roof", BUILDING), ("water", WATER)):
        for ratio in (1.5, 2.0, 0.0):
            there, decoys, standard = [], [], []
            for seed in range(scenes if ratio else 4 * scenes):
                surface, rough, known = level, 0.02, nowhere
                if code == BUILDING:
                    waves, place, strong = woodmaker.under_tree(ratio, seed=200 + seed)
                    echoes, rough = strong[planar(strong, asked)], 0.03
                    surface, known = plane_surface(echoes, window, asked), echoes[:, :2]
                else:
                    waves, place = woodmaker.pond(ratio, seed=200 + seed)
                told = surface, box.grown(asked.radius), asked, PARAMS
                some, through = candidates(waves, 1, *told, GAUSSIAN, AS_STORED, silent=True)
                table, counts = stack(some, np.concatenate([known, through]), box, rough, asked, code)
                there += [1.0] * int(counts["stacked"]) + [0.0] * int(counts["candidates"] - counts["stacked"])
                decoys += [1.0] * int(counts["false"]) + [0.0] * int(counts["decoys"] - counts["false"])
                standard.append((table["z"] - place[table["pulse"], 2]) / table["range_sigma"])
            name = f"{what} of A/σ {ratio}"
            out.append(share(name, "found with nine pulses", np.array(there), ">= 0.95" if ratio else "<= 1e-3"))
            out.append(share(name, "  decoys above the threshold", np.array(decoys), "<= 1e-3"))
            if ratio:
                out.append(spread(name, "  standardised height", np.concatenate(standard)))
    return out


def water(scale: float) -> list[Figure]:
    """A lake with a wooded shore under a green laser, from the file to the delivered echoes; without asking for water,
    and asking for it."""
    out, n = [], int(4000 * scale) + 400
    with tempfile.TemporaryDirectory() as place:
        made = Path(place) / "echoes.laz"
        for lag1 in (0.0, 0.5):
            scores: dict[bool, list[Score]] = {False: [], True: []}
            for seed in range(4):
                truth = lake(Path(place) / "lake.las", n, lag1=lag1, seed=int(100 * lag1) + seed, shore=0.6)
                for on in scores:
                    words = (f"bathymetry.enabled={str(on).lower()}", "plausibility.accept=true")
                    decompose_file(truth.path, made, words, True)
                    scores[on].append(scored(truth, laspy.read(made)))
            for on, some in scores.items():
                whole = {f.name: np.concatenate([getattr(s, f.name) for s in some]) for f in fields(Score)}
                name = f"lake, noise {'AR 0.5' if lag1 else 'white'}, {'asked' if on else 'plain'}"
                clear = whole["visible"] > 6.0
                if on:
                    out.append(share(name, "bottoms found, all that there are", whole["found"]))
                    for low, high in ((0.5, 1.0), (1.0, 1.5), (1.5, 3.0), (3.0, 6.0), (6.0, 15.0)):
                        at = clear & (whole["deep"] >= low) & (whole["deep"] < high)
                        out.append(share(name, f"  A/σ above 6, {low}-{high} m deep", whole["found"][at]))
                    out.append(share(name, "land taken for water", whole["false_water"], "<= 1e-3"))
                    out.append(share(name, "pulses of water with a surface", whole["surfaces"]))
                    out.append(share(name, "  with a bottom that is none, or 0.5 m off", whole["wrong"]))
                out.append(Figure(name, "echoes of a pulse of water too many", float(whole["extra"].mean())))
                for what in ("depth_error", "place_error"):
                    label = what.replace("_", " ") + " [m]"
                    out.append(spread(name, f"{label}, rms", whole[what]))
                    out.append(Figure(name, f"  {label}, median", float(np.median(whole[what]))))
                if on:
                    out.append(spread(name, "standardised place along the beam", whole["standard"], "1.00 +- 0.05"))
            params = BathymetryParams(**BASE["bathymetry"])
            record: dict[str, Any] = {"phi": (lag1,) if lag1 else (), "samples": 110}
            pulse = asked(wm.survey_mix(20_000, seed=2, phi=record["phi"])[0])
            for what, mixed, many in (("survey", wm.survey_mix, 40_000), ("hard", wm.hard_mix, 12_000)):
                waves, _ = mixed(int(many * scale), seed=31, **record)
                echoes = decompose(waves, 1, PARAMS, pulse, bathymetry=params)[0]
                wet = np.bincount(echoes["pulse"][echoes["water"] > 0], minlength=waves.pulses.rows) > 0
                out.append(share(f"{what} mix, noise {record['phi'] or 'white'}", "taken for water", wet, "<= 1e-3"))
    return out


def vendor_singles(_: float) -> list[Figure]:
    """The Q680i's single returns beside our echoes, none of which is pulled onto its return (../shared/data/waveform).

    The file lacks the phase of the digitiser's clock; its beat with GPS time tells it. Near where that wraps, from one
    sample to the next, the nearer of both counts.
    """
    path = ROOT.parent / "shared" / "data" / "waveform" / "riegl_q680i.las"
    if not path.exists():
        return []
    source, read = open_source(path), ReadParams(**BASE["read"])
    (span,) = index_source(source, read)
    waves = read_span(source, span, read)
    fits, pulses, returns = fit_waveforms(waves, PARAMS, asked(waves)), waves.pulses, waves.returns
    numbers, record = np.unique(pulses["pulse"], return_index=True)
    at, of = fits.time + pulses["segment_start"][fits.row], pulses["pulse"][fits.row]
    alone = np.bincount(returns["pulse"], minlength=len(numbers))[returns["pulse"]] == 1
    rows = np.flatnonzero(alone & (returns["number_of_returns"] == 1) & np.isin(returns["pulse"], of))
    pulse = returns["pulse"][rows]
    away = [at[of == k] - where for k, where in zip(pulse, returns["location"][rows].astype(float), strict=True)]
    single = np.array([len(a) == 1 for a in away])
    nearest = np.array([a[np.abs(a).argmin()] for a in away])
    phase = _clock_phase(nearest, pulses["gps_time"][record[np.searchsorted(numbers, pulse)]], single)
    places = np.stack([phase, phase + np.where(phase > 0.0, -1.0, 1.0)], axis=1)
    wraps = np.abs(phase) > 0.5 - WRAP
    off = np.array([np.abs(a[:, None] - p[: 1 + w]).min() for a, p, w in zip(away, places, wraps, strict=True)])
    out = []
    for name, some in (("all", np.ones(len(off), bool)), ("with one echo", single), ("with several echoes", ~single)):
        for metres in (0.05, 0.15):
            wish = ">= 0.985" if metres == 0.05 and name != "with several echoes" else ""
            hits = off[some] <= metres / METRES_PER_NS
            out.append(share("Q680i, unshifted", f"singles {name}, within {metres:g} m", hits, wish, f"of {len(hits)}"))
    return out


BEAT = 13_077.0
"""Hz, of the Q680i's digitiser with the clock of its GPS times, to 15."""
WRAP = 0.15
"""ns about a phase of half a sample in which it may be the next sample's: three times its scatter."""


def _clock_phase(offset: NDArray, gps_time: NDArray, single: NDArray) -> NDArray:
    """Phase of the digitiser's clock [samples of 1 ns], -0.5 to 0.5: a sawtooth of one frequency, with a start and the
    drift that medians of 60 `single` neighbours' offsets show."""

    def turned(value: NDArray) -> NDArray:
        return (value + 0.5) % 1.0 - 0.5

    t = gps_time - gps_time.min()
    steps = np.arange(BEAT - 15.0, BEAT + 15.0, 0.1)

    def mean_of(frequency: float) -> complex:
        return complex(np.exp(2j * np.pi * (offset - frequency * t)[single]).mean())

    frequency = max([*steps, *-steps], key=lambda f: abs(mean_of(f)))
    start = np.angle(mean_of(frequency)) / (2.0 * np.pi)
    rest = turned(offset - frequency * t - start)
    known = np.flatnonzero(single)[np.argsort(t[single], kind="stable")]
    place = np.searchsorted(t[known], t)
    drift = np.array([np.median(rest[known[max(k - 30, 0) : k + 30]]) for k in place])
    return turned(frequency * t + start + drift)


GROUPS = (
    speed,
    completeness,
    at_the_bound,
    resolution,
    false_splits,
    noise,
    other_pulses,
    other_noise,
    long_records,
    stacking,
    stacked_planes,
    water,
    vendor_singles,
)


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    asked.add_argument("--quick", action="store_true", help="a tenth of the waveforms")
    asked.add_argument("--json", action="store_true", help="the figures as JSON, nothing else")
    asked.add_argument("--only", choices=[g.__name__ for g in GROUPS], action="append", help="one group of figures")
    options = asked.parse_args()
    warm, _ = wm.hard_mix(200, seed=1)
    for pulse in (GAUSSIAN, receiver()):  # compile
        decompose(warm, 1, PARAMS, pulse)
    figures: list[Figure] = []
    for group in GROUPS:
        if options.only and group.__name__ not in options.only:
            continue
        begin = time.process_time()
        made = group(0.1 if options.quick else 1.0)
        figures += made
        if not options.json:
            show(made, f"{group.__name__}, {time.process_time() - begin:.0f} s")
    if options.json:
        print(json.dumps([{**asdict(f), "verdict": f.verdict} for f in figures], indent=1, default=float))


def show(figures: list[Figure], title: str) -> None:
    print(f"\n{title:91}{'value':>12}{'±':>10}  asked")
    for f in figures:
        value = "" if np.isnan(f.value) else f"{f.value:12.0f}" if f.value >= 1000 else f"{f.value:12.5f}"
        error = "" if np.isnan(f.error) else f"{f.error:10.0f}" if f.value >= 1000 else f"{f.error:10.5f}"
        print(f"{f.group:27}{f.name:64}{value:>12}{error:>10}  {f.asked:12} {f.verdict} {f.note}", flush=True)


if __name__ == "__main__":
    main()
