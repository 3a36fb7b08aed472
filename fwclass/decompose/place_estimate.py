"""Estimates, from a strip itself, of how its vendor places returns in time: a constant, a walk with the height.

A vendor finds the place of a return by a rule of its own: a share of the rising edge, a centre, a table. Against the
peak of the fitted pulse that is a constant time, which walks with the height of the echo. Echoes are placed along the
beam from a return, so that both go into every place that is not taken off. Where anchors are at the sensor, the time of
the recorded outgoing pulse may or may not be in the stored times already: what is right makes ranges smooth.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.alternate_heights import alternate_heights, descriptor_heights
from fwclass.decompose.beam_lengths import uneven_echoes
from fwclass.decompose.channel_rows import channel_rows
from fwclass.decompose.fitted_echoes import EDGE, OVERLAPPING, SATURATED
from fwclass.decompose.fitting import Fits, fit_waveforms
from fwclass.decompose.overload import followed_echoes
from fwclass.decompose.params import DecomposeParams
from fwclass.decompose.placement import AS_STORED, OffsetCurve, Placement
from fwclass.decompose.placing import PHASE_REACH, beams, outgoing_times
from fwclass.decompose.record_spacing import spacing_ratio
from fwclass.decompose.recovery import recovered
from fwclass.decompose.recurring import recurring_echoes
from fwclass.decompose.system_pulse import SystemPulse
from fwclass.schema import Table
from fwclass.units import METRES_PER_NS, SIGMA_PER_MAD
from fwclass.waveforms import PULSE_COLUMNS, RETURN_COLUMNS, Waveforms

Floats = NDArray[np.float64]

RUN = 64
"""Consecutive pulses that are sampled together: neighbours in a scan line tell whether ranges are smooth."""

PER_NODE, MOST_NODES = 60, 12
"""Echoes of a node of the curve over height, and nodes at most."""

SURE = 3.0
"""Standard errors by which a constant must differ from 0, and nodes (root mean square) from the constant."""

ASTRAY = 0.1
"""m, and as many standard errors of its fitted time, by which an echo lies off its return that is not where it is."""

PHASE_SPREAD, PHASE_SHARE = 0.35, 0.98
"""Locations that lack the phase of the digitiser's clock lie evenly over one sample: their middle half then spans half
a sample, and nearly all lie within half a sample and the fit's error."""

SMOOTHER = 1.25
"""Ratio of two roughnesses of range from which the smoother one is the truth."""

SPREAD, STRETCHED = 5.0, 0.005
"""Standard deviation of locations [ns] that tells whether samples are as far apart as they say, and the share by which
they are not; a Leica's locations stretch by 0.001."""

PIECES = 4
"""Parts along a strip that are asked for it, too, as clocks may drift."""

DRIFTED = 0.05
"""m between the constants of two parts of a strip that are told; a Leica's quarters differ by 6 mm."""

SLIPPED, SLIP_WIDTH = 0.02, 0.25
"""Share of the echoes that lie whole samples off, within so many of a sample, that is told; a Leica has -0.03, as its
differences have tails."""

MOST_BENT = 4.0
"""Second differences of so many times their median are no ground that tells anything of locations."""

HALFWAY = 0.5
"""Between a slope of places on locations' errors of 0 and of 1."""

ALIKE = math.sqrt(35.0 / 18.0)
"""Standard error of a slope between second differences, which have values in common, over that of independent ones."""

TRIPLES = 30
"""Fewer second differences tell nothing."""


def sample_runs(waves: Waveforms, n_pulses: int, sample: int) -> Waveforms:
    """Runs of consecutive pulses of a strip of `n_pulses`, about `sample` of them, with their outgoing pulses.

    Runs are numbered by pulse, so that cutting into chunks cannot matter.
    """
    run = waves.pulses["pulse"].astype(np.int64) // RUN
    return _rows(waves, np.flatnonzero(run % max(1, math.ceil(n_pulses / sample)) == 0))


