"""How far apart samples are, asked of the ground.

A surface knows nothing of when a record begins. Where records begin earlier or later from pulse to pulse, the echo of
one surface stands later or earlier in them by as much, if samples are as far apart as they say.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fwclass.decompose.fitting import Fits
from fwclass.decompose.placing import beams
from fwclass.waveforms import Waveforms

Floats = NDArray[np.float64]

FEWEST = 100
"""Second differences that tell it."""

ALONE = 0.9
"""Share of the second differences of times in the record that those of its begin must explain: begins that follow the
ground of the pulses before explain up to 0.83 of them, with a slope of their own."""

UNLIKE, SURE = 0.05, 3.0
"""Share by which samples lie nearer or further than they say that is told, and its standard errors."""

MOVED = 0.05
"""m, second differences of begins that tell a first answer each."""

ANSWERS = np.log(10.0) * np.linspace(-1.0, 1.0, 42)
"""Edges of the classes of those answers' logarithms, from a tenth to ten times: the fullest is begun with, as edges of
lines and houses give answers of every kind."""

MOST_BENT, ROUNDS = 4.0, 3
"""Second differences of places of so many times their median are edges, and left out, round by round."""

SHARED = 35.0 / 18.0
"""Variance of a slope between second differences, which have values in common, over that of independent ones."""


def spacing_ratio(sample: Waveforms, fits: Fits, late: Floats) -> float:
    """How many times as far apart samples are as the file says, 1 where that is not sure.

    Of second differences along the beam, over consecutive pulses of one echo each, of `sample_runs`: of where records
    begin, and of times in them. `late`, (rows,), is what is taken off the times of pulses [ns]. Where the ground is
    rough both slopes are too small, so that the lesser of what they say is told.
    """
    begin, time = _bent(sample, fits, late)
    if len(begin) < FEWEST:
        return 1.0
    moved = (np.abs(begin) >= MOVED) & (begin * time < 0.0)
    each = np.log(-begin[moved] / time[moved])
    counts, edges = np.histogram(each, ANSWERS)
    at = int(counts.argmax())
    near = each[(each >= edges[at]) & (each <= edges[at + 1])]
    if len(near) == 0:
        return 1.0
    ratio = math.exp(float(np.median(near)))
    for _ in range(ROUNDS):
        residual = np.abs(begin + ratio * time)
        level = residual <= MOST_BENT * max(float(np.median(residual)), 1e-9)
        a, b = begin[level], time[level]
        both, product = float((a * a).sum() * (b * b).sum()), -float((a * b).sum())
        if len(a) < FEWEST or product <= 0.0 or product**2 < ALONE * both:
            return 1.0
        ratio = math.sqrt(float((a * a).sum()) / float((b * b).sum()))
    further, nearer = product / float((b * b).sum()), product / float((a * a).sum())
    error = math.sqrt(SHARED * (both / product**2 - 1.0) / len(a))
    for answer, slope in ((further, further), (1.0 / nearer, nearer)):
        if slope * (1.0 - SURE * error) > 1.0 + UNLIKE:
            return answer
    return 1.0


def _bent(sample: Waveforms, fits: Fits, late: Floats) -> tuple[Floats, Floats]:
    """Second differences along the beam [m] of places of first samples, and of what echoes lie behind them, (n,) each;
    less their medians."""
    pulses = sample.pulses
    number, count = np.unique(pulses["pulse"].astype(np.int64), return_counts=True)
    one = (np.bincount(fits.row, minlength=pulses.rows) == 1) & np.isin(pulses["pulse"], number[count == 1])
    echo = np.flatnonzero(one[fits.row])
    row = fits.row[echo]
    follows = np.diff(pulses["pulse"].astype(np.int64)[row]) == 1
    middle = np.flatnonzero(follows[:-1] & follows[1:]) + 1
    beam, speed = (values[row] for values in beams(sample))
    anchor = np.stack([pulses[f"anchor_{a}"][row] for a in "xyz"], axis=1)
    before = pulses["anchor_time"].astype(np.float64)[row] + late[row]

    def bent(place: Floats) -> Floats:
        second = place[middle - 1] - 2.0 * place[middle] + place[middle + 1]
        along: Floats = (second * beam[middle]).sum(axis=1)
        return along - np.median(along) if len(along) else along

    return bent(anchor - (before * speed)[:, None] * beam), bent((fits.time[echo] * speed)[:, None] * beam)
