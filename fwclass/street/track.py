"""Which frames of a recording can be used, and where along the road they were taken."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.street.frames import FARTHEST, Frame, Geometry, Placed, levels_of
from fwclass.street.params import StreetParams
from fwclass.street.place_kernels import CAUSES, place_frame
from fwclass.street.soundness import FEWEST_ROAD, Soundness
from fwclass.street.sphere_kernels import UNIT

FASTEST, LATEST, ROUND_THE_EARTH = 100.0, 1e10, 4e7
"""Speeds [m/s], times [s] and places [m] beyond these are no values."""

MOST_MISSING = 3
"""Frames one after the other that may be missing again and again."""

NEARLY = 0.2
"""Of a step that it may be longer or shorter than others: clocks of hosts, not of scanners."""

STILL = 0.0005
"""m between frames, up to which a vehicle stands."""

WANDER = 0.2
"""m, over which places of a vehicle that stands may wander: no way."""

FAULTS = (
    "out of order",
    "doubled",
    "other beams",
    "other limits",
    "no intensities",
    "clock leaps",
    "dropped before",
    "reversing",
    "standing",
    "hardly moved",
    "no speed",
    "impossible speed or place",
)
"""What frames are counted for; the first five are left out."""


def usual_step(steps: Sequence[float]) -> float:
    """Time from one frame to the next [s], where some are missing between: the median of `steps` [s], or a shorter one
    where nearly all are that or a few times as long (every third frame is missing: 1, 2, 1, 2)."""
    values = np.asarray(steps)
    shortest = float(np.quantile(values, 0.25, method="lower"))
    period = float(np.median(values[values < 1.5 * shortest]))
    times = np.rint(values / period)
    fits = (times >= 1) & (times <= MOST_MISSING + 1) & (np.abs(values / period - times) < NEARLY)
    return period if fits.mean() > 0.9 else float(np.median(values))


@dataclass
class Track:
    """Takes frames one after the other: leaves out what cannot be used, and places the others along the road.

    What it says of a frame follows from the frames before it alone: the same on-line and in a recording. A vehicle that
    nothing tells the way of stands where it `may_stand`, else it is an error. `period` is the time from one of the
    first frames to the next [s], as `usual_step` has it; NaN of fewer than two.
    """

    params: StreetParams
    may_stand: bool = False
    faults: Counter[str] = field(default_factory=Counter)
    missing: NDArray[np.int64] = field(default_factory=lambda: np.zeros(len(CAUSES), np.int64))
    frames: int = 0
    used: int = 0
    returns: int = 0
    blind: int = 0
    geometry: Geometry | None = None
    period: float = math.nan
    sound: Soundness = field(init=False)
    _time: float = math.nan
    _number: int = -1
    _along: float = 0.0
    _speed: float = math.nan
    _given: float = math.nan
    _bridged: float = 0.0
    _steps: list[float] = field(default_factory=list)
    _road: float = math.nan
    _moved: bool = False
    _been: tuple[float, float] = (math.nan, math.nan)
    _due: float = field(init=False)

    def __post_init__(self) -> None:
        self.sound = Soundness(self.params)
        self._due = self.params.stood

    def take(self, frame: Frame) -> Placed | None:
        """The frame with its coordinates, or None if it is left out."""
        self.frames += 1
        if self.geometry is None:
            self.geometry = Geometry.of(frame.scan, self.params.mounting)
            self._road = -self.params.mounting.height
        if not frame.scan.like(self.geometry.scan) or len(frame.ranges) != frame.scan.beams:
            self.faults["other beams"] += 1
            return None
        if not frame.scan.reaches_like(self.geometry.scan):
            self.faults["other limits"] += 1
            return None
        if self.params.intensity is not None and not self._has_light(frame):
            self.faults["no intensities"] += 1
            return None
        if not self._in_time(frame):
            return None
        self.used += 1
        return self._place_frame(frame, self.geometry)

    def _has_light(self, frame: Frame) -> bool:
        """Whether one of the frame's returns has an intensity, or it has no return; `InputError` where no frame had one
        before it."""
        limits = frame.scan.range_min, min(frame.scan.range_max, FARTHEST)
        returns = (frame.ranges >= limits[0]) & (frame.ranges < limits[1])
        light = frame.intensities
        lit = light is not None and len(light) == len(returns) and not np.isnan(light[returns]).all()
        if lit or not returns.any():
            return True
        if self.used:
            return False
        raise InputError(
            "the frames have no intensities",
            where=f"frame {frame.number}",
            expected="one a beam: street.intensity, or the model, asks for them",
            got="none",
            do="record them (LaserScan.intensities, a column of Parquet), or train without: street.intensity=null",
        )

    def _in_time(self, frame: Frame) -> bool:
        """Whether the frame comes after the one before; how far along the road it is."""
        if not abs(frame.time) <= LATEST:
            self.faults["out of order"] += 1
            return False
        step, leaps = frame.time - self._time if self.used else 0.0, False
        if self.used and -self.params.clock_jump <= step <= 0:
            self.faults["doubled" if step == 0 else "out of order"] += 1
            return False
        period = self.period
        if abs(step) > self.params.clock_jump:
            self.faults["clock leaps"] += 1
            leaps = True
            step = period if math.isfinite(period) and step < 0 else max(step, 0.0)
        elif math.isfinite(period) and step > 1.5 * period:
            self.faults["dropped before"] += round(min(step / period, 1e9)) - 1
        if self.used and len(self._steps) < 99 and step > 0:
            self._steps.append(step)
            self.period = usual_step(self._steps)
        self._advance(frame, step, leaps)
        self._time = frame.time
        return True

    def _advance(self, frame: Frame, step: float, leaps: bool) -> None:
        place, speed_given = self._within(frame.place, ROUND_THE_EARTH), self._within(frame.speed, FASTEST)
        placed, bridged = math.isfinite(place), self._bridged != 0.0
        if placed:
            moved = self._to_place(place, speed_given, step, leaps)
        else:
            speed = speed_given if math.isfinite(speed_given) else self.params.speed
            if speed is None:
                self.faults["no speed"] += 1
                speed = self._speed
            if not math.isfinite(speed) and self.may_stand:
                speed = 0.0
            if not math.isfinite(speed):
                raise InputError(
                    "nothing tells how the vehicle moved",
                    where=f"frame {frame.number}",
                    expected="a column speed or place, a trajectory of this time, or street.speed",
                    got=f"none of them at {frame.time:.3f} s",
                    do="give --set street.speed=M_PER_S, or odometry in the recording (fwclass street info)",
                )
            self._speed = speed
            moved = speed * step
            self._bridged += moved
        self._along += moved
        self._moved = abs(moved) > STILL
        if self.used:
            self.sound.move(moved, step, speed_given, placed and not bridged, leaps)
            self.faults["reversing"] += moved < 0
            self.faults["standing"] += moved == 0

    def _to_place(self, place: float, speed: float, step: float, leaps: bool) -> float:
        """How far it is to `place`, past what was bridged by speed since the place before [m]."""
        speed = speed if math.isfinite(speed) else self._speed
        by_speed = speed * step if math.isfinite(speed) else 0.0
        if math.isfinite(self._given):
            moved = place - self._given - self._bridged
            if self._bridged and not leaps:
                self.sound.bridge(place - self._given, self._bridged + by_speed)
        elif self.used:
            moved = by_speed
        else:
            self._along, moved = place, 0.0
        self._given, self._bridged = place, 0.0
        return moved

    def _within(self, value: float, most: float) -> float:
        """`value`, or NaN for one that is beyond `most`, which is counted."""
        if abs(value) <= most or math.isnan(value):
            return value
        self.faults["impossible speed or place"] += 1
        return math.nan

    def _place_frame(self, frame: Frame, geometry: Geometry) -> Placed:
        beams = geometry.scan.beams
        x = np.empty(beams if geometry.tilted else 0, np.int32)
        y, z, r = np.empty(beams, np.int32), np.empty(beams, np.int32), np.empty(beams, np.float32)
        under = np.empty(beams)
        limits = geometry.scan.range_min, min(geometry.scan.range_max, FARTHEST)
        below = -0.5 * self.params.mounting.height
        near = self.params.road_half_width
        count = place_frame(frame.ranges, geometry.direction, *limits, near, below, x, y, z, r, self.missing, under)
        place = round(self._along / UNIT)
        self.sound.see(frame.ranges, limits[0], geometry.direction, place, (x, y, z, r), self._moved)
        light = np.empty(0, np.int32)
        if self.params.intensity is not None:
            given = np.full(beams, np.nan, np.float32) if frame.intensities is None else frame.intensities
            light = levels_of(given, self.params.intensity)
            self.sound.see_light(given[~np.isnan(r)])
        here = beams - int(np.isnan(r).sum())
        self.returns += here
        self.blind += here == 0
        if count >= FEWEST_ROAD and self.params.features == "height":
            self._road = float(np.median(under[:count]))
        return Placed(frame.number, frame.time, place, self._road, x, y, z, r, light, frame.labels, self._repeats())

    def _repeats(self) -> bool:
        """Whether enough frames were taken of the road that the vehicle went, which is counted.

        One is in `street.spacing` metres of new road, and `street.stood` may be saved up; what lies within `WANDER` of
        where the vehicle was is not new.
        """
        along = self._along
        low, high = self._been if self.used > 1 else (along, along)
        new = max(low - along, along - high, 0.0)
        self._been = (min(max(low, along - WANDER), along), max(min(high, along + WANDER), along))
        self._due = min(self.params.stood, self._due + new / self.params.spacing)
        if self._due < 1.0:
            self.faults["hardly moved"] += 1
            return True
        self._due -= 1.0
        return False

    def counts(self) -> dict[str, Any]:
        """Counts by cause, plain data."""
        return {
            "frames": self.frames,
            "used": self.used,
            "returns": self.returns,
            "blind": self.blind,
            "missing": dict(zip(CAUSES, self.missing.tolist(), strict=True)),
            "faults": {name: self.faults[name] for name in FAULTS if self.faults[name]},
            "sound": self.sound.facts(),
        }
