"""A drive along a simulated street."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fwclass.street.frames import Frame, Scan
from fwclass.street.params import MountingParams, ScannerParams, StreetSceneParams
from fwclass.street.scene import KERB, KERB_HEIGHT, Street, build
from fwclass.street.trace_kernels import trace

MOST_FRAMES = 2_000_000
"""Of a drive: fourteen hours."""


def simulate_frames(params: StreetSceneParams, scanner: ScannerParams, mounting: MountingParams) -> Iterator[Frame]:
    """Frames with labels; the same for the same parameters.

    Pitch and roll of the vehicle and noise of the speed are not told to the reader of the frames, as on a road.
    """
    street = build(params)
    scan = Scan.of(scanner)
    random = np.random.default_rng([params.seed, 2])
    angles = scan.first + scan.step * np.arange(scan.beams) + mounting.rise
    side = 1.0 if mounting.side == "left" else -1.0
    place = 0.0
    sway = _Wander(random, 1.0 / scanner.period)
    roll, pitch = (_Wander(random, 0.5 / scanner.period) for _ in range(2))
    stops = np.sort(random.uniform(0, params.length, params.stops))
    standing, stopped = 0, 0
    for number in range(MOST_FRAMES):
        if place >= params.length:
            return
        speed = params.speed * max(0.05, 1.0 + params.sway * sway())
        if stopped < len(stops) and place >= stops[stopped]:
            standing, stopped = round(params.stop_seconds / scanner.period), stopped + 1
        if standing:
            speed, standing = 0.0, standing - 1
        lean = float(np.interp(place, np.arange(-20.0, len(street.leaning) - 20.0), street.leaning))
        ranges, labels = np.empty(scan.beams, np.float32), np.empty(scan.beams, np.uint8)
        light = None if params.intensity is None else np.empty(scan.beams, np.float32)
        trace(
            *(street.solids, _near(street, place, scan.range_max * math.radians(3 * params.roll)), place),
            *(mounting.height, angles, side, math.radians(params.roll) * roll()),
            math.radians(params.roll) * pitch() + math.radians(mounting.pitch),
            *(lean, KERB, KERB_HEIGHT, scanner.spot, scanner.noise, params.missing, scan.range_max),
            *(random.integers(1, 2**63, scan.beams, dtype=np.uint64), ranges, labels, light),
        )
        measured = speed * (1.0 + 0.002 * float(random.normal()))
        full = np.float32(params.intensity or 0.0)
        intensities = None if light is None else full * np.minimum(light, np.float32(1.0))
        yield Frame(number, number * scanner.period, scan, ranges, measured, math.nan, labels, intensities)
        place += speed * scanner.period


class _Wander:
    """Smooth noise of deviation 1 that forgets itself within `steps` calls (first-order Markov, twice)."""

    def __init__(self, random: np.random.Generator, steps: float) -> None:
        self._random, self._keep = random, math.exp(-2.0 / steps)
        self._first = self._value = 0.0

    def __call__(self) -> float:
        keep = self._keep
        self._first = keep * self._first + math.sqrt(1 - keep**2) * float(self._random.normal())
        self._value = keep * self._value + (1 - keep) * self._first
        return self._value * (1 + keep) / math.sqrt(1 + keep**2)


def _near(street: Street, place: float, beyond: float) -> NDArray[np.int64]:
    """Solids that a scan at `place` may meet, `beyond` metres to each side."""
    solids = street.solids
    last = int(np.searchsorted(solids[:, 2], place + beyond, side="right"))
    return np.flatnonzero(solids[:last, 3] >= place - beyond)
