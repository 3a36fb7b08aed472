"""Frames out of a stream of points: what turns, how fast, and which point is which beam of which frame.

A 2-D scanner's mirror turns evenly: the angle of a return grows with its time, so that time less angle over rate is the
time at which its frame began. Rate, period and the step between beams are measured on the first points.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError

FEWEST = 200
"""Points, and a twentieth as many frames, that a scanner is measured by."""

BACK = 0.25
"""Share of the whole field by which an angle that goes back begins a frame; noise and edges go back by less."""

STAMPED = 4
"""Points with one time, in the middle, where a file has a time a frame instead of a time a beam."""

EVEN, REGULAR = 0.25, 0.8
"""Frames are those of a scanner if `REGULAR` of them begin within `EVEN` periods of a whole number of periods."""

DISORDER = 0.01
"""Share of the times that may go back: points of one frame are written in any order."""

FALL = 1.0
"""Seconds by which no time goes back: what is longer than a frame is another clock, or the end of a GPS week."""

ON = 0.25
"""Share of the times of a file with a time a frame from which on they are no frames': those begin anew, and where the
next time goes on in angle where the last one ended, times were rounded."""

NEAR_GAP, FAR_GAP = 8, 200
"""Beams without a return over which the next is still counted, while the step is rough, and once it is better."""


@dataclass(frozen=True)
class Turning:
    """How a scanner turns, as measured.

    `slope`: seconds per radian by which a frame's points are later than its begin; 0 where a frame has one time.
    `first`, `step`: angle of the first beam, between beams [rad]. `beams`: of the field that was seen. `period`:
    between frames [s]. `even`: share of the frames that begin on the period.
    """

    slope: float
    first: float
    step: float
    beams: int
    period: float
    even: float

    def begin(self, time: NDArray[np.float64], angle: NDArray[np.float64]) -> NDArray[np.float64]:
        """When the frame of each point began [s]."""
        return time - self.slope * (angle - self.first)

    def summary(self) -> dict[str, Any]:
        """What was measured, plain data."""
        return {
            "period_ms": 1000.0 * self.period,
            "even_percent": 100.0 * self.even,
            "step_deg": math.degrees(self.step),
            "first_angle_deg": math.degrees(self.first),
            "beams": self.beams,
            "times": "one a beam" if self.slope else "one a frame",
        }


def check_times(time: NDArray[np.float64], where: object) -> None:
    """`InputError` for too few points, for times [s] that are all one, or in no order."""
    if len(time) < FEWEST:
        raise _refusal("too few points to tell how a scanner turned", where, f"at least {FEWEST}", len(time))
    steps = np.diff(time)
    if not (steps != 0).any():
        raise _refusal(
            "all points have one time", where, "GPS times of every beam, or of every frame", f"{time[0]:g} s"
        )
    back = float(np.mean(steps < 0))
    if back > DISORDER:
        raise InputError(
            "the points are in no order of time",
            where=where,
            expected=f"GPS times that rise; up to {100 * DISORDER:g} % may go back",
            got=f"{100 * back:.1f} % do",
            do="sort the file by GPS time (PDAL: filters.sort), and let it have one scanner",
        )
    check_falls(time, where)


def check_falls(time: NDArray[np.float64], where: object) -> None:
    """`InputError` for times [s], in the order of the file, that go back by more than `FALL`."""
    steps = np.diff(time)
    if not len(steps) or steps.min() >= -FALL:
        return
    at = int(np.argmin(steps))
    raise InputError(
        "the times go back",
        where=where,
        expected=f"GPS times that rise; those of one frame may go back by up to {FALL:g} s",
        got=f"{time[at + 1]:.3f} after {time[at]:.3f} s",
        do="cut the file there if seconds of the week begin anew, or sort it by GPS time (PDAL: filters.sort)",
    )


def measure_scanner(time: NDArray[np.float64], angle: NDArray[np.float64], most_beams: int, where: object) -> Turning:
    """The scanner of some consecutive points, whose times `check_times` let pass.

    Parameters
    ----------
    time [s], angle [rad] : of each point, in the order of the file.

    `InputError`: too few frames, or such as no 2-D scanner makes.
    """
    steps = np.diff(time)
    low, high = float(angle.min()), float(angle.max())
    turn = np.diff(angle)
    sense = float(np.sign(np.median(turn)))
    edges = np.flatnonzero(steps != 0 if _is_stamped(time) else sense * turn < -BACK * (high - low)) + 1
    slope = 0.0 if _is_stamped(time) else _slope(time, angle, edges)
    if not slope and (on := _share_going_on(sense * angle, edges)) > ON:
        raise InputError(
            "the times are too coarse to tell frames",
            where=where,
            expected="GPS times of every beam, or one of every frame",
            got=f"{100 * on:.0f} % of the times go on in angle where the one before ended, as rounded ones do",
            do="export the points with times as they were measured (microseconds)",
        )
    begin = time - slope * (angle - low)
    if len(edges) < FEWEST / 20:
        raise _refusal("too few frames to tell how a scanner turned", where, f"at least {FEWEST // 20}", len(edges))
    period = float(np.median(np.diff([np.median(part) for part in np.split(begin, edges)])))
    edges = np.flatnonzero(np.abs(np.diff(begin)) > 0.5 * period) + 1
    starts = np.array([np.median(part) for part in np.split(begin, edges)])
    turns = np.diff(starts) / period if period > 0 else np.zeros(len(starts) - 1)
    even = float(np.mean((np.abs(turns - np.rint(turns)) < EVEN) & (turns > 0.5)))
    if even < REGULAR:
        raise InputError(
            "the times are not those of a 2-D scanner's frames",
            where=where,
            expected=f"{100 * REGULAR:g} % of the frames a whole number of periods apart",
            got=f"{100 * even:.0f} % at a period of {1000 * period:.3f} ms",
            do="give one line scanner's points alone (user data or point source tell scanners apart), and check that "
            "the trajectory is the scanner's own way, its height too",
        )
    step = _step(angle, edges)
    beams = round((high - low) / step) + 1 if step > 0 else 0
    if not 2 <= beams <= most_beams:
        raise _refusal("no step between beams can be measured", where, f"2 to {most_beams} beams", beams)
    return Turning(slope, low, step, beams, period, even)


def _is_stamped(time: NDArray[np.float64]) -> bool:
    runs = np.diff(np.flatnonzero(np.concatenate([[True], np.diff(time) != 0, [True]])))
    return float(np.median(runs)) >= STAMPED


def _share_going_on(angle: NDArray[np.float64], edges: NDArray[np.int64]) -> float:
    """Of the groups of points that begin at `edges`: how many begin, in angle, where the one before ends."""
    if not len(edges):
        return 0.0
    begins = np.concatenate([[0], edges])
    low, high = np.minimum.reduceat(angle, begins), np.maximum.reduceat(angle, begins)
    span = high - low
    return float(np.mean(low[1:] > high[:-1] - 0.1 * np.maximum(span[1:], span[:-1])))


def _slope(time: NDArray[np.float64], angle: NDArray[np.float64], edges: NDArray[np.int64]) -> float:
    """Seconds per radian, by least squares within frames that begin at `edges`."""
    frame = np.zeros(len(time), np.int64)
    frame[edges] = 1
    frame = np.cumsum(frame)
    count = np.bincount(frame).astype(float)
    t, a = (v - (np.bincount(frame, v) / count)[frame] for v in (time - time[0], angle))
    across = float(a @ a)
    return float(t @ a) / across if across > 0 else 0.0


def _step(angle: NDArray[np.float64], edges: NDArray[np.int64]) -> float:
    """Between beams [rad]: the most common small step, then that by which whole runs of beams fit best."""
    turn = np.diff(angle)
    inside = np.ones(len(turn), bool)
    inside[edges - 1] = False
    sense = float(np.sign(np.median(turn[inside])))
    forward = sense * turn
    step = float(np.median(forward[inside & (forward > 0)])) if sense else 0.0
    for gap in (NEAR_GAP, FAR_GAP, FAR_GAP):
        if step <= 0:
            return 0.0
        whole = np.rint(forward / step)
        run = np.concatenate([[0], np.cumsum(~inside | (whole < 1) | (whole > gap))])
        beam = np.concatenate([[0], np.cumsum(np.where(inside, whole, 0))])
        count = np.bincount(run).astype(float)
        b, a = (v - (np.bincount(run, v) / count)[run] for v in (beam, sense * angle))
        across = float(b @ b)
        step = float(a @ b) / across if across > 0 else 0.0
    return step


@dataclass
class Cutter:
    """Takes points in order and gives whole frames; holds the last one until another begins.

    `doubled`: points that fell into a beam with a nearer one. `outside`: those beyond the field that was measured.
    """

    turning: Turning
    doubled: int = 0
    outside: int = 0

    def __post_init__(self) -> None:
        self._held: list[NDArray[Any]] = []

    def take(
        self, time: NDArray, angle: NDArray, r: NDArray, codes: NDArray, light: NDArray
    ) -> list[tuple[NDArray[Any], ...]]:
        """(time, angle, range, class code, intensity) of every frame that is whole, of points [s, rad, m]."""
        now = [time, angle, r, codes, light]
        if self._held:
            now = [np.concatenate(pair) for pair in zip(self._held, now, strict=True)]
        edges = self._cuts(now)
        pieces = [np.split(v, edges) for v in now]
        self._held = [p[-1] for p in pieces]
        return list(zip(*(p[:-1] for p in pieces), strict=True))

    def rest(self) -> list[tuple[NDArray[Any], ...]]:
        """The last frame."""
        frames, self._held = self._held, []
        return [tuple(frames)] if frames and len(frames[0]) else []

    def _cuts(self, now: list[NDArray[Any]]) -> NDArray[np.int64]:
        begin = self.turning.begin(now[0], now[1])
        return np.flatnonzero(np.abs(np.diff(begin)) > 0.5 * self.turning.period) + 1

    def beams(
        self, time: NDArray, angle: NDArray, r: NDArray, codes: NDArray, light: NDArray
    ) -> tuple[float, NDArray[np.float32], NDArray[np.uint8], NDArray[np.float32]]:
        """Begin [s], ranges (beams,) [m], NaN where none came, class codes and intensities (beams,) of a frame.

        A frame's beams lie on the common step with a shift of its own (the vehicle's roll), which is left out: half a
        step at most.
        """
        turning = self.turning
        place = (angle - turning.first) / turning.step
        shift = float(np.angle(np.exp(2j * np.pi * place).mean())) / (2.0 * np.pi)
        beam = np.rint(place - shift).astype(np.int64)
        inside = (beam >= 0) & (beam < turning.beams)
        self.outside += int((~inside).sum())
        order = np.flatnonzero(inside)[np.argsort(-r[inside], kind="stable")]
        ranges, labels = np.full(turning.beams, np.nan, np.float32), np.zeros(turning.beams, np.uint8)
        bright = np.zeros(turning.beams, np.float32)
        # of two in a beam the nearer stays
        ranges[beam[order]], labels[beam[order]], bright[beam[order]] = r[order], codes[order], light[order]
        self.doubled += len(order) - int(np.isfinite(ranges).sum())
        return float(np.median(turning.begin(time, angle))), ranges, labels, bright


def _refusal(what: str, where: object, expected: str, got: object) -> InputError:
    return InputError(
        what,
        where=where,
        expected=expected,
        got=got,
        do="export the points of one 2-D scanner with their GPS times, in order of time",
    )
