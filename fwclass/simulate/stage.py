"""The simulator's public functions: plan the strips, fly and write one, write the trajectory."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import laspy
import numpy as np
from numpy.typing import NDArray

from fwclass.simulate.city import build_scene
from fwclass.simulate.flight import Pulses, StripPlan, fire, measure_pose, plan_strips, pose
from fwclass.simulate.las import (
    INTENSITY_SCALE,
    LONG,
    SHORT,
    PacketWriter,
    packet_columns,
    reference_header,
    strip_header,
    write_points,
)
from fwclass.simulate.noise import normal_table
from fwclass.simulate.params import SimulateParams
from fwclass.simulate.receiver import (
    CUT,
    RECORDED,
    SILENT,
    UNSEEN,
    Receiver,
    Recorded,
    Workspace,
    empty_record,
    fly_chunk,
    pulse_shape,
    workspace,
)
from fwclass.simulate.scene import Scene
from fwclass.simulate.trace import MAX_CANDIDATES, footprint
from fwclass.units import FWHM_PER_SIGMA, METRES_PER_NS


def _receiver(params: SimulateParams, bits: int) -> Receiver:
    sensor = params.sensor
    shape, first, sigma = pulse_shape(sensor.pulse_width, sensor.skew, sensor.ringing, sensor.ringing_delay)
    return Receiver(
        metres=METRES_PER_NS,
        sigma=sigma,
        shape=shape,
        shape_first=first,
        radius=sensor.divergence * 1e-3 / 2.0,
        gain=sensor.bright * params.flight.height**2,
        jitter=sensor.energy_jitter,
        baseline=sensor.baseline,
        noise=sensor.noise,
        top=float(2**bits - 1),
        short=sensor.short_segment,
        long=sensor.long_segment,
        lead=sensor.lead,
        tail=sensor.tail,
        detection=sensor.detection,
        dip=sensor.dip,
        separation=sensor.separation,
        visible=sensor.visible,
    )


class _Flyer:
    """Flies one strip, a chunk of pulses at a time, into the same room."""

    def __init__(self, params: SimulateParams, strip: StripPlan) -> None:
        self.params, self.strip = params, strip
        self.scene: Scene = build_scene(params)
        self.rays = footprint(params.sensor.rings)
        self.receiver = _receiver(params, strip.recording.bits)
        self.normal = normal_table()
        long = params.sensor.long_segment
        self.work: Workspace = workspace(len(self.rays), long, MAX_CANDIDATES)
        self.out: Recorded = empty_record(min(params.chunk, strip.pulses), len(self.rays), long)

    def fly(self, first: int, count: int) -> tuple[Pulses, Recorded]:
        """Pulses `first` to `first + count`, and what came of them (views of the room, cut to size)."""
        pulses = fire(self.params, self.strip, first, count)
        out = self.out
        samples, returns, echoes = fly_chunk(
            self.scene,
            self.rays,
            self.receiver,
            self.normal,
            self.params.seed,
            self.strip.number,
            first,
            pulses.origin,
            pulses.direction,
            self.work,
            out,
        )
        return pulses, Recorded(
            out.fate[:count],
            out.begin[:count],
            out.sample_start[: count + 1],
            out.return_start[: count + 1],
            out.echo_start[: count + 1],
            out.samples[:samples],
            out.location[:returns],
            out.height[:returns],
            out.echo_time[:echoes],
            out.echo_height[:echoes],
            out.echo_sigma[:echoes],
            out.echo_class[:echoes],
        )


def _number_in_pulse(start: NDArray[np.int64]) -> tuple[NDArray, NDArray, NDArray]:
    """For items grouped by pulse: pulse, number in the pulse from 1, and the pulse's count."""
    count = np.diff(start)
    pulse = np.repeat(np.arange(len(count)), count)
    return pulse, np.arange(start[-1]) - start[pulse] + 1, count[pulse]


def _at(pulses: Pulses, pulse: NDArray, time_ns: NDArray) -> dict[str, NDArray]:
    along = (time_ns * METRES_PER_NS)[:, None] * pulses.measured_direction[pulse]
    position = pulses.measured_origin[pulse] + along
    return {"x": position[:, 0], "y": position[:, 1], "z": position[:, 2]}


def _return_columns(strip: StripPlan, short: int, pulses: Pulses, got: Recorded, first_byte: int) -> dict[str, NDArray]:
    pulse, number, of = _number_in_pulse(got.return_start)
    samples = np.diff(got.sample_start)[pulse]
    width = strip.recording.bits // 8
    extended = strip.recording.point_format >= 6
    angle = pulses.scan_angle[pulse]
    columns = _at(pulses, pulse, got.begin[pulse] + got.location)
    columns |= {
        "intensity": np.minimum(got.height * INTENSITY_SCALE, 65535).astype(np.uint16),
        "return_number": number.astype(np.uint8),
        "number_of_returns": of.astype(np.uint8),
        "classification": (number == 1).astype(np.uint8),
        "point_source_id": np.full(len(pulse), strip.number + 1, np.uint16),
        "gps_time": strip.first_time + pulses.time[pulse],
        "scan_direction_flag": np.ones(len(pulse), np.uint8),
    }
    if extended:
        columns["scan_angle"] = np.rint(angle / 0.006).astype(np.int16)
    else:
        columns["scan_angle_rank"] = np.rint(angle).astype(np.int8)
    return columns | packet_columns(
        np.where(samples == short, SHORT, LONG).astype(np.uint8),
        (first_byte + got.sample_start[pulse] * width).astype(np.uint64),
        (samples * width).astype(np.uint32),
        got.location,
        pulses.measured_direction[pulse],
        METRES_PER_NS,
    )


