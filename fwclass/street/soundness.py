"""Whether a recording is what it says: measured on its own frames as they pass, told, and judged at its end."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import refuse_unsound
from fwclass.street.params import StreetParams
from fwclass.street.sphere_kernels import UNIT
from fwclass.street.way import Way

HELD = 2000
"""Values of a measure that are kept; beyond, every other one goes, and half as many come."""

FEWEST_ROAD = 5
"""Returns beside the vehicle that tell where the road is."""

LAG = 20
"""Frames apart, half a second, over which what a beam sees changes more than from one frame to the next if it moves."""

WIDE = 0.5
"""m, over which returns must spread to tell how it leans."""


@dataclass
class Thinned:
    """The values of a measure, evenly over a recording of any length; which are kept follows from their order alone."""

    values: list[float] = field(default_factory=list)
    every: int = 1
    seen: int = 0

    def add(self, value: float) -> None:
        """One more value."""
        if self.seen % self.every == 0:
            self.values.append(value)
            if len(self.values) > HELD:
                self.values, self.every = self.values[::2], 2 * self.every
        self.seen += 1

    @property
    def median(self) -> float | None:
        """The middle one; None of none."""
        return float(np.median(self.values)) if self.values else None


@dataclass
class Soundness:
    """What the used frames of a recording show of themselves.

    `frozen`: frames whose ranges are those of the frame before to the last digit, though the vehicle moved. `light`:
    returns, those whose intensity is above `street.intensity`, above `SoundParams.least_light` of it, missing.
    `changed`: (state, lag, sum and count): shares of the beams whose range changed by more than `SoundParams.change`
    since the frame before, and since the one `LAG` before, while the vehicle stood (0) or moved (1) all the time.
    """

    params: StreetParams
    frozen: int = 0
    moved: int = 0
    leap: float = 0.0
    length: float = 0.0
    by_place: float = 0.0
    by_speed: float = 0.0
    looked: int = 0
    road: Thinned = field(default_factory=Thinned)
    slope: Thinned = field(default_factory=Thinned)
    speed: Thinned = field(default_factory=Thinned)
    light: NDArray[np.int64] = field(default_factory=lambda: np.zeros(4, np.int64))
    changed: NDArray[np.float64] = field(default_factory=lambda: np.zeros((2, 2, 2)))
    same: Counter[float] = field(default_factory=Counter)
    sampled_returns: int = 0
    way: Way = field(init=False)
    _down: NDArray[np.bool_] | None = None
    _before: deque[tuple[NDArray[np.float32], bool]] = field(default_factory=lambda: deque(maxlen=LAG))
    _seen: int = 0

    def __post_init__(self) -> None:
        self.way = Way(self.params)

    def move(self, moved: float, step: float, speed: float, placed: bool, leaps: bool) -> None:
        """How far the vehicle went [m] in a `step` [s]; the `speed` that the frame gives [m/s] or NaN, whether its way
        was taken from places, and whether the clock leapt."""
        self.length += abs(moved)
        if leaps:
            self.leap += abs(moved)
        elif step > 0:
            self.speed.add(abs(moved) / step)
            if placed and math.isfinite(speed):
                self.by_place += abs(moved)
                self.by_speed += abs(speed) * step

    def bridge(self, by_place: float, by_speed: float) -> None:
        """The ways from one place to the next [m], where frames between them have only a speed."""
        self.by_place += abs(by_place)
        self.by_speed += abs(by_speed)

    def see(
        self,
        ranges: NDArray[np.float32],
        low: float,
        direction: NDArray[np.float64],
        place: int,
        placed: tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], NDArray[np.float32]],
        moved: bool,
    ) -> None:
        """A frame that is used, at `place` along the road [units]: its `ranges` as they came, the nearest valid one
        `low` [m], the `direction` of its beams (`Geometry`), and x, y, z and r that `place_frame` made of them."""
        r = placed[3]
        if moved:
            self.way.see(place, *placed)
        if self._before:
            last = self._before[-1][0]
            if moved:
                self.moved += 1
                self.frozen += not np.isnan(r).all() and bool(np.array_equal(r, last, equal_nan=True))
            if len(self._before) == LAG and all(state is moved for _, state in self._before):
                for lag, other in enumerate((last, self._before[0][0])):
                    with np.errstate(invalid="ignore"):
                        apart = np.abs(r - other)
                        share = float((apart > self.params.sound.change).mean())
                    self.changed[int(moved), lag] += (share, 1.0)
        self._before.append((r, moved))
        if self._seen % self.params.sound.every == 0:
            self._measure_ranges(r[~np.isnan(r)])
            self._measure_road(ranges < low, direction, placed[1:])
        self._seen += 1

    def see_light(self, intensities: NDArray[np.float32]) -> None:
        """The intensities of a frame's returns, as they came."""
        full = self.params.intensity or math.inf
        self.light += [
            len(intensities),
            int((intensities > full).sum()),
            int((intensities > self.params.sound.least_light * full).sum()),
            int(np.isnan(intensities).sum()),
        ]

    def _measure_ranges(self, valid: NDArray[np.float32]) -> None:
        self.sampled_returns += len(valid)
        if len(valid):
            values, counts = np.unique(valid, return_counts=True)
            top = int(counts.argmax())
            if counts[top] > 0.5 * self.params.sound.max_same * len(valid) and (
                float(values[top]) in self.same or len(self.same) < HELD
            ):
                self.same[float(values[top])] += int(counts[top])

    def _measure_road(self, blocked: NDArray[np.bool_], direction: NDArray[np.float64], placed: Any) -> None:
        (y, z, r), near = placed, self.params.road_half_width
        if self._down is None:
            aside = np.abs(direction[:, 1]) * self.params.mounting.height
            self._down = (direction[:, 2] < 0.0) & (aside < near * np.abs(direction[:, 2]))
        self.looked += int((self._down & ~blocked).sum()) >= FEWEST_ROAD
        beside = ~np.isnan(r) & (np.abs(y) < near / UNIT) & (z < 0)
        if int(beside.sum()) < FEWEST_ROAD:
            return
        up, across = z[beside] * UNIT, y[beside] * UNIT
        self.road.add(float(np.median(up)))
        if np.ptp(across) > WIDE:
            self.slope.add(math.degrees(math.atan(_slope(across, up))))

    def facts(self) -> dict[str, Any]:
        """What was measured, plain data; None where nothing tells."""
        top, most = self.same.most_common(1)[0] if self.same else (None, 0)
        growth = [float(one[1, 0] / one[0, 0]) if one[0, 0] > 0.0 else None for one in self.changed]
        return {
            "scanner_height": None if self.road.median is None else -self.road.median,
            "road_slope_deg": self.slope.median,
            "road_seen_share": self.road.seen / self.looked if self.looked else None,
            "frozen_share": self.frozen / self.moved if self.moved else 0.0,
            "same_range": top,
            "same_share": most / self.sampled_returns if self.sampled_returns else 0.0,
            "growth_standing": growth[0],
            "growth_moving": growth[1],
            "stood_frames": int(self.changed[0, 0, 1]),
            "speed": self.speed.median,
            "stretch": self.way.stretch,
            **self.way.lean(self.params.sound.lean),
            "place_over_speed": self.by_place / self.by_speed if self.by_speed else None,
            "clipped_share": self.light[1] / self.light[0] if self.light[0] else None,
            "light_share": self.light[2] / self.light[0] if self.light[0] else None,
            "unlit_share": self.light[3] / self.light[0] if self.light[0] else None,
            "leap_metres": self.leap,
            "metres": self.length,
        }