def join_runs(parts: Iterable[Waveforms]) -> Waveforms:
    """Samples of several chunks as one, by (pulse, segment)."""
    filled = [part for part in parts if part.pulses.rows]
    if not filled:
        return Waveforms(Table.empty(PULSE_COLUMNS), Table.empty(RETURN_COLUMNS), np.empty(0, np.uint8), _ends([]))
    whole = Waveforms(
        Table.concat([p.pulses for p in filled]),
        Table.empty(RETURN_COLUMNS),
        np.concatenate([p.samples for p in filled]),
        _ends(np.concatenate([np.diff(p.offsets) for p in filled])),
        outgoing=np.concatenate([p.outgoing for p in filled]),
        outgoing_offsets=_ends(np.concatenate([np.diff(p.outgoing_offsets) for p in filled])),
    )
    return _rows(whole, np.lexsort((whole.pulses["segment_start"], whole.pulses["pulse"])))


def measure_placement(
    sample: Waveforms, at_returns: bool, params: DecomposeParams, pulse: SystemPulse, from_outgoing: bool = True
) -> Placement:
    """What the sampled runs of a strip tell of its places.

    Parameters
    ----------
    sample : of `sample_runs`, the whole strip's.
    at_returns : anchors are returns of the vendor, not places at the sensor.
    params : ``vendor_offset``, ``offset_echoes``, ``outgoing_time`` and those of the fit.
    from_outgoing : the format's times count from the recorded outgoing pulse, which holds where the data do not tell.
    """
    if sample.pulses.rows == 0:
        return AS_STORED
    sample, doubt = recovered(sample, params, pulse)
    fits = fit_waveforms(sample, params, pulse, doubt)
    if at_returns:
        placement = Placement(_curves(sample, fits, params, pulse) if params.vendor_offset == "auto" else ())
    else:
        placement = _outgoing(sample, fits, params, pulse, from_outgoing)
        late = outgoing_times(sample, params, pulse) if placement.outgoing and placement.from_outgoing else None
        none = np.zeros(sample.pulses.rows)
        placement = replace(placement, spacing=spacing_ratio(sample, fits, none if late is None else late))
    recurring = recurring_echoes(fits, pulse.fwhm, params.vendor_tolerance)
    return replace(
        placement,
        recurring=recurring,
        followed=followed_echoes(fits),
        uneven=uneven_echoes(sample, fits, params.beam_lengths),
        alternate=alternate_heights(sample, fits),
        descriptors=descriptor_heights(sample, fits),
    )


def _curves(sample: Waveforms, fits: Fits, params: DecomposeParams, pulse: SystemPulse) -> tuple[OffsetCurve, ...]:
    """The curve of every channel whose echoes show one."""
    gap = fits.time - sample.pulses["anchor_time"].astype(np.float64)[fits.row]
    within = max(params.vendor_tolerance, pulse.fwhm)
    plain = (fits.flags & (SATURATED | OVERLAPPING | EDGE)) == 0
    channel = channel_rows(pulse.channels, sample.pulses)
    kinds = np.stack([sample.pulses["sample_spacing"], sample.pulses["saturation"], channel], axis=1)
    curves = []
    for spacing, saturation, k in np.unique(kinds[~np.isnan(kinds).any(axis=1)], axis=0):
        mine = ((kinds == (spacing, saturation, k)).all(axis=1))[fits.row]
        constant = 0.0
        for _ in range(2):  # which echo is nearest depends on the constant
            near = _nearest(gap - constant, fits.row, mine)
            near = near[plain[near] & (np.abs(gap[near] - constant) <= within)]
            if len(near) < params.offset_echoes:
                break
            constant = float(np.median(gap[near]))
        if len(near) >= params.offset_echoes:
            curve = _curve(gap[near], fits.amplitude[near], float(spacing), float(saturation))
            walks = len(curve.offsets) > 1
            if (curve.phase or walks) and _placed_alike(sample, fits, near, gap):
                curve = replace(curve, heights=curve.heights[:1], offsets=(0.0,), phase=False, alike=walks)
            residual = gap[near] - curve.at(fits.amplitude[near])
            location = sample.pulses["anchor_time"].astype(np.float64)[fits.row[near]]
            pieces = np.array_split(np.arange(len(near)), PIECES)  # by pulse, as rows are
            stretch = _stretch(residual, location) or max((_stretch(residual[p], location[p]) for p in pieces), key=abs)
            drift = 0.0 if curve.phase or curve.alike else _drift([residual[p] for p in pieces])
            astray = float((np.abs(residual) > ASTRAY / METRES_PER_NS + SURE * fits.time_sigma[near]).mean())
            slipped = 0.0 if curve.phase or curve.alike else _slipped(residual / spacing, within / float(spacing))
            receivers = next((c.receivers for c in pulse.channels[int(k) : int(k) + 1]), ())
            curve = replace(
                curve,
                astray=0.0 if curve.phase or curve.alike else astray,
                receivers=receivers,
                stretch=stretch,
                drift=drift,
                slipped=slipped,
            )
            curves += [curve] if curve.scatter < 0.5 * within else []
    return tuple(curves)


