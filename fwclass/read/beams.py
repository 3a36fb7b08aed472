"""Whether the beams of a file come from one place above, and as far away as the file says: what old converters and
wrong exports give away.

Pulses that follow each other leave the sensor within a metre, so that the lines through their first samples, along the
stored beam vectors, must meet, and above the ground. Where a sign is wrong they meet below; where axes are exchanged,
nowhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from fwclass.errors import InputError
from fwclass.formats.projected import project_beams
from fwclass.read.beam_source import turn_beams
from fwclass.read.feet import setting_for
from fwclass.read.packet_references import References
from fwclass.read.packets import judge
from fwclass.read.pls_waves import Samplings, find, read_records
from fwclass.read.points import PointReader, coordinates, gps_times
from fwclass.read.projection import metres_of
from fwclass.read.pulsewaves import RETURNING
from fwclass.read.source import BeamSource, PulseSource, Source, las_of
from fwclass.units import METRES_PER_NS

Floats = NDArray[np.float64]

LOOKED_AT, PIECES = 20_000, 4
"""Points or pulses at the start of a file that are looked at, and as many at its end; pieces of both in which beams may
be turned though they are not in all."""

GROUP = 12
"""Pulses whose beams are brought together: 0.1 ms of a fast scanner, in which it flies 1 cm."""

FEWEST = 5
"""Groups that must meet before anything is said."""

WIDE, STEEP = 0.3, 1e-4
"""Groups tell something whose places are so far apart across the beam [m, root mean square], and whose directions
differ by as much [rad]."""

MEET = 0.1
"""Beams meet that pass their common point within this share of how far apart their places are."""

MOST = 0.8
"""Share of the groups that must agree."""

AS_FAR = 1.25
"""Ratio of a stored distance from the sensor to where beams meet that is told: each group meets to a tenth, `MEET`."""

LOWEST_FLIGHT = 20.0
"""m, nearer to the sensor no airborne scanner sees anything."""

UNLIKE_LIGHT, TOO_FAR = 0.005, 1.0
"""Share by which beam vectors are longer or shorter than light's way in air, and metres that first samples then lie
off, from which they are wrong: air and projections make 0.002, and water is entered where anchors are."""

AT_SENSOR = 5.0
"""Metres from the place where beams meet within which first samples lie at the sensor itself."""

BEGIN = "the time of the first sample after it (begin_ns)"
LENGTH = "the beam vectors are as long as"
PART = "in a part of the file "
HORIZONTAL = "the sign of their horizontal parts is wrong"
TURNED: dict[str, Callable[[Floats], Floats]] = {
    HORIZONTAL: lambda beam: beam * (-1.0, -1.0, 1.0),
    "the sign of the whole vectors is wrong, they point down": lambda beam: -beam,
    "the sign of their x is wrong": lambda beam: beam * (-1.0, 1.0, 1.0),
    "the sign of their y is wrong": lambda beam: beam * (1.0, -1.0, 1.0),
    "their axes x and y are exchanged": lambda beam: beam[:, [1, 0, 2]],
}
"""What may be wrong, and what mends it."""


@dataclass(frozen=True)
class FirstSamples:
    """Of every pulse, in the order of time: the place of its first sample (n, 3) [m], the unit vector of its beam away
    from the sensor (n, 3), the distance from the sensor to that sample that the file gives, and from that sample to the
    last one [m], both (n,) and NaN where they are not known; whether a time of the first sample is missing, where a
    table may have it; the length of the stored vector over light's way in air, and how far the first sample lies from
    the anchor [m], both (n,), or (0,) where that is a return."""

    place: Floats
    beam: Floats
    distance: Floats
    length: Floats
    untimed: bool = False
    speed: Floats = field(default_factory=lambda: np.empty(0))
    way: Floats = field(default_factory=lambda: np.empty(0))

    @classmethod
    def none(cls) -> FirstSamples:
        """Of no pulse."""
        return cls(np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.empty(0))


@dataclass(frozen=True)
class Meeting:
    """Groups whose beams meet, of `groups`; the median distance to that place, positive towards the sensor [m]; and the
    share of them in which it lies that way, and higher than the places; the median height of that place [m]."""

    meet: int
    groups: int
    away: float
    above: float
    height: float

    @property
    def sound(self) -> bool:
        """They come from above."""
        return self.meet >= FEWEST and 2 * self.meet >= self.groups and self.above >= MOST


def check_beams(source: Source) -> None:
    """`InputError` where the beams of `source` meet below the ground, only with a sign or an axis changed, or not as
    far away as it says."""
    wrong = beam_fault(source)
    if wrong:
        raise InputError(
            wrong,
            where=source.path,
            expected="beams of neighbouring pulses that meet above the ground, where the sensor was",
            do=_remedy(wrong, source),
        )


def _remedy(wrong: str, source: Source) -> str:
    if PART in wrong:
        return "export the file again, or cut it where its beams change"
    if LENGTH in wrong:
        again = "export the file again, with beam vectors of 0.1499 metres a nanosecond, or times in nanoseconds"
        return (isinstance(source, PulseSource) and setting_for(source)) or again
    if HORIZONTAL in wrong and source.mirrored:
        return "leave --mirror-beams (read.mirror_beams) out"
    if HORIZONTAL in wrong:
        return "add --mirror-beams (read.mirror_beams: true)"
    if BEGIN in wrong and isinstance(source, BeamSource):
        return (
            "give range_m of the place that x, y and z are (0 at the sensor) in metres, and begin_ns in nanoseconds, "
            "there and back; --set read.sensor_ranges=false goes on without range_m"
        )
    if BEGIN in wrong:
        return "export the file again, or go on without its distances: --set read.sensor_ranges=false"
    if isinstance(source, BeamSource):
        return "export the file again, with vectors that run from the sensor down to the ground"
    return "export the file again, with vectors that point from the target up to the sensor"


def beam_fault(source: Source) -> str:
    """What is wrong with the beams of `source`, as a sentence; "" if nothing is, or too little is there to tell."""
    firsts = _first_samples(source)
    if wrong := _whole_fault(firsts, source.ranged):
        return wrong
    ends = [firsts, _first_samples(source, source.n_records - LOOKED_AT)] if source.n_records > LOOKED_AT else [firsts]
    for some in ends:
        for rows in np.array_split(np.arange(len(some.place)), PIECES):
            if not meeting(some.place[rows], some.beam[rows]).sound and (
                wrong := _turned_fault(some.place[rows], some.beam[rows])
            ):
                return PART + wrong
    return ""


def _whole_fault(firsts: FirstSamples, ranged: bool) -> str:
    """`beam_fault` of all pulses that are looked at."""
    if wrong := _speed_fault(firsts):
        return wrong
    crossing = meeting(firsts.place, firsts.beam)
    if crossing.sound:
        return _distance_fault(crossing, firsts, ranged)
    if wrong := _sensor_fault(firsts):
        return wrong
    up = float((firsts.beam[:, 2] > 0.0).mean()) if len(firsts.beam) else 0.0
    words = f"{100 * up:.0f} % of the beams run up, not down to the ground" if up >= MOST else ""
    return _turned_fault(firsts.place, firsts.beam) or words


def _turned_fault(place: Floats, beam: Floats) -> str:
    """That beams, which do not meet above, do with a sign or an axis changed; "" where not."""
    crossing = meeting(place, beam)
    wrong = next((words for words, turned in TURNED.items() if meeting(place, turned(beam)).sound), "")
    if not wrong:
        return ""
    side = "below" if wrong == HORIZONTAL else "behind"
    where = f"{-crossing.away:.0f} m {side} the ground" if crossing.meet and crossing.away < 0.0 else "nowhere"
    return f"the beams of neighbouring pulses meet {where}: {wrong}"


def sensor_height(source: Source) -> tuple[float, float] | None:
    """How high the sensor was, as the beams of the first pulses tell, and their first samples [m, medians]; None where
    the source knows its distances, or the beams do not meet."""
    firsts = _first_samples(source)
    crossing = meeting(firsts.place, firsts.beam)
    if not crossing.sound or (source.ranged and np.isfinite(firsts.distance).any()):
        return None
    height, first = float(crossing.height), float(np.nanmedian(firsts.place[:, 2]))
    return (height, first) if np.isfinite([height, first]).all() else None


def _speed_fault(firsts: FirstSamples) -> str:
    """That beam vectors are not as long as light's way, and places far from the anchors wrong by it; "" where not."""
    if len(firsts.speed) < GROUP:
        return ""
    speed, way = float(np.median(firsts.speed)), float(np.median(np.abs(firsts.way)))
    off = abs(1.0 - 1.0 / speed) * way
    if abs(speed - 1.0) <= UNLIKE_LIGHT or off <= TOO_FAR:
        return ""
    return (
        f"{LENGTH} {speed:.4g} times light's way there and back in air: first samples, {way:.0f} m from the anchors, "
        f"lie {off:.0f} m off"
    )