OUTSIDE, SECOND = "outside the trajectory's time", "second in a beam"
"""Why frames, or points of a LAS file, have no place or no beam."""


def _slope(across: NDArray[np.float64], up: NDArray[np.float64]) -> float:
    """Of the line through points, by the median over pairs of which one lies in the left half: the side of a car that
    stands beside the road lifts one end of a line of least squares."""
    order, half = np.argsort(across, kind="stable"), len(across) // 2
    first, second = order[:half], order[len(order) - half :]
    apart = across[second] - across[first]
    return float(np.median((up[second] - up[first])[apart > 0.0] / apart[apart > 0.0]))


def _left_out_faults(counts: Mapping[str, Any], params: StreetParams, stream: Mapping[str, int]) -> list[str]:
    """Too many frames that are left out, or that come after a leap of the clock."""
    sound, said, facts = params.sound, [], counts["sound"]
    frames, faults = counts["frames"], counts["faults"]
    lost = {
        name: faults[name]
        for name in ("doubled", "out of order", "other beams", "other limits", "no intensities")
        if faults.get(name)
    }
    lost |= {name: n for name, n in stream.items() if name != "garbage bytes" and n}
    every = frames + sum(stream.get(name, 0) for name in lost)
    if sum(lost.values()) > sound.max_left_out * every:
        each = ", ".join(f"{n:,} {name}" for name, n in lost.items())
        said.append(f"{sum(lost.values()):,} of {every:,} frames are left out: {each}")
    if faults.get("clock leaps", 0) > sound.max_leaps * frames:
        said.append(
            f"{faults['clock leaps']:,} of {frames:,} frames come after a leap of the clock by more than "
            f"{params.clock_jump:g} s: are times in seconds?"
        )
    elif facts["leap_metres"] > sound.max_leap_road * facts["metres"]:
        said.append(
            f"{facts['leap_metres']:,.1f} of {facts['metres']:,.1f} m of road lie in leaps of the clock, where nothing "
            "tells how the vehicle went: cut the recording there"
        )
    return said