def _reference_columns(strip: StripPlan, pulses: Pulses, got: Recorded) -> dict[str, NDArray]:
    pulse, number, of = _number_in_pulse(got.echo_start)
    return _at(pulses, pulse, got.echo_time) | {
        "intensity": np.minimum(got.echo_height * INTENSITY_SCALE, 65535).astype(np.uint16),
        "return_number": np.minimum(number, 15).astype(np.uint8),
        "number_of_returns": np.minimum(of, 15).astype(np.uint8),
        "classification": got.echo_class,
        "point_source_id": np.full(len(pulse), strip.number + 1, np.uint16),
        "gps_time": strip.first_time + pulses.time[pulse],
        "scan_angle": np.rint(pulses.scan_angle[pulse] / 0.006).astype(np.int16),
        "amplitude": got.echo_height.astype(np.float32),
        "width": (got.echo_sigma * FWHM_PER_SIGMA).astype(np.float32),
    }


def _beside(path: Path) -> Path:
    """Where a file is written before it takes its name."""
    return path.with_name(f".{path.name}.part")


def _finish(path: Path) -> int:
    """Make the file beside durable, give it its name; returns its size [bytes]."""
    beside = _beside(path)
    with beside.open("rb") as file:
        os.fsync(file.fileno())
    beside.replace(path)
    return path.stat().st_size


def simulate_strip(params: SimulateParams, strip: StripPlan, out: Path) -> dict[str, Any]:
    """Fly one strip and write ``strips/<name>.las``, ``strips/<name>.wdp`` and ``reference/<name>.las``.

    The strip's file holds the on-board returns of every pulse that had one, with its waveform packet. The
    reference holds the true echoes of the same pulses (same `gps_time`), with class, amplitude [DN] and width [ns].
    Files are written beside and renamed when whole. The bytes depend on `params` and `strip` only.

    Returns
    -------
    Facts for JSON: name, pulses fired, and of these `empty_record`, `silent` (seen, but no return), `cut` (outside the
    area or in the gap) and `unseen`; returns; echoes; echoes per class code; bytes; seconds.
    """
    begun = time.perf_counter()
    points, packets = (out / "strips" / f"{strip.name}.{end}" for end in ("las", "wdp"))
    reference = out / "reference" / f"{strip.name}.las"
    for path in (points, reference):
        path.parent.mkdir(parents=True, exist_ok=True)
    flyer = _Flyer(params, strip)
    fates, classes = np.zeros(4, np.int64), np.zeros(256, np.int64)
    returns = 0
    with (
        PacketWriter(_beside(packets), strip.recording.bits) as wdp,
        laspy.open(_beside(points), "w", header=strip_header(params, strip.recording)) as las,
        laspy.open(_beside(reference), "w", header=reference_header(params)) as labels,
    ):
        for first in range(0, strip.pulses, params.chunk):
            pulses, flown = flyer.fly(first, min(params.chunk, strip.pulses - first))
            fates += np.bincount(flown.fate, minlength=4)
            classes += np.bincount(flown.echo_class, minlength=256)
            returns += len(flown.location)
            first_byte = wdp.append(flown.samples)
            columns = _return_columns(strip, params.sensor.short_segment, pulses, flown, first_byte)
            write_points(las, columns)
            write_points(labels, _reference_columns(strip, pulses, flown))
    written = sum(_finish(path) for path in (packets, points, reference))
    return {
        "name": strip.name,
        "pulses": strip.pulses,
        "recorded": int(fates[RECORDED]),
        "silent": int(fates[SILENT]),
        "cut": int(fates[CUT]),
        "unseen": int(fates[UNSEEN]),
        "returns": returns,
        "echoes": int(classes.sum()),
        "classes": {int(code): int(classes[code]) for code in np.flatnonzero(classes)},
        "bytes": written,
        "seconds": round(time.perf_counter() - begun, 3),
    }


def write_trajectory(params: SimulateParams, out: Path) -> Path:
    """Write ``trajectory.csv``: strip, gps_time [s], x, y, z [m], roll, pitch, heading [degrees]; returns its path."""
    path = out / "trajectory.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = ["strip,gps_time,x,y,z,roll,pitch,heading"]
    for strip in plan_strips(params):
        last = strip.lines * strip.spacing / params.flight.speed
        when = np.arange(int(last * params.flight.trajectory_rate) + 2) / params.flight.trajectory_rate
        at = measure_pose(params, strip, pose(params, strip, when), when)
        table = np.column_stack(
            [
                strip.first_time + when,
                at.x + params.origin_x,
                at.y + params.origin_y,
                at.z + params.base_height,
                np.degrees(at.roll),
                np.degrees(at.pitch),
                np.degrees(at.heading) % 360.0,
            ]
        )
        rows += [
            f"{strip.name},{t:.6f},{x:.3f},{y:.3f},{z:.3f},{roll:.5f},{pitch:.5f},{heading:.5f}"
            for t, x, y, z, roll, pitch, heading in table.tolist()
        ]
    _beside(path).write_text("\n".join(rows) + "\n", encoding="utf-8")
    _finish(path)
    return path
