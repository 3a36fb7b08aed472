"""Parameters of the street room; numbers and sources stand in `conf/base.yaml` and `conf/street`."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from fwclass.params import Params

LARGEST_RADIUS = 1.2
"""m; the sums of the sphere kernel fit into 31 bits up to here."""


class ScannerParams(Params):
    """A 2-D scanner as its data sheet has it; for recordings that do not say it themselves, and for the simulator.

    Attributes
    ----------
    beams, first_angle [deg], step [deg], period [s] : of a scan, angles counted upwards from the looking direction.
    range_min, range_max : nearest and furthest range that is one [m].
    noise : standard deviation of a range [m]. spot : width of the beam [rad].
    """

    about: str
    source: str
    beams: int = Field(ge=2, le=30_000)
    first_angle: float = Field(ge=-360, le=360)
    step: float = Field(gt=0, le=10)
    period: float = Field(gt=0, le=10)
    range_min: float = Field(ge=0, le=500)
    range_max: float = Field(gt=0, le=500)
    noise: float = Field(ge=0, le=1)
    spot: float = Field(ge=0, le=0.1)


class MountingParams(Params):
    """How the scanner sits on the vehicle: x forward, y left, z up.

    Attributes
    ----------
    side : where beam angle 0 looks; angles grow upwards. height : of the scanner above the road [m].
    roll, pitch, yaw : turns about x, then y, then z [deg], right-handed whatever the side: roll lifts the vehicle's
    left, pitch lowers its front, yaw turns it to the left.
    """

    side: Literal["right", "left"]
    height: float = Field(gt=0, le=20)
    roll: float = Field(ge=-180, le=180)
    pitch: float = Field(ge=-60, le=60)
    yaw: float = Field(ge=-60, le=60)

    @property
    def rise(self) -> float:
        """What roll adds to the angles of the beams [rad]."""
        return math.radians(self.roll if self.side == "left" else -self.roll)


class PrescriptionParams(Params):
    """How crown returns become segments of a prescription map.

    Attributes
    ----------
    segment : length along the road [m]. voxel : edge of the cubes that are counted [m]. fewest : crown returns of a
    segment, fewer are none. nozzle : distance by which the nozzle trails the scanner [m].
    """

    segment: float = Field(ge=0.05, le=100)
    voxel: float = Field(ge=0.02, le=5)
    fewest: int = Field(ge=1, le=1_000_000)
    nozzle: float = Field(ge=0, le=100)


class StreamParams(Params):
    """What the on-line reader accepts.

    Attributes
    ----------
    most_beams : of a frame. queue : frames that wait at most; older ones are dropped then. stall : time without
    a whole frame after which a stream has ended [s].
    """

    most_beams: int = Field(ge=2, le=30_000)
    queue: int = Field(ge=1, le=100_000)
    stall: float = Field(gt=0, le=86_400)


class SoundParams(Params):
    """What a sound recording shows of itself; beyond it a command ends with exit code 4, after its work.

    Attributes
    ----------
    every : frames between two that ranges and road are measured on.
    max_left_out : share of the frames that are left out, or lack a speed or place. max_leaps : of those after a leap of
    the clock. max_leap_road : share of the road that lies in such leaps. least_returns : share of the ranges that are
    returns. max_frozen : of the frames that repeat the one before. max_same : of the returns that have one range.
    least_road : of the frames in which the road is seen where beams look at it. height [m], height_share : between
    mounting and road, the larger counts. slope : of the road across the track [deg]. fastest : median speed [m/s].
    ratio : of the ways by place and by speed. stretch : least and most, of what stands beside the road, along it over
    upwards. lean : of upright edges [deg]; lean_share : of those that lean so to the others. change : of a range that
    counts as one [m]; growth : of the changes over half a second, over those from frame to frame, that a standing
    vehicle does not see, in at least `stood` frames; standing : share of the moving one's growth that wind makes.
    max_clipped : share of the returns with an intensity above `street.intensity`; least_light : share of it that one
    return of a hundred exceeds; max_unlit : share of the returns that have none. max_outside, max_second : share of the
    points of a LAS file outside of the trajectory's time, and in a beam that has one.
    """

    every: int = Field(ge=1, le=1000)
    max_left_out: float = Field(ge=0, le=1)
    max_leaps: float = Field(ge=0, le=1)
    max_leap_road: float = Field(ge=0, le=1)
    least_returns: float = Field(ge=0, le=1)
    max_frozen: float = Field(ge=0, le=1)
    max_same: float = Field(ge=0, le=1)
    least_road: float = Field(ge=0, le=1)
    height: float = Field(gt=0, le=20)
    height_share: float = Field(ge=0, le=1)
    slope: float = Field(gt=0, le=90)
    fastest: float = Field(gt=0, le=100)
    ratio: float = Field(ge=1, le=100)
    stretch: tuple[Annotated[float, Field(gt=0, le=1)], Annotated[float, Field(ge=1, le=100)]]
    lean: float = Field(gt=0, le=28)
    lean_share: float = Field(gt=0, le=100)
    change: float = Field(gt=0, le=10)
    standing: float = Field(ge=0, le=10)
    stood: int = Field(ge=1, le=1_000_000)
    growth: float = Field(ge=1, le=100)
    max_clipped: float = Field(ge=0, le=1)
    max_unlit: float = Field(ge=0, le=1)
    least_light: float = Field(ge=0, le=1)
    max_outside: float = Field(ge=0, le=1)
    max_second: float = Field(ge=0, le=1)


class StreetParams(Params):
    """Frames, neighbourhoods and features.

    Attributes
    ----------
    scanner : a file of `conf/street`, by name.
    speed : of the vehicle [m/s], where the recording has none; null: it must have one, or positions.
    topic : of the laser scans in a bag with several.
    odometry : topic of the vehicle's speed in a bag with several of `nav_msgs/Odometry`.
    radii : of the spheres [m]. most_frames : of the neighbourhood before and after a frame. spacing : of new
    road to each frame [m], nearer ones are left out; stood : frames that are taken nearer to each other than that,
    where the vehicle stops or begins to creep.
    window : `exact`, or the `paper`'s, which loses members near the scanner.
    features : `scanner`, heights count from the scanner (Li 2018); `height`, from the road beside the vehicle.
    intensity : the strongest that the scanner tells, full scale: mean and deviation of a sphere's intensities, as
    shares of it, are features; null: they are none.
    smooth : radius of the spheres [m] that the share of the first class is averaged over before it decides; null: every
    return decides alone.
    road_half_width : returns as near as this to the track tell the height of the road [m].
    clock_jump : a leap of the clock by more is none of the vehicle [s].
    split : of a training run: `random`, a share of the returns (Li 2018); `stretch`, the boxes of `areas.train`.
    share : of the returns that train at random.
    chunk : frames of a part of `fwclass street classify`.
    """

    scanner: str = Field(pattern=r"^[\w.-]+$")
    mounting: MountingParams
    speed: float | None = Field(ge=-60, le=60)
    topic: str | None
    odometry: str | None
    radii: tuple[Annotated[float, Field(ge=0.02, le=LARGEST_RADIUS)], ...] = Field(min_length=1, max_length=8)
    most_frames: int = Field(ge=1, le=1000)
    spacing: float = Field(ge=0.0001, le=1)
    stood: int = Field(ge=1, le=1_000_000)
    window: Literal["exact", "paper"]
    features: Literal["scanner", "height"]
    intensity: float | None = Field(gt=0, le=1e9)
    smooth: float | None = Field(ge=0.02, le=LARGEST_RADIUS)
    road_half_width: float = Field(gt=0, le=20)
    clock_jump: float = Field(gt=0, le=86_400)
    split: Literal["random", "stretch"]
    share: float = Field(gt=0, lt=1)
    chunk: int = Field(ge=1, le=1_000_000)
    prescription: PrescriptionParams
    sound: SoundParams
    stream: StreamParams

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        if len({round(100 * r) for r in self.radii}) < len(self.radii):
            raise ValueError("two radii are the same in whole centimetres, by which features are named")
        return self


class StreetSceneParams(Params):
    """A simulated street and the drive along it; see `conf/base.yaml` for units."""

    seed: int = Field(ge=0, lt=2**63)
    length: float = Field(ge=5, le=20_000)
    speed: float = Field(gt=0, le=40)
    sway: float = Field(ge=0, le=0.9)
    stops: int = Field(ge=0, le=1000)
    stop_seconds: float = Field(ge=0, le=600)
    leaves: bool
    tree_spacing: float = Field(ge=3, le=100)
    tree_depth: float = Field(ge=2, le=20)
    facade_depth: float = Field(ge=4, le=40)
    roll: float = Field(ge=0, le=10)
    missing: float = Field(ge=0, le=0.9)
    slope: float = Field(ge=0, le=0.3)
    intensity: float | None = Field(gt=0, le=1e9)