def _distance_fault(crossing: Meeting, firsts: FirstSamples, ranged: bool) -> str:
    """That beams meet elsewhere than as far away as the file says; "" where it is silent, right, or not `ranged`."""
    known = firsts.distance[np.isfinite(firsts.distance)] if ranged else np.empty(0)
    stored = float(np.median(known)) if len(known) else np.nan
    if not len(known) or crossing.away / AS_FAR <= stored <= AS_FAR * crossing.away:
        return ""
    length = f"{stored:.0f}" if abs(stored) < 1e9 else f"{stored:.3g}"
    return (
        f"the beams of neighbouring pulses meet {crossing.away:.0f} m before the first samples, where the sensor was; "
        f"by the file it was {length} m away: the distance from the sensor to the place of a row (range_m, optical "
        f"centre) is wrong, or {BEGIN}"
    )


def _sensor_fault(firsts: FirstSamples) -> str:
    """That all samples lie beside the sensor, as where a file has its place and no time of the first sample."""
    n = len(firsts.place) // GROUP
    if n == 0 or np.isnan(firsts.length).all():
        return ""
    p, b = (v[: n * GROUP].reshape(n, GROUP, 3) for v in (firsts.place, firsts.beam))
    turn = _root_mean_square(b - b.mean(axis=1, keepdims=True))
    turning = turn >= STEEP
    if turning.sum() < FEWEST:
        return ""
    away = float(np.median(_root_mean_square(p - p.mean(axis=1, keepdims=True))[turning] / turn[turning]))
    last = away + float(np.nanmax(firsts.length))
    if firsts.untimed and away < AT_SENSOR:
        return (
            f"the first samples lie within {AT_SENSOR:g} m of where the beams of neighbouring pulses meet, which is "
            f"the sensor: x, y and z are its place, and {BEGIN} is missing; give 0 where samples begin at the sensor"
        )
    if last >= LOWEST_FLIGHT:
        return ""
    return (
        f"all samples lie within {last:.0f} m of where the beams of neighbouring pulses meet, which is the sensor: x, "
        f"y and z are its place, and {BEGIN} is missing or wrong"
    )