def _speed_faults(counts: Mapping[str, Any], params: StreetParams) -> list[str]:
    """Too many frames whose speed or place cannot be, or that have none."""
    said, frames, faults = [], counts["frames"], counts["faults"]
    for cause, words in (
        ("impossible speed or place", "have a speed or place that no vehicle has: are they in metres and seconds?"),
        ("no speed", "have no speed, and the last one was taken: mend the column speed"),
    ):
        if faults.get(cause, 0) > params.sound.max_left_out * frames:
            said.append(f"{faults[cause]:,} of {frames:,} frames {words}")
    return said


def _range_faults(counts: Mapping[str, Any], params: StreetParams) -> list[str]:
    """Too few returns among the ranges, too many of one range, or too many frames that repeat the one before."""
    sound, said, facts = params.sound, [], counts["sound"]
    ranges = counts["returns"] + sum(counts["missing"].values())
    if counts["returns"] < sound.least_returns * ranges:
        cause, n = max(counts["missing"].items(), key=lambda item: item[1])
        said.append(
            f"{counts['returns']:,} of {ranges:,} ranges are returns, {n:,} are {cause}: are they in metres, and their "
            "limits too?"
        )
    if facts["frozen_share"] > sound.max_frozen:
        said.append(
            f"{100 * facts['frozen_share']:.1f} % of the frames repeat the one before to the last digit while the "
            "vehicle moves: a scanner, or its driver, that hangs"
        )
    if facts["same_share"] > sound.max_same:
        said.append(
            f"{100 * facts['same_share']:.1f} % of the returns have one range, {facts['same_range']:g} m: a code for "
            "no return? write NaN for it, or set the recording's range_max"
        )
    return said


def recording_faults(
    counts: Mapping[str, Any],
    params: StreetParams,
    left_out: Mapping[str, int],
    rows: tuple[int, str],
    stream: Mapping[str, int],
) -> list[str]:
    """What no sound recording shows, a sentence each, with the bound that it passes; none of a sound one. Where nothing
    tells how the vehicle moved, nothing is said of its way.

    `counts`: of `Track.counts`. `left_out`: points of a LAS file, or frames, by `OUTSIDE` and `SECOND`; `rows`: how
    many of which there are. `stream`: frames of a stream that were lost, by cause.
    """
    sound, facts = params.sound, counts["sound"]
    frames, used, faults = counts["frames"], counts["used"], counts["faults"]
    if not used:
        each = ", ".join(f"{n:,} {name}" for name, n in faults.items() if n)
        return [f"none of {frames:,} frames can be used: {each}; are times in seconds?"] if frames else []
    moves = faults.get("no speed", 0) < used or "impossible speed or place" in faults
    said = _left_out_faults(counts, params, stream) + (_speed_faults(counts, params) if moves else [])
    said += _range_faults(counts, params) + _light_faults(facts, params) + _mounting_faults(facts, params)
    said += _way_faults(facts, params) if moves else []
    for cause, most, words in (
        (OUTSIDE, sound.max_outside, "give that of the whole drive, in the recording's time"),
        (SECOND, sound.max_second, "is the trajectory that of the scanner itself, at its own time?"),
    ):
        if left_out.get(cause, 0) > most * rows[0]:
            said.append(f"{left_out[cause]:,} of {rows[0]:,} {rows[1]} are {cause}: {words}")
    return said


