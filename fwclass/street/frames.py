"""Frames of a 2-D scanner: what one is, and where its returns lie."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fwclass.street.params import MountingParams, ScannerParams
from fwclass.street.sphere_kernels import LEVELS, UNIT


@dataclass(frozen=True)
class Scan:
    """The beams of a frame: how many, the angle of the first and the step between them [rad], valid ranges [m]."""

    beams: int
    first: float
    step: float
    range_min: float
    range_max: float

    @classmethod
    def of(cls, scanner: ScannerParams) -> Scan:
        """The beams of a data sheet [deg], in radians."""
        return cls(
            scanner.beams,
            math.radians(scanner.first_angle),
            math.radians(scanner.step),
            scanner.range_min,
            scanner.range_max,
        )

    @property
    def wraps(self) -> bool:
        """The beams go full circle."""
        return self.beams * self.step > 2.0 * math.pi - 1.5 * self.step

    def like(self, other: Scan) -> bool:
        """The same beams, to a hundredth of a step."""
        near = 0.01 * self.step
        return (
            self.beams == other.beams
            and abs(self.first - other.first) <= near
            and abs(self.step - other.step) * self.beams <= near
        )

    def reaches_like(self, other: Scan) -> bool:
        """The same valid ranges, to a millionth."""
        return math.isclose(self.range_min, other.range_min, rel_tol=1e-6) and math.isclose(
            self.range_max, other.range_max, rel_tol=1e-6
        )


@dataclass(frozen=True)
class Frame:
    """One scan.

    Attributes
    ----------
    number : as the source counts it. time : [s].
    ranges : float32 (beams,) [m]; NaN, infinite, below `range_min` or above `range_max` is no return.
    speed : of the vehicle [m/s], place : along the road [m]; NaN where the source has none.
    labels : uint8 (beams,) class codes, 0 none; or None.
    intensities : float32 (beams,) as the scanner gives them; or None.
    """

    number: int
    time: float
    scan: Scan
    ranges: NDArray[np.float32]
    speed: float = math.nan
    place: float = math.nan
    labels: NDArray[np.uint8] | None = None
    intensities: NDArray[np.float32] | None = None


class Recording(Protocol):
    """A source of frames. `about`: what the source says of itself, plain data."""

    @property
    def about(self) -> Mapping[str, Any]:
        """Kind, columns or topics, rows: plain data."""
        ...

    def frames(self) -> Iterator[Frame]:
        """The frames in the source's order; `InputError` where it cannot be read further."""
        ...


@dataclass(frozen=True)
class Placed:
    """A frame that is used: coordinates from the scanner [units of `sphere_kernels.UNIT`].

    Attributes
    ----------
    place : along the road [units]. road : height of the road above the scanner [m]; measured where features count from
        it, else the mounting's.
    repeats : the vehicle hardly moved and enough frames were taken there: this one is not to be a part of any sphere,
        nor answered.
    x : int32 (beams,), or (0,) where the scan plane is at right angles to the road. y, z : int32 (beams,).
    r : float32 (beams,) [m], NaN without a return.
    light : int32 (beams,), intensities [levels]; (0,) where `street.intensity` asks for none.
    """

    number: int
    time: float
    place: int
    road: float
    x: NDArray[np.int32]
    y: NDArray[np.int32]
    z: NDArray[np.int32]
    r: NDArray[np.float32]
    light: NDArray[np.int32] = field(default_factory=lambda: np.empty(0, np.int32))
    labels: NDArray[np.uint8] | None = None
    repeats: bool = False


def levels_of(intensities: NDArray[np.float32], full: float) -> NDArray[np.int32]:
    """Intensities (beams,) as whole levels of `full` scale, 0 to `LEVELS` - 1; 0 where one is negative or NaN."""
    share = np.clip(np.nan_to_num(intensities.astype(np.float64) / full, nan=0.0), 0.0, 1.0)
    return np.rint(share * (LEVELS - 1)).astype(np.int32)


def rotation(mounting: MountingParams) -> NDArray[np.float64]:
    """(3, 3): turns a vector of the scan plane (x across it, y, z in it) onto the vehicle, by pitch and yaw."""
    p, w = math.radians(mounting.pitch), math.radians(mounting.yaw)
    about_y = np.array([[math.cos(p), 0, math.sin(p)], [0, 1, 0], [-math.sin(p), 0, math.cos(p)]])
    about_z = np.array([[math.cos(w), -math.sin(w), 0], [math.sin(w), math.cos(w), 0], [0, 0, 1]])
    return about_z @ about_y


@dataclass(frozen=True)
class Geometry:
    """Directions of the beams on the vehicle, (beams, 3): x forward, y left, z up."""

    scan: Scan
    direction: NDArray[np.float64]
    tilted: bool
    lean: float

    @classmethod
    def of(cls, scan: Scan, mounting: MountingParams) -> Geometry:
        """The directions of `scan`'s beams, unit vectors, on a vehicle that carries it so."""
        angle = scan.first + scan.step * np.arange(scan.beams) + mounting.rise
        side = 1.0 if mounting.side == "left" else -1.0
        plane = np.stack([np.zeros(scan.beams), side * np.cos(angle), np.sin(angle)], axis=1)
        turn = rotation(mounting)
        normal = turn[:, 0]
        tilted = mounting.pitch != 0 or mounting.yaw != 0
        return cls(scan, np.ascontiguousarray(plane @ turn.T), tilted, math.sqrt(max(0.0, 1.0 - normal[0] ** 2)))

    @property
    def reach(self) -> float:
        """How far frames may be apart along the road for a sphere of radius 1 m to touch both [m]."""
        return 1.0 / math.sqrt(1.0 - self.lean**2)

    def offsets(self, left: bool) -> tuple[float, float]:
        """How far behind and ahead of the scanner a return on one side of the track can lie along the road [m].

        Which side it is on is told by its rounded y, which of a near return on the other side may be 0.
        """
        if not self.tilted:
            return 0.0, 0.0
        ahead, aside = self.direction[:, 0], self.direction[:, 1] * (1.0 if left else -1.0)
        with np.errstate(divide="ignore"):
            furthest = np.where(aside >= 0.0, np.inf, 0.5 * UNIT / np.abs(aside))
        x = ahead * np.minimum(furthest, min(self.scan.range_max, FARTHEST))
        return max(0.0, float(-x.min())) + UNIT, max(0.0, float(x.max())) + UNIT


FARTHEST = 2000.0
"""m; no range is longer: coordinates and `FAR` are in 32 bits."""