def _placed_alike(sample: Waveforms, fits: Fits, near: NDArray[np.int64], gap: Floats) -> bool:
    """Whether the places of returns are those of their locations, so that what these are off by is in both.

    Second differences along the beam, over consecutive pulses of one echo, of places by the fitted times on those of
    `gap`, fitted times less locations: a slope of 1 where places are right and locations alone are off, of 0 where
    places go with them. What the ground does has nothing to do with either.
    """
    pulses = sample.pulses
    number = pulses["pulse"].astype(np.int64)
    row, echo = fits.row[near], near
    one = (np.bincount(fits.row, minlength=pulses.rows) == 1)[row]
    several = number[1:][np.diff(number) == 0]
    one &= ~np.isin(number[row], several)
    row, echo = row[one], echo[one]
    follows = np.diff(number[row]) == 1
    middle = np.flatnonzero(follows[:-1] & follows[1:]) + 1
    if len(middle) < TRIPLES:
        return False
    beam, speed = (values[row] for values in beams(sample))
    anchor = np.stack([pulses[f"anchor_{a}"][row] for a in "xyz"], axis=1)
    late = gap[echo] * speed
    place = anchor + late[:, None] * beam
    bend = ((place[middle - 1] - 2.0 * place[middle] + place[middle + 1]) * beam[middle]).sum(axis=1)
    odd = late[middle - 1] - 2.0 * late[middle] + late[middle + 1]
    bend, odd = bend - np.median(bend), odd - np.median(odd)
    level = np.abs(bend) <= MOST_BENT * max(float(np.median(np.abs(bend))), float(np.median(np.abs(odd))))
    bend, odd = bend[level], odd[level]
    total = float((odd**2).sum())
    if len(odd) < TRIPLES or total == 0.0:
        return False
    slope = float((bend * odd).sum()) / total
    error = ALIKE * math.sqrt(float(((bend - slope * odd) ** 2).sum()) / (len(odd) - 1) / total)
    return slope + SURE * error < HALFWAY


def _stretch(left: Floats, location: Floats) -> float:
    """How much longer fitted times are than locations as these grow, as a share, where locations spread enough to tell
    and it is sure; 0 else. `left`, (n,), are fitted times less locations less the curve, of returns at `location` [ns].
    """
    middle, sigma = _robust(left)
    some = np.abs(left - middle) <= MOST_BENT * max(sigma, 1e-6)
    x, y = location[some] - location[some].mean(), left[some] - left[some].mean()
    total = float((x**2).sum())
    if len(x) < TRIPLES or total < SPREAD**2 * len(x):
        return 0.0
    slope = float((x * y).sum()) / total
    error = math.sqrt(float(((y - slope * x) ** 2).sum()) / (len(x) - 2) / total)
    return slope if abs(slope) > STRETCHED + SURE * error else 0.0