def meeting(place: Floats, beam: Floats) -> Meeting:
    """Where lines through `place` (n, 3) [m] along the unit vectors `beam` (n, 3), away from the sensor, meet: by
    groups of `GROUP` rows, each by least squares."""
    n = len(place) // GROUP
    if n == 0:
        return Meeting(0, 0, 0.0, 0.0, np.nan)
    p, b = (v[: n * GROUP].reshape(n, GROUP, 3) for v in (place, beam))
    mean = b.mean(axis=1, keepdims=True)
    mean /= np.maximum(np.linalg.norm(mean, axis=2, keepdims=True), 1e-12)
    local = p - p.mean(axis=1, keepdims=True)
    across = np.eye(3) - b[..., :, None] * b[..., None, :]
    inverse = np.linalg.pinv(across.sum(axis=1), rcond=1e-12, hermitian=True)
    point = inverse @ (across @ local[..., None]).sum(axis=1)
    miss = _root_mean_square((across @ (point[:, None] - local[..., None]))[..., 0])
    spread = _root_mean_square(local - (local * mean).sum(axis=2, keepdims=True) * mean)
    turn = _root_mean_square(b - mean)
    away = -((point[:, None, :, 0] - local) * b).sum(axis=2).mean(axis=1)
    wide = (spread >= WIDE) & (turn >= STEEP)
    meet = wide & (miss <= MEET * spread)
    if not meet.any():
        return Meeting(0, int(wide.sum()), 0.0, 0.0, np.nan)
    above = (away > 0.0) & (point[:, 2, 0] > 0.0)
    height = float(np.median((p.mean(axis=1)[:, 2] + point[:, 2, 0])[meet]))
    return Meeting(int(meet.sum()), int(wide.sum()), float(np.median(away[meet])), float(above[meet].mean()), height)


