"""The aircraft's path and attitude, the strips, and where every pulse starts and points."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.simulate.noise import clock_errors, normal_table
from fwclass.simulate.params import Recording, SimulateParams
from fwclass.units import METRES_PER_NS

OVERSHOOT = 5.0
"""How far beyond the survey area the scanner fires, so that wobble leaves no ragged edge [m]."""


@dataclass(frozen=True)
class StripPlan:
    """One strip before it is flown.

    Attributes
    ----------
    number : place in the survey, from 0; its `point_source_id` is one more.
    name : stem of its files.
    x : easting of the flight line, relative to the survey's corner [m].
    north : whether it is flown towards north (or south).
    lines, per_line : scan lines, and pulses in each.
    spacing : distance between scan lines [m].
    left, right : scan angles of a line's first and last pulse, towards +x [rad].
    first_time : GPS time of the first pulse [s].
    recording : how it is written.
    """

    number: int
    name: str
    x: float
    north: bool
    lines: int
    per_line: int
    spacing: float
    left: float
    right: float
    first_time: float
    recording: Recording

    @property
    def pulses(self) -> int:
        """Number of pulses of the strip."""
        return self.lines * self.per_line


def plan_strips(params: SimulateParams) -> list[StripPlan]:
    """The survey's strips, west to east, flown north and south in turn.

    Scan lines end a little beyond the survey area's edge; lines and pulses are equally far apart, such that all strips
    together fire `pulse_density` pulses per square metre.
    """
    size, flight = params.size, params.flight
    half = math.radians(flight.field_of_view) / 2.0
    lines_x = [(k + 0.5) * size / params.strips for k in range(params.strips)]
    angles = [
        (
            max(-half, -math.atan((x + OVERSHOOT) / flight.height)),
            min(half, math.atan((size - x + OVERSHOOT) / flight.height)),
        )
        for x in lines_x
    ]
    widths = [flight.height * (math.tan(b) - math.tan(a)) for a, b in angles]
    spacing = math.sqrt(sum(widths) / (params.pulse_density * size))
    lines = round((size + 2.0 * OVERSHOOT) / spacing)
    every = (size + 2.0 * OVERSHOOT) / flight.speed + flight.turn
    return [
        StripPlan(
            number=k,
            name=f"strip_{k + 1:02d}",
            x=lines_x[k],
            north=k % 2 == 0,
            lines=lines,
            per_line=max(1, round(widths[k] / spacing)),
            spacing=spacing,
            left=angles[k][0],
            right=angles[k][1],
            first_time=flight.first_gps_time + k * every,
            recording=params.recordings[k % len(params.recordings)],
        )
        for k in range(params.strips)
    ]


@dataclass(frozen=True)
class Pose:
    """Position [m, relative to the survey's corner and base height] and attitude [rad] of the scanner.

    Roll is positive with the right wing down, pitch with the nose up, heading clockwise from north.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    roll: NDArray[np.float64]
    pitch: NDArray[np.float64]
    heading: NDArray[np.float64]


def _wobble(random: np.random.Generator, time: NDArray[np.float64], periods: tuple[float, ...]) -> NDArray[np.float64]:
    """A sum of sines of unit standard deviation."""
    out = np.zeros_like(time)
    for period in periods:
        phase, rate = random.uniform(0, 2 * math.pi), random.uniform(0.85, 1.15) * 2 * math.pi / period
        out += np.sin(phase + rate * time)
    return out * math.sqrt(2.0 / len(periods))


def pose(params: SimulateParams, strip: StripPlan, time: NDArray[np.float64]) -> Pose:
    """Where the scanner of this strip is [m, rad], `time` (pulses,) [s] after its first pulse."""
    random = np.random.default_rng([params.seed, 3, strip.number])
    flight = params.flight
    along = flight.speed * time - OVERSHOOT
    slow, quick = (11.0, 5.3, 3.1), (4.1, 1.9, 0.9)
    drift = flight.drift * _wobble(random, time, slow)
    climb = flight.drift * _wobble(random, time, slow)
    roll = math.radians(flight.roll) * _wobble(random, time, quick)
    pitch = math.radians(flight.pitch) * _wobble(random, time, quick)
    heading = math.radians(flight.heading) * _wobble(random, time, slow)
    return Pose(
        x=strip.x + drift,
        y=along if strip.north else params.size - along,
        z=flight.height + climb,
        roll=roll,
        pitch=pitch,
        heading=heading + (0.0 if strip.north else math.pi),
    )


def measure_pose(params: SimulateParams, strip: StripPlan, at: Pose, time: NDArray[np.float64]) -> Pose:
    """The pose `at` [m, rad] as the navigation has it: with errors that drift slowly and differ from strip to strip."""
    random = np.random.default_rng([params.seed, 4, strip.number])
    metres, degrees = params.flight.position_error, params.flight.attitude_error
    shift = [metres * _wobble(random, time, (140.0, 60.0, 25.0)) for _ in range(3)]
    turn = [math.radians(degrees) * _wobble(random, time, (90.0, 40.0, 15.0)) for _ in range(3)]
    return Pose(
        x=at.x + shift[0],
        y=at.y + shift[1],
        z=at.z + shift[2],
        roll=at.roll + turn[0],
        pitch=at.pitch + turn[1],
        heading=at.heading + 3.0 * turn[2],
    )


@dataclass(frozen=True)
class Pulses:
    """Consecutive pulses.

    Attributes
    ----------
    time : seconds since the strip's first pulse.
    origin, direction : (n, 3), where each starts and its unit vector.
    measured_origin, measured_direction : the same as navigation and clock have them; what is written.
    scan_angle : degrees from nadir with roll, positive to the right.
    """

    time: NDArray[np.float64]
    origin: NDArray[np.float64]
    direction: NDArray[np.float64]
    measured_origin: NDArray[np.float64]
    measured_direction: NDArray[np.float64]
    scan_angle: NDArray[np.float64]


def _beam(at: Pose, scan: NDArray[np.float64]) -> NDArray[np.float64]:
    angle = scan + at.roll
    c, s = np.cos(at.heading), np.sin(at.heading)
    sideways, ahead, down = np.sin(angle), np.cos(angle) * np.sin(at.pitch), np.cos(angle) * np.cos(at.pitch)
    return np.column_stack([sideways * c + ahead * s, ahead * c - sideways * s, -down])


def fire(params: SimulateParams, strip: StripPlan, first: int, count: int) -> Pulses:
    """Pulses `first` to `first + count` of the strip, arrays (count, …) of `Pulses` [m, s]; each depends on its own
    number only."""
    number = np.arange(first, first + count)
    line, place = np.divmod(number, strip.per_line)
    time = line * (strip.spacing / params.flight.speed) + place / params.sensor.pulse_rate
    at = pose(params, strip, time)
    measured = measure_pose(params, strip, at, time)
    to_east = strip.left + (strip.right - strip.left) * (place + 0.5) / strip.per_line
    scan = to_east if strip.north else -to_east
    direction = _beam(measured, scan)
    late = np.empty(count)
    clock_errors(normal_table(), params.seed, strip.number, first, late)
    late *= params.sensor.clock_jitter * METRES_PER_NS
    return Pulses(
        time=time,
        origin=np.column_stack([at.x, at.y, at.z]),
        direction=_beam(at, scan),
        measured_origin=np.column_stack([measured.x, measured.y, measured.z]) + late[:, None] * direction,
        measured_direction=direction,
        scan_angle=np.degrees(scan + measured.roll),
    )
