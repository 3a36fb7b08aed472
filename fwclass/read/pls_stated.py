"""Whether the waves of pulses are theirs and count in the pulses' time: a pulse states when its first and its last
returning sample were taken, and the header within which bounds all of them lie."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.read.pls_waves import Pulses, Samplings, reach
from fwclass.read.pulsewaves import RETURNING, PulseSource

FEW = 20
"""Pulses with returning samples below which nothing is told."""

OWN, ALL = 0.5, 0.9
"""Share of the pulses whose waves begin and end when they state it, below which something is wrong; and the share that
do so in another order, or with times of another unit, which tells what."""

ANOTHER = 0.1
"""Share by which the stated length of waves is another: one sample more or less is the writer's way to count."""

WRAPS = 1 << 15
"""Stated times have 16 bits with a sign: longer ones are known but for this many units."""

SLACK = 0.05
"""Share of the flying height that places may miss the header's bounds by: anchors are not all at one height."""

IN, WITHIN = 0.99, 1.0
"""Share of the first and last samples that lie in the header's bounds, to so many metres, or something is exchanged."""

SURE = 0.999
"""Share from which a change is believed."""

AXES = {"x and y": [1, 0, 2], "x and z": [2, 1, 0], "y and z": [0, 2, 1]}

UNITS = {2.0: "half as long", 0.5: "twice as long"}
"""What times must be multiplied by, and what they are."""


def misfit_of(source: PulseSource, records: NDArray[Any], pulses: Pulses, kinds: Samplings) -> str:
    """What pulses and waves, or places and header, contradict each other in; "" where nothing does."""
    return (
        stated_fault(records, pulses, kinds) or height_fault(source, pulses, kinds) or axes_fault(source, pulses, kinds)
    )


def stated_fault(records: NDArray[Any], pulses: Pulses, kinds: Samplings) -> str:
    """That pulses refer to the waves of others, or that times are not of the way there and back; "" where nothing
    says so. What a file states in no way that its waves follow says nothing."""
    parts = pulses.segments.take(kinds.kind[pulses.segments.sampling] == RETURNING)
    rows, first = np.unique(parts.pulse, return_index=True)
    if len(rows) < FEW:
        return ""
    unit = kinds.unit[records["bits"] & 0xFF][parts.pulse]
    end = parts.begin + np.maximum(0, parts.samples - 1) * kinds.spacing[parts.sampling]
    ends = np.stack([np.minimum.reduceat(parts.begin / unit, first), np.maximum.reduceat(end / unit, first)], axis=1)
    stated = np.stack([records["first"][rows], records["last"][rows]], axis=1).astype(np.int64)
    if _alike(ends, stated).mean() >= OWN:
        return ""
    if _in_another_order(ends, stated):
        return (
            "the waves of the pulses are those of other pulses: they begin and end as many others state it, but "
            f"{100 * _alike(ends, stated).mean():.0f} % of them as their own pulse does"
        )
    length = ends[:, 1:] - ends[:, :1]
    stated_length = _wrapped((stated[:, 1:] - stated[:, :1]).astype(np.float64))
    long = np.flatnonzero((length[:, 0] > 0.0) & (stated_length[:, 0] > 0.0))
    if len(long) >= FEW and (np.abs(_wrapped(ends - stated))[long, 0] <= 1.0).mean() >= ALL:
        ratio = float(np.median(stated_length[long, 0] / length[long, 0]))
        unlike = abs(ratio - 1.0) > ANOTHER
        if unlike and (np.abs(stated_length - ratio * length)[long, 0] <= 1.0 + ratio).mean() >= ALL:
            return (
                f"waves begin as the pulses state it, and last {1 / ratio:.3g} times as long: the sample spacing of "
                "their descriptor is another"
            )
    for factor, words in UNITS.items():
        begins = np.abs(_wrapped(factor * ends[:, 0] - stated[:, 0])) <= factor
        if begins.mean() >= ALL and (stated[:, 0] != 0).mean() >= ALL and (length > 0.0).any():
            return f"times from the anchors are {words} as the pulses state them: one way, or another unit"
    return ""


