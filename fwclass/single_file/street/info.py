"""What a recording holds, and what is wrong with it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from fwclass.errors import InputError
from fwclass.graph.street_recordings import NO_TRAJECTORY, TrajectoryFiles, opened
from fwclass.street.frames import Track
from fwclass.street.params import StreetParams
from fwclass.street.sphere_kernels import UNIT


def info(path: Path, params: StreetParams, trajectory: TrajectoryFiles = NO_TRAJECTORY) -> dict[str, Any]:
    """Beams, times, way, counts by cause and remarks of a recording; plain data.

    A recording that ends in damage is told up to there.
    """
    recording = opened(path, params, trajectory)
    track = Track(params if params.speed is not None else params.model_copy(update={"speed": 0.0}))
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
    made: dict[str, Any] = {
        "recording": str(path),
        **recording.told,
        **track.told(),
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
        "speed": [round(float(v), 3) for v in _speeds(way, np.array(times))],
        "labels": {str(k): int(n) for k, n in enumerate(labels) if n},
    }
    return {**made, "remarks": remarks + _remarks(made, params)}


def _speeds(way: Any, times: Any) -> list[float]:
    """Lowest, median and highest speed [m/s]."""
    steps = np.diff(times)
    if not (steps > 0).any():
        return []
    speeds = np.diff(way)[steps > 0] / steps[steps > 0]
    return [float(speeds.min()), float(np.median(speeds)), float(speeds.max())]


def _remarks(made: dict[str, Any], params: StreetParams) -> list[str]:
    said = []
    beams = made["used"] * made["scan"]["beams"] if made["scan"] else 0
    if not made["used"]:
        return ["no frame can be used"]
    for cause, count in made["missing"].items():
        if count > 0.1 * beams:
            said.append(f"{100 * count / beams:.1f} % of the ranges are {cause}")
    if made["blind"]:
        said.append(f"{made['blind']} frames have no return at all: a blind scanner?")
    if not made["moves"]:
        said.append("nothing tells how the vehicle moved: give street.speed")
    for cause, count in made["faults"].items():
        if cause != "standing" and not (cause == "no speed" and not made["moves"]):
            said.append(f"{count} frames: {cause}")
    if made["speed"] and made["period_ms"] and made["speed"][1] > 0:
        step = made["speed"][1] * made["period_ms"][1] / 1000
        needed = math.ceil(min(max(params.radii) / step, 1e9)) if math.isfinite(step) and step > 0 else 0
        if needed > params.most_frames:
            said.append(
                f"at {made['speed'][1]:g} m/s a sphere of {max(params.radii):g} m reaches over {needed} frames to "
                f"each side; {params.most_frames} are held (street.most_frames)"
            )
    return said


def _measured(made: dict[str, Any]) -> str:
    """How the frames of a LAS file were cut."""
    turn = made["measured"]
    left = ", ".join(f"{n} {cause}" for cause, n in made["left_out"].items())
    return (
        f"measured    {made['rows']} points, times {turn['times']}; a frame every {turn['period_ms']:.3f} ms "
        f"({turn['even_percent']:.1f} % on it), beams every {turn['step_deg']:.4f}°"
        + (f"; left out: {left}" if left else "")
    )


def describe(made: dict[str, Any]) -> str:
    """The same for a terminal."""
    scan = made["scan"] or {}
    lines = [f"{made['recording']}: {made['kind']}, {made['frames']} frames, {made['used']} used"]
    if made.get("topic"):
        lines.append(f"topic       {made['topic']}")
        lines += [f"            {name}: {n}" for name, n in made["topics"].items()]
    if made.get("measured"):
        lines.append(_measured(made))
    if scan:
        lines.append(
            f"beams       {scan['beams']} of {scan['first_angle_deg']:g} to {scan['last_angle_deg']:g}° by "
            f"{scan['step_deg']:g}°, ranges {scan['range_min']:g} to {scan['range_max']:g} m"
        )
    if made["period_ms"]:
        low, middle, high = made["period_ms"]
        lines.append(f"time        {made['seconds']:.2f} s, a frame every {middle:g} ms ({low:g} to {high:g})")
    speed = f", {made['speed'][0]:g} to {made['speed'][2]:g} m/s" if made["speed"] else ""
    lines.append(f"road        {made['metres']:.2f} m{speed}")
    beams = made["used"] * scan.get("beams", 0)
    lines.append(f"returns     {made['returns']} of {beams} ranges")
    lines += [f"            {n} {cause}" for cause, n in made["missing"].items() if n]
    if made["faults"]:
        lines.append("frames      " + ", ".join(f"{n} {cause}" for cause, n in made["faults"].items()))
    if made["labels"]:
        lines.append("labels      " + ", ".join(f"{k}: {n}" for k, n in made["labels"].items()))
    lines += [f"remark      {text}" for text in made["remarks"]]
    return "\n".join(lines)