def judge_recording(faults: Sequence[str], accepted: bool, where: object) -> None:
    """`QualityError` of `recording_faults`; nothing where there is none, or the user accepts them."""
    refuse_unsound(
        faults,
        accepted,
        "the recording is not what it says",
        where,
        expected="what street.sound allows (docs/street.md)",
        do="mend it, and run again",
    )


def _light_faults(facts: Mapping[str, Any], params: StreetParams) -> list[str]:
    """What intensities say against `street.intensity`."""
    clipped, bright, full = facts["clipped_share"], facts["light_share"], params.intensity
    if clipped is None or bright is None:
        return []
    if facts["unlit_share"] > params.sound.max_unlit:
        return [f"{100 * facts['unlit_share']:.1f} % of the returns have no intensity, and are taken as dark"]
    if clipped > params.sound.max_clipped:
        return [
            f"{100 * clipped:.1f} % of the intensities are above street.intensity, {full:g}: the scanner's strongest "
            "is higher"
        ]
    if bright < 0.01:
        return [
            f"only {100 * bright:.2f} % of the intensities are above {100 * params.sound.least_light:g} % of street."
            f"intensity, {full:g}: the scanner's strongest is lower, or it tells none"
        ]
    return []


def _mounting_faults(facts: Mapping[str, Any], params: StreetParams) -> list[str]:
    """What the road beside the vehicle says against `street.mounting`."""
    sound, mounting = params.sound, params.mounting
    seen, height, slope = facts["road_seen_share"], facts["scanner_height"], facts["road_slope_deg"]
    if seen is not None and seen < sound.least_road:
        return [
            f"the road beside the vehicle is seen in {100 * seen:.0f} % of the frames, though beams look there by "
            f"street.mounting (height {mounting.height:g} m, roll {mounting.roll:g}°): is the scanner the other way "
            "up, or its first angle another?"
        ]
    if height is None:
        return []
    said = []
    if abs(height - mounting.height) > max(sound.height, sound.height_share * mounting.height):
        said.append(
            f"the road lies {height:.2f} m below the scanner, and street.mounting.height is {mounting.height:g} m"
        )
    if slope is not None and abs(slope) > sound.slope:
        said.append(
            f"the road leans by {slope:.1f}° across the track: is street.mounting.roll ({mounting.roll:g}°) right, and "
            "its sign?"
        )
    lean, share = facts["lean_deg"], facts["lean_share"]
    if share is not None and share > sound.lean_share:
        said.append(
            f"upright edges lean by {abs(lean):.0f}° {'forwards' if lean > 0 else 'backwards'}: is street.mounting."
            f"pitch ({mounting.pitch:g}°) right? {mounting.pitch - lean:.0f}° sets them upright"
        )
    return said


def _way_faults(facts: Mapping[str, Any], params: StreetParams) -> list[str]:
    """What speed, places and the frames say against each other."""
    sound, said = params.sound, []
    if facts["speed"] is not None and facts["speed"] > sound.fastest:
        said.append(f"the vehicle goes {facts['speed']:,.1f} m/s: are speed and place in metres, and times in seconds?")
    ratio = facts["place_over_speed"]
    if ratio is not None and not 1.0 / sound.ratio <= ratio <= sound.ratio:
        said.append(f"places go {ratio:.3g} times as far as the speed says: one of the columns has another unit")
    stretch = facts["stretch"]
    if stretch is not None and not sound.stretch[0] <= stretch <= sound.stretch[1]:
        said.append(
            f"what stands beside the road seems {stretch:.2f} times as long along it as upwards: is the speed, or the "
            "place, in metres and seconds? km/h make it 3.6 times"
        )
    stood, went = facts["growth_standing"], facts["growth_moving"]
    if facts["stood_frames"] < sound.stood or stood is None or stood < sound.growth:
        return said
    if went is None or stood - 1.0 > sound.standing * (went - 1.0):
        said.append(
            f"the vehicle stands in {facts['stood_frames']:,} frames by its speed or place, and yet the scene passes: "
            f"ranges change {stood:.2f} times as much over {LAG} frames as over one"
            + (f" ({went:.2f} where it moves)" if went is not None else "")
        )
    return said