def height_fault(source: PulseSource, pulses: Pulses, kinds: Samplings) -> str:
    """That no returning sample lies between the heights of the header, and all would with times twice or half as long;
    "" where this is not so."""
    low, high = (float(v[2]) for v in reach(pulses, kinds))
    stated, anchor = (source.bounds[2], source.bounds[5]), float(np.median(pulses.anchor[:, 2]))
    if not np.isfinite([low, high, *stated]).all() or (low <= stated[1] and high >= stated[0]):
        return ""
    for factor, words in UNITS.items():
        ends = [anchor + factor * (v - anchor) for v in (low, high)]
        slack = SLACK * (anchor - low)
        if stated[0] - slack <= ends[0] and ends[1] <= stated[1] + slack:
            return (
                f"the samples lie at heights from {low:.0f} to {high:.0f} m, by the header from {stated[0]:.0f} to "
                f"{stated[1]:.0f} m, as they would with times that are not {words}: one way, or another unit"
            )
    return ""


def axes_fault(source: PulseSource, pulses: Pulses, kinds: Samplings) -> str:
    """That samples lie in the header's bounds only with axes exchanged or signs of the beams changed; "" where they
    lie there as they are, or with no such change: bounds that were made of wrong places tell nothing."""
    parts = pulses.segments.take(kinds.kind[pulses.segments.sampling] == RETURNING)
    box = np.array(source.bounds).reshape(2, 3)
    if source.mirrored or len(parts.pulse) < FEW or not np.isfinite(box).all():
        return ""
    lasts = parts.begin + np.maximum(0, parts.samples - 1) * kinds.spacing[parts.sampling]
    times = np.concatenate([parts.begin, lasts])[:, None]
    anchor, step = (np.concatenate([v[parts.pulse]] * 2) for v in (pulses.anchor, pulses.step))

    def inside(anchor: NDArray[np.float64], step: NDArray[np.float64]) -> float:
        place = anchor - times * step
        return float(((place >= box[0] - WITHIN) & (place <= box[1] + WITHIN)).all(axis=1).mean())

    known = inside(anchor, step)
    if known >= IN:
        return ""
    changed = {f"{n} of the pulses are exchanged": (anchor[:, k], step[:, k]) for n, k in AXES.items()}
    changed |= {f"{n} of the beams are exchanged": (anchor, step[:, k]) for n, k in AXES.items()}
    changed |= {
        f"the sign of the beams' {n} is wrong": (anchor, step * k)
        for n, k in {"x": (-1, 1, 1), "y": (1, -1, 1), "x and y (--mirror-beams)": (-1, -1, 1)}.items()
    }
    for words, (moved, turned) in changed.items():
        if inside(moved, turned) >= SURE:
            return f"{100 * known:.0f} % of the samples lie in the header's bounds, and all would otherwise: {words}"
    return ""


def _alike(ends: NDArray[np.float64], stated: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Pulses whose waves begin and end as stated, to a unit."""
    return np.asarray((np.abs(_wrapped(ends - stated)) <= 1.0).all(axis=1))


def _wrapped(time: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray((time + 0.5 * WRAPS) % WRAPS - 0.5 * WRAPS)


def _in_another_order(ends: NDArray[np.float64], stated: NDArray[np.int64]) -> bool:
    """Nearly all waves begin and end as some pulse states it, one to one."""
    keys = [np.rint(_wrapped(v.astype(np.float64))).astype(np.int64) for v in (ends, stated)]
    one, two = (np.unique(k[:, 0] * WRAPS + k[:, 1], return_counts=True) for k in keys)
    _, a, b = np.intersect1d(one[0], two[0], return_indices=True)
    return bool(np.minimum(one[1][a], two[1][b]).sum() >= ALL * len(ends))