def _drift(pieces: list[Floats]) -> float:
    """How much later than in the earliest part echoes are fitted in the latest [ns], of `pieces` of fitted times less
    locations less the curve, of each (n,); negative where the latest comes first; 0 where it is not sure, or small."""
    if min(map(len, pieces)) < TRIPLES:
        return 0.0
    middle, sigma = np.array([_robust(p) for p in pieces]).T
    error = 1.2533 * sigma / np.sqrt([len(p) for p in pieces])
    low, high = int(middle.argmin()), int(middle.argmax())
    drift = float(middle[high] - middle[low])
    sure = drift > DRIFTED / METRES_PER_NS + SURE * math.hypot(error[low], error[high])
    return math.copysign(drift, high - low) if sure else 0.0


def _slipped(left: Floats, most: float) -> float:
    """Share of the echoes that lie 1 to `most` whole samples off, less twice what lies a half off, as tails do, where
    that is sure; 0 else. `left`, (n,), are fitted times less locations less the curve, in samples."""
    whole = np.rint(left)
    off = (whole != 0.0) & (np.abs(whole) <= most)
    lump = off & (np.abs(left - whole) <= SLIP_WIDTH)
    between = (np.abs(left) > 2.0 * SLIP_WIDTH) & (np.abs(np.abs(left - whole) - 0.5) < SLIP_WIDTH)
    count = int(lump.sum())
    more = count - 2 * int(between.sum())
    sure = more >= SLIPPED * len(left) and more > SURE * math.sqrt(count)
    return more / len(left) if sure else 0.0


