"""The system's pulse from the survey itself: bright single echoes, aligned and averaged.

Compare Jutzi and Stilla 2006, who take the recorded outgoing pulse; here the echoes of flat targets stand for it.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose import pulse_scan
from fwclass.decompose.params import FEWEST, PulseParams
from fwclass.decompose.pulse_align import Echoes, cut_samples, fit_template, half_sample_mode, narrowest
from fwclass.decompose.pulse_channels import (
    channel_groups,
    clip_levels,
    estimate_channels,
    in_steps,
    rough_levels,
    sample_steps,
)
from fwclass.decompose.pulse_sample import rows_of
from fwclass.decompose.pulse_shape import (
    CLOSE,
    FARTHEST,
    FEWEST_SAMPLES,
    MOST_SAMPLES,
    chi,
    measure_pulse,
    narrow_width,
    predicted_gain,
    surest,
    template_of,
)
from fwclass.decompose.pulse_template import gaussian_template, rise_time
from fwclass.decompose.receivers import part_groups
from fwclass.decompose.system_pulse import MOST_CHANNELS, SystemPulse
from fwclass.waveforms import Waveforms

Floats = NDArray[np.floating]

DIMMER = 3.0
"""Where too few echoes are bright, those of this part of the brightness still tell the width."""

CANDIDATES = 2
"""The brightest echoes, this many times as many as count in the end, are looked at."""

LONGER, STILL_HIGH = (2.0, 4.0), 3e-3
"""Times `pulse.tail` that a pulse is followed while it is still higher than that share of its peak where it ends."""

SHARED = 0.5
"""Of the echoes within four times what counts as one width, the share that must lie within it for them to share one; a
quarter does where widths spread evenly."""

ALONE = 0.5
"""Share of the bright echoes that stand alone but for a swing below the level; below it receivers swing."""

FAR = 1.5
"""From this ratio to the recorded width on, echoes that share none are wide targets; receivers differ by less."""


def estimate_pulse(waves: Waveforms, params: PulseParams, recorded: SystemPulse | None = None) -> SystemPulse:
    """The pulse that the waveforms of one strip share, and what their receiver records without echoes.

    The pulse is that of the channel with most bright echoes; another channel with enough of them has its own, unless
    the two agree. Where a channel's echoes are too few, or share no width and are far wider than the pulse was
    `recorded` as it left, that one is taken.

    The echoes used are the highest of their waveform, bright, unsaturated and alone. Their width is the one that the
    narrowest share (`narrowest`), for slopes and plants only widen. Aligned and scaled by least squares they give a
    mean shape, which aligns them anew. Half of the echoes judge the shape that the other half gives: it is kept if
    it predicts them better than the best Gaussian does.

    Depends on the set of waveforms only, not on their order. The channels' noise is taken for white, see
    `quiet.with_correlated_noise`.
    """
    waves = usable(waves)
    if waves.pulses.rows == 0:
        return SystemPulse.gaussian(params.width or params.fallback_width)
    waves, kinds, group, clips = with_clips(waves)
    steps = np.append(sample_steps(waves, group, len(kinds)), 1.0)
    waves = in_steps(waves, steps[group])
    level, noise = rough_levels(waves, group)
    peak, height, width = bright_peaks(waves, level, noise, params)
    guess = half_sample_mode(width[peak >= 0]) if (peak >= 0).sum() >= FEWEST else math.nan
    fwhm = params.width or (guess if math.isfinite(guess) else params.fallback_width)
    group, parted = _part_receivers(waves, group, (peak, height, level, noise), width, fwhm, params)
    if len(parted) > len(kinds):
        level, noise = rough_levels(waves, group)
        peak, height, width = bright_peaks(waves, level, noise, params)
    of = [k for k, _ in parted]
    kinds, clips, steps = kinds[of], clips[of], steps[of]
    receiver, level = estimate_channels(waves, kinds, group, level, noise, fwhm, params.tail)
    for k, channel in receiver.items():
        noise[group == k] = channel.noise
    pulses: dict[int, SystemPulse] = {}
    bright = (peak >= 0) & (group >= 0)
    for k in np.argsort(-np.bincount(group[bright], minlength=len(kinds)), kind="stable").tolist():
        rows = np.flatnonzero(bright & (group == k))
        wide = _about(width[rows], fwhm, params)
        main = next(iter(pulses.values()), None)
        pulse, echoes = _pulse_of(waves, rows, float(kinds[k, 0]), (peak, height, level, noise), wide, params)
        preferred = _prefer_recorded(pulse, echoes, recorded, tuple(kinds[k].tolist()), params)
        agrees = not preferred.outgoing and _agree(main or pulse, pulse, echoes, params)
        if main is None or (pulse.echoes >= params.min_echoes and not agrees):
            pulses[k] = preferred
    strip = pulses.pop(next(iter(pulses)))
    channels = [
        replace(
            channel.times(steps[k]) if steps[k] > 1.0 else channel,
            clip=float(clips[k]),
            pulse=pulses.get(k),
            step=float(steps[k]),
            receivers=parted[k][1],
        )
        for k, channel in receiver.items()
    ]
    return replace(strip, channels=tuple(channels))


def _part_receivers(
    waves: Waveforms,
    group: NDArray[np.int64],
    facts: tuple[NDArray, Floats, Floats, Floats],
    width: Floats,
    fwhm: float,
    params: PulseParams,
) -> tuple[NDArray[np.int64], list[tuple[int, tuple[int, ...]]]]:
    """`part_groups` by the shape of the pulses; `facts` as `_pulse_of` has them, `width` of the peaks [ns]."""
    receiver, bright = waves.pulses["receiver"], facts[0] >= 0
    whole: list[tuple[int, tuple[int, ...]]] = [(k, ()) for k in range(group.max(initial=-1) + 1)]
    kinds, each = np.unique(receiver, return_inverse=True)
    if len(kinds) == 1:
        return group, whole
    _, noise = rough_levels(waves, group * len(kinds) + each)

    def shape_of(rows: NDArray[np.int64]) -> tuple[SystemPulse, Echoes | None]:
        spacing = float(waves.pulses["sample_spacing"][rows[0]])
        return _pulse_of(waves, rows, spacing, facts, _about(width[rows], fwhm, params), params)

    def alike(one: tuple[SystemPulse, Echoes | None], other: tuple[SystemPulse, Echoes | None]) -> bool:
        return one[1] is None or other[1] is None or _agree(one[0], *other, params)

    numbers, parted = part_groups(group, receiver, bright, noise, params.min_echoes, shape_of, alike)
    return (numbers, parted) if len(parted) <= MOST_CHANNELS else (group, whole)


def _about(width: Floats, fwhm: float, params: PulseParams) -> float:
    """About how wide the pulse of peaks of these widths is; `fwhm` where it is given, or they are few [ns]."""
    return fwhm if params.width or len(width) < FEWEST else half_sample_mode(width)


def _pulse_of(
    waves: Waveforms,
    rows: NDArray,
    spacing: float,
    facts: tuple[NDArray, Floats, Floats, Floats],
    fwhm: float,
    params: PulseParams,
) -> tuple[SystemPulse, Echoes | None]:
    """The pulse, about `fwhm` [ns] wide, of a channel whose bright echoes are in `rows`, and those it stands on.

    `facts` are every waveform's (sample of its peak, height, level, noise).
    """
    peak, height, level, noise = facts
    if len(rows) < FEWEST or not _is_resolved(fwhm, spacing):
        return SystemPulse("gaussian", fwhm), None
    rows = surest(rows, -height[rows] / noise[rows], CANDIDATES * params.max_echoes)
    fwhm, rows = narrow_width(waves, rows, peak, level, noise, fwhm, params)
    if len(rows) < params.min_echoes or not _is_resolved(fwhm, spacing):
        return SystemPulse("gaussian", fwhm, echoes=len(rows)), None
    pulse, echoes = _followed(waves, rows, facts, fwhm, params)
    for longer in LONGER:
        if not _is_cut_off(pulse, params.tail * longer / 2.0):
            break
        further = _followed(waves, rows, facts, fwhm, params.model_copy(update={"tail": longer * params.tail}))
        if further[0].shape != "measured":
            break
        pulse, echoes = further
    return pulse, echoes


def _followed(
    waves: Waveforms, rows: NDArray, facts: tuple[NDArray, Floats, Floats, Floats], fwhm: float, params: PulseParams
) -> tuple[SystemPulse, Echoes]:
    """`_pulse_of` the echoes in `rows`, followed as far as `params` says."""
    peak, _, level, noise = facts
    after = min(max(params.tail, 2.0 * fwhm), FARTHEST * fwhm)
    cut = cut_samples(waves, rows, peak[rows], level[rows], noise[rows], fwhm, after)
    echoes = fit_template(cut, gaussian_template(fwhm))
    return measure_pulse(echoes, fwhm, params), echoes


def _is_cut_off(pulse: SystemPulse, tail: float) -> bool:
    """Whether the pulse is still high where it was followed no further, `tail` after its peak [ns]."""
    end = pulse.first + pulse.step * len(pulse.values)
    if pulse.shape != "measured" or not tail - 0.5 * pulse.fwhm < end < (FARTHEST - 0.5) * pulse.fwhm:
        return False
    return abs(float(pulse.at(np.array([end - pulse.fwhm]))[0])) > STILL_HIGH


def _prefer_recorded(
    pulse: SystemPulse,
    echoes: Echoes | None,
    recorded: SystemPulse | None,
    channel: tuple[float, float],
    params: PulseParams,
) -> SystemPulse:
    """The `recorded` pulse of `channel`, where the `echoes` do not show theirs; else `pulse`."""
    if recorded is None or params.width:
        return pulse
    outgoing = recorded.of(next((c for c in recorded.channels if c.key[:2] == channel), None))
    if outgoing.echoes < FEWEST:
        return pulse
    if echoes is not None and (pulse.fwhm < FAR * outgoing.fwhm or _share_a_width(echoes)):
        return pulse
    return replace(outgoing, echoes=0, outgoing=outgoing.echoes, channels=())


def _share_a_width(echoes: Echoes) -> bool:
    size, error = echoes.size, 2.0 * echoes.size_sd + CLOSE
    apart = np.abs(size - narrowest(size, echoes.size_sd))
    return int((apart < error).sum()) >= SHARED * int((apart < 4.0 * error).sum())


def _agree(main: SystemPulse, pulse: SystemPulse, echoes: Echoes | None, params: PulseParams) -> bool:
    """Whether `main` says of these echoes what their own `pulse` says."""
    if echoes is None or abs(pulse.fwhm - main.fwhm) > CLOSE * main.fwhm:
        return False
    if pulse.shape == "measured":
        return predicted_gain(echoes, template_of(pulse), template_of(main), params) < params.worth
    of_main, of_own = template_of(main), template_of(pulse)
    gain = chi(fit_template(echoes, of_main), of_main) - chi(fit_template(echoes, of_own), of_own)
    return gain < params.worth * len(echoes)


def _is_resolved(fwhm: float, spacing: float) -> bool:
    """Whether a pulse of `fwhm` takes enough samples to have a shape, and not so many that it is none."""
    return FEWEST_SAMPLES <= fwhm / spacing <= MOST_SAMPLES


def usable(waves: Waveforms) -> Waveforms:
    """Waveforms with a spacing and samples, ordered by (pulse, segment)."""
    spacing, top = waves.pulses["sample_spacing"], waves.pulses["saturation"]
    sound = np.isfinite(spacing) & (spacing > 0.0) & np.isfinite(top) & (np.diff(waves.offsets) > 0)
    order = np.lexsort((waves.pulses["segment_start"], waves.pulses["pulse"]))
    return rows_of(waves, order[sound[order]])


def with_clips(waves: Waveforms) -> tuple[Waveforms, Floats, NDArray[np.int64], Floats]:
    """Waveforms whose saturation is the level that their channel clips at [DN], their `channel_groups`, float64
    (channels, 2) and int64 (waveforms,), and these levels, float64 (channels,)."""
    kinds, group = channel_groups(waves)
    clips = clip_levels(waves, kinds, group)
    reached = np.where(group >= 0, clips[group], waves.pulses["saturation"])
    return replace(waves, pulses=waves.pulses.with_columns({"saturation": reached})), kinds, group, clips


def bright_peaks(waves: Waveforms, level: Floats, noise: Floats, params: PulseParams) -> tuple[NDArray, Floats, Floats]:
    """Sample of every waveform's bright single echo, -1 without, its height [DN], and about its width [ns].

    A receiver that passes a band alone swings below its level behind every echo and comes back up to it: where less
    than half of the echoes stand alone by samples that rise again, those count that rise above the level.
    """
    strict = _bright_peaks(waves, level, noise, params)
    floor = np.repeat(np.floor(np.nan_to_num(level)), np.diff(waves.offsets)).astype(waves.samples.dtype)
    filled = replace(waves, samples=np.maximum(waves.samples, floor))
    swinging = _bright_peaks(filled, level, noise, params)
    return swinging if (strict[0] >= 0).sum() < ALONE * (swinging[0] >= 0).sum() else strict


def _bright_peaks(
    waves: Waveforms, level: Floats, noise: Floats, params: PulseParams
) -> tuple[NDArray, Floats, Floats]:
    """`bright_peaks` of samples as they are."""
    n = waves.pulses.rows
    peak, height, width = np.empty(n, np.int64), np.empty(n), np.empty(n)
    spacing = waves.pulses["sample_spacing"].astype(np.float64)
    top = waves.pulses["saturation"].astype(np.float64)
    for bright in (params.bright, params.bright / DIMMER):
        pulse_scan.brightest(
            waves.wide, waves.offsets, spacing, top, level, bright * noise, params.isolation, noise, peak, height, width
        )
        if (peak >= 0).sum() >= params.min_echoes:
            break
    return peak, height, width


def describe(pulse: SystemPulse) -> dict[str, float | int | str]:
    """What a report says of the pulse.

    Returns
    -------
    shape, echoes, outgoing, shape_error; fwhm and rise_time from 10 to 90 % of the height [ns]; skew, the third
    standardised moment; tail_share, the share of the area later than 1.5 FWHM after the peak.
    """
    if pulse.shape == "measured":
        time: Floats = pulse.first + pulse.step * np.arange(len(pulse.values))
        value: Floats = pulse.values
    else:
        smooth = gaussian_template(pulse.fwhm)
        time, value = smooth.time, smooth.value
    weight = np.maximum(value, 0.0) / np.maximum(value, 0.0).sum()
    mean = float((weight * time).sum())
    variance = float((weight * (time - mean) ** 2).sum())
    return {
        "shape": pulse.shape,
        "fwhm": pulse.fwhm,
        "rise_time": rise_time(time, value),
        "skew": float((weight * (time - mean) ** 3).sum() / variance**1.5),
        "tail_share": float(value[time > 1.5 * pulse.fwhm].sum() / value.sum()),
        "shape_error": pulse.shape_error,
        "echoes": pulse.echoes,
        "outgoing": pulse.outgoing,
    }
