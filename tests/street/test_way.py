"""A speed in another unit and a wrong pitch are told by what stands beside the road; sound drives are not."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from streetmaker import config

from fwclass.conf.street import scanner
from fwclass.street.frames import Frame
from fwclass.street.params import StreetParams
from fwclass.street.simulate import simulate_frames
from fwclass.street.soundness import recording_faults
from fwclass.street.sphere_kernels import UNIT
from fwclass.street.track import Track
from fwclass.street.way import MOST_EDGES, Way


@functools.cache
def drive(seed: int, pitch: float, leaves: bool = True) -> tuple[Frame, ...]:
    """105 metres, without a stop."""
    made = config(
        *(
            f"street_scene.seed={seed}",
            "street_scene.length=105",
            "street_scene.speed=4.5",
            "street_scene.stops=0",
            f"street.mounting.pitch={pitch}",
        ),
        *(f"street_scene.leaves={leaves}", "street.scanner=lms1xx"),
    )
    return tuple(simulate_frames(made.street_scene, scanner(made.street.scanner), made.street.mounting))


def seen(frames: tuple[Frame, ...], speed: float, pitch: float) -> tuple[dict, list[str]]:
    """What is measured where speeds are `speed` times as high, and what is told."""
    params = config(f"street.mounting.pitch={pitch}").street
    track = Track(params)
    for frame in frames:
        track.take(replace(frame, speed=speed * frame.speed))
    counts = track.counts()
    return counts["sound"], recording_faults(counts, params, {}, (len(frames), "frames"), {})


@pytest.mark.statistics
@pytest.mark.parametrize(
    ("seed", "pitch", "leaves"),
    [(11, 0.0, True), *(pytest.param(*one, marks=pytest.mark.slow) for one in ((12, 0.0, False), (13, 20.0, True)))],
)
def test_sound_drives_are_not_told(seed: int, pitch: float, leaves: bool) -> None:
    facts, told = seen(drive(seed, pitch, leaves), 1.0, pitch)
    assert told == [] and 0.6 < facts["stretch"] < 1.6 and facts["lean_share"] < 0.35, facts


@pytest.mark.slow
@pytest.mark.statistics
def test_a_speed_in_kilometres_an_hour() -> None:
    facts, told = seen(drive(11, 0.0), 3.6, 0.0)
    assert 2.2 < facts["stretch"] < 6.0 and any("times as long along it as upwards" in t for t in told), facts


@pytest.mark.statistics
def test_a_short_drive_tells_nothing_of_its_speed() -> None:
    facts, told = seen(drive(11, 0.0)[:900], 1.0, 0.0)
    assert facts["stretch"] is None and told == []


@pytest.mark.statistics
@pytest.mark.parametrize(
    ("true", "said"), [(20.0, 0.0), (0.0, 15.0), pytest.param(20.0, -10.0, marks=pytest.mark.slow)]
)
def test_another_pitch(true: float, said: float) -> None:
    facts, told = seen(drive(13 if true else 11, true), 1.0, said)
    assert abs(facts["lean_deg"] - (said - true)) <= 3.0, facts
    (fault,) = [t for t in told if "upright edges lean" in t]
    assert f"pitch ({said:g}°) right?" in fault


def of_depths(depth, heights: np.ndarray, step: float, length: float, params: StreetParams) -> Way:
    """`depth` (x, z) [m] at `heights` above the scanner, every `step` metres."""
    way = Way(params)
    z = np.rint(heights / UNIT).astype(np.int32)
    for x in np.arange(0.0, length, step):
        y = depth(x, heights)
        r = np.hypot(y, heights).astype(np.float32)
        way.see(round(x / UNIT), np.empty(0, np.int32), np.rint(y / UNIT).astype(np.int32), z, r)
    return way


@pytest.mark.statistics
@pytest.mark.parametrize("lean", [0.0, 12.0, -20.0])
def test_slats_that_lean(lean: float) -> None:
    """Slats at random before a wall, all of one lean: the angle is theirs, in bins of 2°."""
    random = np.random.default_rng(5)
    begins = np.sort(random.uniform(0, 104, 100))
    out = random.uniform(3.0, 5.5, 100)

    def depth(x: float, z: np.ndarray) -> np.ndarray:
        at = x - z * np.tan(np.radians(lean))
        here = np.abs(at[:, None] - begins) < 0.15
        return np.where(here, out, 7.0).min(axis=1)

    got = of_depths(depth, np.linspace(-1.0, 4.0, 200), 0.05, 104.0, config().street).lean(8.0)
    if lean:
        assert abs(got["lean_deg"] - lean) <= 2.0 and got["lean_share"] > 2.0, got
    else:
        assert got["lean_share"] < 0.2, got


@pytest.mark.parametrize("stretch", [1.0, 3.0])
def test_bumps_that_are_drawn_out(stretch: float) -> None:
    """Round bumps at random, drawn out along the road: by that much."""
    random = np.random.default_rng(6)
    x, z = random.uniform(-3, 107, 1500), random.uniform(-2, 5, 1500)
    size, out = random.uniform(0.15, 1.2, 1500), random.uniform(3.0, 6.5, 1500)

    def depth(at: float, heights: np.ndarray) -> np.ndarray:
        near = np.abs(at - x) < 1.2 * stretch
        inside = ((at - x[near]) / stretch) ** 2 + (heights[:, None] - z[near]) ** 2 < size[near] ** 2
        return np.where(inside, out[near], 7.0).min(axis=1, initial=7.0)

    got = of_depths(depth, np.linspace(-1.0, 4.0, 200), 0.05, 104.0, config().street).stretch
    assert got is not None and abs(np.log(got / stretch)) < np.log(1.4), got


def test_a_wall_tells_nothing_of_speed() -> None:
    way = of_depths(lambda x, z: np.where(z < 0.5, 4.0, 8.0), np.linspace(-1, 4, 200), 0.05, 104.0, config().street)
    assert way.stretch is None


def test_a_vehicle_that_goes_back_or_leaps_begins_again() -> None:
    params = config().street
    way, other = Way(params), Way(params)
    random = np.random.default_rng(7)
    for k, x in enumerate((0.0, 0.1, 0.2, 0.1, 0.2, 9.0, 9.1)):
        y, z = (np.rint(random.uniform(2, 6, 50) / UNIT).astype(np.int32) for _ in range(2))
        row = (round(x / UNIT), np.empty(0, np.int32), y, z, np.hypot(y, z).astype(np.float32) * np.float32(UNIT))
        way.see(*row)
        if k >= 5:
            other.see(*row)
    assert 0.35 < way.metres < 0.45 and 0.05 < other.metres < 0.15


def test_edges_of_a_frame_are_bounded():
    """Each is held against all others: a scanner that sees noise must not keep the stream waiting."""
    way, r = Way(config().street), np.random.default_rng(0)
    for k in range(40):
        y, z = (r.uniform(a, b, 1000) for a, b in ((2.0, 12.0), (-1.0, 4.0)))
        units = [np.rint(v / UNIT).astype(np.int32) for v in (y, z)]
        way.see(k * 60, np.zeros(0, np.int32), *units, y.astype(np.float32))
    assert way.metres > 2.0 and max(len(edges) for _, edges in way._edges) <= MOST_EDGES