def _nearest(gap: Floats, row: NDArray[np.int64], selected: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Of the echoes of every row that are `selected` the one of the least gap, the first on a tie."""
    at = np.flatnonzero(selected)
    order = at[np.lexsort((at, np.abs(gap[at]), row[at]))]
    return order[np.unique(row[order], return_index=True)[1]]


def _curve(gap: Floats, height: Floats, spacing: float, saturation: float) -> OffsetCurve:
    order = np.lexsort((gap, height))
    constant = float(np.median(gap))
    nodes = np.array_split(order, min(MOST_NODES, max(1, len(gap) // PER_NODE)))
    middle, sigma = np.array([_robust(gap[node]) for node in nodes]).T
    error = np.maximum(1.2533 * sigma / np.sqrt([len(node) for node in nodes]), 1e-6)
    heights, offsets = np.array([np.median(height[node]) for node in nodes]), middle
    if len(nodes) == 1 or np.sqrt(np.mean(((middle - constant) / error) ** 2)) < SURE:
        whole = 1.2533 * _robust(gap)[1] / math.sqrt(len(gap))
        heights, offsets = (
            np.median(height, keepdims=True),
            np.array([constant if abs(constant) > SURE * whole else 0.0]),
        )
    curve = OffsetCurve(spacing, saturation, tuple(heights), tuple(offsets), constant, 0.0, len(gap), False)
    residual = gap - curve.at(height)
    (low, high), far = np.quantile(residual, [0.25, 0.75]), np.quantile(np.abs(residual), PHASE_SHARE)
    return OffsetCurve(
        spacing,
        saturation,
        tuple(float(v) for v in heights),
        tuple(float(v) for v in offsets),
        constant,
        float(_robust(residual)[1]),
        len(gap),
        bool(high - low >= PHASE_SPREAD * spacing and far <= PHASE_REACH * spacing),
    )


def _robust(values: Floats) -> tuple[float, float]:
    """Median and standard deviation, the latter from the median deviation."""
    middle = float(np.median(values))
    return middle, SIGMA_PER_MAD * float(np.median(np.abs(values - middle)))


def _outgoing(sample: Waveforms, fits: Fits, params: DecomposeParams, pulse: SystemPulse, rule: bool) -> Placement:
    """Whether the time of the outgoing pulse is to be taken off, by `outgoing_time`, by the data, and by the format's
    `rule` where these do not tell. An outgoing pulse whose time is not known has none to take off."""
    recorded = (np.diff(sample.outgoing_offsets) > 0) & np.isfinite(sample.pulses["outgoing_start"])
    n = len(np.unique(sample.pulses["pulse"][recorded]))
    if n == 0:
        return AS_STORED
    evidence: dict[str, Any] = {"outgoing": n}
    if params.outgoing_time != "auto":
        subtract = params.outgoing_time == "subtract"
        return Placement((), subtract, subtract, "the setting says so", **evidence)
    if np.isnan(sample.pulses["anchor_range"][recorded]).all():
        return Placement((), False, False, "its anchors have no fixed distance from the sensor", **evidence)
    late = outgoing_times(sample, params, pulse)
    by_rule = f"so by the format's rule; it is {np.median(late[recorded]):+.2f} ns"
    roughness = _roughness(sample, fits, late)
    if roughness is None:
        return Placement((), rule, rule, f"too few neighbouring pulses to tell, {by_rule}", **evidence)
    (stored, less), ranges = roughness
    evidence |= {"places": (stored, less), "ranges": ranges}
    words = f"places along the line are rough by {stored:.3f} m as stored, by {less:.3f} m less that time"
    subtract = _smoother(stored, less, rule)
    if _smoother(stored, less, not rule) != subtract:
        words += f", which does not tell, {by_rule}"
    return Placement((), subtract, _smoother(*ranges, subtract), words, **evidence)


def _smoother(stored: float, less: float, otherwise: bool) -> bool:
    """`less` is smoother than `stored`; `otherwise` where they are about the same."""
    return less < stored if max(stored, less) >= SMOOTHER * min(stored, less) else otherwise


def _roughness(sample: Waveforms, fits: Fits, late: Floats) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """Median second differences along the beam [m] of places, and of times from the anchor alone; of each as stored and
    less the outgoing pulse. None of too few.

    Of consecutive pulses that have one echo each: what lies on one surface.
    """
    pulses = sample.pulses
    one = np.bincount(fits.row, minlength=pulses.rows) == 1
    row = fits.row[one[fits.row]]
    echo = np.full(pulses.rows, -1)
    echo[fits.row] = np.arange(len(fits.row))
    number, count = np.unique(pulses["pulse"].astype(np.int64), return_counts=True)
    row = row[np.isin(pulses["pulse"][row], number[count == 1]) & (np.diff(sample.outgoing_offsets)[row] > 0)]
    follows = np.diff(pulses["pulse"].astype(np.int64)[row]) == 1
    middle = np.flatnonzero(follows[:-1] & follows[1:]) + 1
    if len(middle) < TRIPLES:
        return None
    beam, speed = (values[row] for values in beams(sample))
    anchor = np.stack([pulses[f"anchor_{a}"][row] for a in "xyz"], axis=1)
    after = fits.time[echo[row]] - pulses["anchor_time"].astype(np.float64)[row]

    def rough(time: Floats, origin: Floats) -> float:
        place = origin + (time * speed)[:, None] * beam
        bend = place[middle - 1] - 2.0 * place[middle] + place[middle + 1]
        return float(np.median(np.abs((bend * beam[middle]).sum(axis=1))))

    both = (after, after - late[row])
    places, ranges = ([rough(time, origin) for time in both] for origin in (anchor, np.zeros_like(anchor)))
    return (places[0], places[1]), (ranges[0], ranges[1])


def _rows(waves: Waveforms, rows: NDArray[np.int64]) -> Waveforms:
    """Waveforms `rows` of `waves` with their outgoing pulses, in that order, without returns."""
    samples, offsets = _pieces(waves.samples, waves.offsets, rows)
    outgoing, launched = _pieces(waves.outgoing, waves.outgoing_offsets, rows)
    none = Table.empty(RETURN_COLUMNS)
    return Waveforms(waves.pulses.take(rows), none, samples, offsets, outgoing=outgoing, outgoing_offsets=launched)


def _pieces(
    values: NDArray[Any], offsets: NDArray[np.int64], rows: NDArray[np.int64]
) -> tuple[NDArray[Any], NDArray[np.int64]]:
    length = np.diff(offsets)[rows]
    ends = _ends(length)
    return values[np.arange(ends[-1]) + np.repeat(offsets[rows] - ends[:-1], length)], ends


def _ends(lengths: Any) -> NDArray[np.int64]:
    return np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