def _root_mean_square(vectors: Floats) -> Floats:
    return np.asarray(np.sqrt((vectors**2).sum(axis=2).mean(axis=1)))


def _first_samples(source: Source, begin: int = 0) -> FirstSamples:
    """Of `LOOKED_AT` pulses of a file from its record `begin` on, one row a pulse."""
    if not source.has_waves or source.waves.kind == "none" or source.n_records == 0:
        return FirstSamples.none()
    last, untimed = min(source.n_records, begin + LOOKED_AT), False
    speed = way = np.empty(0)
    if isinstance(source, PulseSource):
        kinds = Samplings.of(source)
        waves = find(source, read_records(source, begin, last), kinds)
        parts = waves.segments.take(np.flatnonzero(kinds.kind[waves.segments.sampling] == RETURNING))
        row, first = np.unique(parts.pulse, return_index=True)
        step, time = waves.step[row], waves.time[row]
        place = waves.anchor[row] - parts.begin[first, None] * step
        speed = np.linalg.norm(step * metres_of(source), axis=1)
        way = parts.begin[first] * speed
        distance = waves.anchor_range[row] + way
        length = np.full(len(row), np.nan)
    elif isinstance(source, BeamSource):
        rows = turn_beams(source.layout.read(begin, last), source)
        rows = rows.take(rows.fault == 0)
        step, time, place = rows.step, rows.time, rows.ends()[0]
        row, speed = np.arange(len(rows)), np.linalg.norm(step, axis=1)
        way = rows.begin * speed
        distance = rows.anchor_range + way
        length = np.maximum(0, rows.samples.lengths - 1) * rows.spacing * speed
        untimed = not source.layout.timed
    else:
        las = las_of(source)
        with PointReader(las) as reader:
            points = reader.read(begin, last)
        refs = References.of(points, las.mirrored)
        usable = np.flatnonzero(judge(las, refs) == 0)
        row = usable[np.sort(np.unique(refs.offset[usable], return_index=True)[1])]
        step, time = refs.step[row], gps_times(las, points)[row]
        place = np.stack(coordinates(las, points), axis=1)[row] + refs.location[row, None] * step
        distance = length = np.full(len(row), np.nan)
    if source.target is not None and len(place):
        place, step = project_beams(source.crs, CRS.from_user_input(source.target), place, step, source.path)
    order = np.argsort(time, kind="stable")
    beam = -step / np.linalg.norm(step, axis=1, keepdims=True)
    speed = speed / METRES_PER_NS
    return FirstSamples(place[order], beam[order], distance[order], length[order], untimed, speed, way)
