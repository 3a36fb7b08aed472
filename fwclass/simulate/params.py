"""Parameters of the simulator, by subject."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from fwclass.params import Params

MOST_NODES = 16_384
"""Of the terrain, along an edge of the survey: 2 GiB of float64."""

MOST_RAYS = 20_000_000
"""Rays that are traced at once."""

MAX_FOOTPRINT = 0.5
"""Largest footprint on the ground that the search along a beam allows for [m]."""


class SceneParams(Params):
    """What the scene is made of."""

    terrain_step: float = Field(ge=0.05, le=1000)
    hill_height: float = Field(ge=0, le=10_000)
    street_angle: float
    river_width: float = Field(ge=0, le=10_000)
    leaf_density: float = Field(gt=0, le=1000)
    herb_threshold: float
    tree_share: float = Field(ge=0, le=10)
    house_albedo: tuple[float, float]
    leaf_albedo: tuple[float, float]
    gap_length: float = Field(ge=0, le=10_000)
    gap_width: float = Field(ge=0, le=10_000)
    index_cell: float = Field(ge=0.5, le=10_000)


class FlightParams(Params):
    """How the aircraft flies."""

    height: float = Field(gt=0, le=20_000)
    speed: float = Field(ge=1, le=10_000)
    field_of_view: float = Field(gt=0, lt=120)
    roll: float = Field(ge=0)
    pitch: float = Field(ge=0)
    heading: float = Field(ge=0)
    drift: float = Field(ge=0, le=1000)
    position_error: float = Field(ge=0)
    attitude_error: float = Field(ge=0)
    first_gps_time: float = Field(gt=0, le=10_000_000_000)
    turn: float = Field(ge=0, le=1_000_000)
    trajectory_rate: float = Field(gt=0, le=10_000)


class SensorParams(Params):
    """The laser, its receiver and its on-board detection.

    The recorded pulse is a Gaussian of FWHM `pulse_width` [ns], convolved with an exponential tail of time constant
    `skew` [ns], followed after `ringing_delay` [ns] by a second lobe of `ringing` of its height. 0 is none.
    """

    pulse_rate: float = Field(ge=1, le=100_000_000)
    pulse_width: float = Field(gt=0, le=100)
    skew: float = Field(ge=0, le=20)
    ringing: float = Field(ge=0, lt=0.5)
    ringing_delay: float = Field(gt=0, le=100)
    divergence: float = Field(gt=0)
    rings: tuple[Annotated[int, Field(ge=1, le=1000)], ...] = Field(min_length=1, max_length=20)
    bright: float = Field(gt=0)
    baseline: float = Field(ge=0)
    noise: float = Field(ge=0)
    energy_jitter: float = Field(ge=0)
    clock_jitter: float = Field(ge=0)
    short_segment: int = Field(ge=32, le=4096)
    long_segment: int = Field(ge=64, le=65_535)
    lead: int = Field(ge=8, le=1000)
    tail: int = Field(ge=8, le=1000)
    detection: float = Field(gt=0)
    dip: float = Field(gt=0)
    separation: float = Field(gt=0)
    visible: float = Field(gt=0)


class Recording(Params):
    """How one strip is written."""

    las: Literal["1.3", "1.4"]
    point_format: Literal[4, 5, 9, 10]
    bits: Literal[8, 16]

    @model_validator(mode="after")
    def _fits(self) -> Recording:
        if (self.las == "1.4") != (self.point_format >= 6):
            raise ValueError("LAS 1.3 goes with point formats 4 and 5, LAS 1.4 with 9 and 10")
        return self


class SimulateParams(Params):
    """A survey of `size` × `size` metres, flown in `strips` parallel strips; see `conf/base.yaml` for the units."""

    seed: int = Field(ge=0, lt=2**32)
    crs: str
    origin_x: float
    origin_y: float
    base_height: float
    size: float = Field(ge=40, le=5000)
    strips: int = Field(ge=1, le=200)
    pulse_density: float = Field(gt=0, le=100)
    chunk: int = Field(ge=1, le=10_000_000)
    recordings: tuple[Recording, ...] = Field(min_length=1)
    empty_descriptors: int = Field(ge=0, le=250)
    scene: SceneParams
    flight: FlightParams
    sensor: SensorParams

    @model_validator(mode="after")
    def _agree(self) -> SimulateParams:
        sensor = self.sensor
        if sensor.long_segment <= max(sensor.short_segment, sensor.lead + sensor.tail):
            raise ValueError("long_segment must be longer than short_segment and than lead + tail")
        if sensor.divergence * 1e-3 * self.flight.height > MAX_FOOTPRINT:
            raise ValueError(f"the footprint, divergence x height, must not exceed {MAX_FOOTPRINT} m")
        if self.size > MOST_NODES * self.scene.terrain_step:
            raise ValueError(f"size must not exceed {MOST_NODES:,} steps of scene.terrain_step")
        if self.chunk * sum(sensor.rings) > MOST_RAYS:
            raise ValueError(f"chunk pulses of all sensor.rings must not be more than {MOST_RAYS:,} rays")
        return self
