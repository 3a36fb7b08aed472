"""What a recording holds, and what is wrong with it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from fwclass.errors import InputError
from fwclass.graph.street_recordings import (
    NO_TRAJECTORY,
    TrajectoryFiles,
    implausible,
    open_on_trajectory,
    untested_words,
)
from fwclass.store.unchanged import check_unchanged
from fwclass.street.params import StreetParams
from fwclass.street.sphere_kernels import UNIT
from fwclass.street.track import Track


def info(path: Path, params: StreetParams, trajectory: TrajectoryFiles = NO_TRAJECTORY) -> dict[str, Any]:
    """Beams, times, way, counts by cause and remarks of a recording; plain data.

    A recording that ends in damage is told up to there.
    """
    with check_unchanged(path, *trajectory.files):
        return _facts(path, params, trajectory)


def _facts(path: Path, params: StreetParams, trajectory: TrajectoryFiles) -> dict[str, Any]:
    recording = open_on_trajectory(path, params, trajectory)
    track = Track(params, may_stand=True)
    times: list[float] = []
    places: list[int] = []
    labels = np.zeros(256, np.int64)
    moves, remarks = False, []
    try:
        for frame in recording.frames():
            moves |= math.isfinite(frame.speed) or math.isfinite(frame.place)
            placed = track.take(frame)
            if placed is not None:
                times.append(placed.time)
                places.append(placed.place)
                if placed.labels is not None:
                    labels += np.bincount(placed.labels[~np.isnan(placed.r)], minlength=256)
    except InputError as fault:
        if not track.frames:
            raise
        remarks.append(str(fault))
    steps = np.diff(times)
    scan = track.geometry.scan if track.geometry else None
    way = np.array(places) * UNIT
    summary: dict[str, Any] = {
        "recording": str(path),
        **recording.about,
        **track.counts(),
        "scan": None
        if scan is None
        else {
            "beams": scan.beams,
            "first_angle_deg": round(math.degrees(scan.first), 4),
            "last_angle_deg": round(math.degrees(scan.first + scan.step * (scan.beams - 1)), 4),
            "step_deg": round(math.degrees(scan.step), 5),
            "range_min": round(scan.range_min, 6),
            "range_max": round(scan.range_max, 6),
        },
        "seconds": float(times[-1] - times[0]) if times else 0.0,
        "period_ms": [round(1000 * float(f(steps)), 3) for f in (np.min, np.median, np.max)] if len(steps) else None,
        "moves": moves or params.speed is not None,
        "metres": float(np.ptp(way)) if len(way) else 0.0,
        "begins": float(way.min()) if len(way) else 0.0,
        "speed": [round(float(v), 3) for v in _speeds(way, np.array(times))],
        "labels": {str(k): int(n) for k, n in enumerate(labels) if n},
    }
    return {
        **summary,
        "remarks": [*remarks, *_remarks(summary, params), *untested_words(recording, summary)],
        "implausible": implausible(recording, summary, params),
    }


def _speeds(way: Any, times: Any) -> list[float]:
    """Lowest, median and highest speed [m/s]."""
    steps = np.diff(times)
    if not (steps > 0).any():
        return []
    speeds = np.diff(way)[steps > 0] / steps[steps > 0]
    return [float(speeds.min()), float(np.median(speeds)), float(speeds.max())]


def _remarks(summary: dict[str, Any], params: StreetParams) -> list[str]:
    said = []
    beams = summary["used"] * summary["scan"]["beams"] if summary["scan"] else 0
    if not summary["used"]:
        return ["no frame can be used"]
    for cause, count in summary["missing"].items():
        if count > 0.1 * beams:
            said.append(f"{100 * count / beams:.1f} % of the ranges are {cause}")
    if summary["blind"]:
        said.append(f"{summary['blind']} frames have no return at all: a blind scanner?")
    if not summary["moves"]:
        said.append("nothing tells how the vehicle moved: give street.speed")
    for cause, count in summary["faults"].items():
        if cause not in ("standing", "hardly moved") and not (cause == "no speed" and not summary["moves"]):
            said.append(f"{count} frames: {cause}")
    if summary["speed"] and summary["period_ms"] and summary["speed"][1] > 0:
        step = summary["speed"][1] * summary["period_ms"][1] / 1000
        needed = math.ceil(min(max(params.radii) / step, 1e9)) if math.isfinite(step) and step > 0 else 0
        if needed > params.most_frames:
            said.append(
                f"at {summary['speed'][1]:g} m/s a sphere of {max(params.radii):g} m reaches over {needed} frames to "
                f"each side; {params.most_frames} are held (street.most_frames)"
            )
    return said


def _measured(summary: dict[str, Any]) -> str:
    """How the frames of a LAS file were cut."""
    turn = summary["measured"]
    left = ", ".join(f"{n} {cause}" for cause, n in summary["left_out"].items())
    return (
        f"measured    {summary['rows']} points, times {turn['times']}; a frame every {turn['period_ms']:.3f} ms "
        f"({turn['even_percent']:.1f} % on it), beams every {turn['step_deg']:.4f}°"
        + (f"; left out: {left}" if left else "")
    )


def describe(summary: dict[str, Any]) -> str:
    """The same for a terminal."""
    scan = summary["scan"] or {}
    lines = [f"{summary['recording']}: {summary['kind']}, {summary['frames']} frames, {summary['used']} used"]
    if summary.get("topic"):
        lines.append(f"topic       {summary['topic']}")
        lines += [f"            {name}: {n}" for name, n in summary["topics"].items()]
    if summary.get("measured"):
        lines.append(_measured(summary))
    if scan:
        lines.append(
            f"beams       {scan['beams']} of {scan['first_angle_deg']:g} to {scan['last_angle_deg']:g}° by "
            f"{scan['step_deg']:g}°, ranges {scan['range_min']:g} to {scan['range_max']:g} m"
        )
    if summary["period_ms"]:
        low, middle, high = summary["period_ms"]
        lines.append(f"time        {summary['seconds']:.2f} s, a frame every {middle:g} ms ({low:g} to {high:g})")
    speed = f", {summary['speed'][0]:g} to {summary['speed'][2]:g} m/s" if summary["speed"] else ""
    begin, end = summary["begins"], summary["begins"] + summary["metres"]
    between = f" ({begin:.2f} to {end:.2f})" if abs(begin) >= 0.01 else ""
    lines.append(f"road        {summary['metres']:.2f} m{between}{speed}")
    beams = summary["used"] * scan.get("beams", 0)
    lines.append(f"returns     {summary['returns']} of {beams} ranges")
    lines += [f"            {n} {cause}" for cause, n in summary["missing"].items() if n]
    if summary["faults"]:
        lines.append("frames      " + ", ".join(f"{n} {cause}" for cause, n in summary["faults"].items()))
    if summary["labels"]:
        lines.append("labels      " + ", ".join(f"{k}: {n}" for k, n in summary["labels"].items()))
    lines += [f"remark      {text}" for text in summary["remarks"]]
    lines += [f"  ! {text}" for text in summary["implausible"]]
    return "\n".join(lines)
