"""Crowns while the vehicle drives: frames as they come, the middle one answered, files whole at every moment."""

from __future__ import annotations

import contextlib
import gc
import math
import os
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np

from fwclass.conf.street import scanner
from fwclass.errors import FwclassError, InputError
from fwclass.graph.street import model_remarks, params_of
from fwclass.graph.street_answers import Answering
from fwclass.graph.street_recordings import (
    NO_TRAJECTORY,
    TrajectoryFiles,
    implausible,
    open_on_trajectory,
    untested_words,
)
from fwclass.model import Model
from fwclass.report.drift import drift
from fwclass.single_file.street.output import CSV, HEAD, finish, working_in
from fwclass.single_file.street.sources import from_recording, listening, place_of, standard_input
from fwclass.single_file.street.train import crown_lines
from fwclass.store.models import load_model
from fwclass.store.unchanged import check_unchanged
from fwclass.street.answers import ANSWERS, END, Answer, Writer
from fwclass.street.frames import Frame, Geometry, Recording, Scan
from fwclass.street.params import StreetParams
from fwclass.street.prescription import Prescriber, Segment, seen_again
from fwclass.street.track import Track

WARM = 40
"""Frames that everything is gone through with before anything is listened to, so that nothing compiles later."""


@dataclass
class Loop:
    """One frame in, the answers that it completes out; the same for every source.

    `answering` is None until a frame came that is used.
    """

    model: Model
    params: StreetParams

    def __post_init__(self) -> None:
        self.track = Track(self.params)
        self.answering: Answering | None = None

    def take(self, frame: Frame) -> Iterator[Answer]:
        """The answers that this frame completes, in order; it may be left out and complete none."""
        placed = self.track.take(frame)
        if placed is None or placed.repeats:
            return
        if self.answering is None and self.track.geometry is not None:
            self.answering = Answering(self.model, self.params, self.track.geometry)
        if self.answering is not None:
            yield from (one for _, one in self.answering.take(placed))

    def rest(self) -> Iterator[Answer]:
        """The answers of the frames that still wait, when no other comes."""
        if self.answering is not None:
            yield from (one for _, one in self.answering.rest())


def append(file: FileIO, data: bytes | memoryview) -> None:
    """Write all of `data` behind what is there, or none of it: a disk that fills up takes the first bytes."""
    at, left = file.tell(), memoryview(data)
    try:
        while left:
            left = left[file.write(left) :]
    except OSError as fault:
        file.truncate(at)
        raise FwclassError(
            "the answers cannot be written any further",
            where=str(file.name),
            got=fault.strerror or type(fault).__name__,
            do="what was answered stays; make room, and name another directory",
        ) from fault


@dataclass
class Files:
    """The answers and segments of a run, appended."""

    target: Path
    params: StreetParams
    crown: int

    def __post_init__(self) -> None:
        self._writer: Writer | None = None
        self._prescriber = Prescriber(self.params, self.crown)
        self._answers = (self.target / ANSWERS).open("wb", buffering=0)
        self._csv = (self.target / CSV).open("wb", buffering=0)
        append(self._csv, HEAD.encode())

    @property
    def again(self) -> int:
        """As `Prescriber.again`."""
        return self._prescriber.again

    def write(self, one: Answer, geometry: Geometry | None) -> None:
        """Append an answer by one call, and the segments that it shows to be left."""
        if self._writer is None:
            self._writer = Writer(len(one.classification), len(one.x) > 0)
            self._prescriber = Prescriber(self.params, self.crown, geometry)
            append(self._answers, self._writer.head)
        append(self._answers, self._writer.frame(one))
        self._append(self._prescriber.take(one))

    def _append(self, segments: Iterator[Segment]) -> None:
        for segment in segments:
            append(self._csv, (segment.line() + "\n").encode())

    def end(self) -> None:
        """Append what is open, end the stream, and force both files to the disk."""
        self._append(self._prescriber.rest())
        if self._writer is not None:
            append(self._answers, END)
        for file in (self._answers, self._csv):
            os.fsync(file.fileno())
            file.close()


@dataclass(frozen=True)
class Run:
    """What `fwclass street run` was asked for."""

    source: str
    model: Path
    target: Path
    paced: bool
    overwrite: bool
    trajectory: TrajectoryFiles = NO_TRAJECTORY


def run(job: Run, params: StreetParams, say: Callable[[str], None]) -> dict[str, Any]:
    """Answer a source of frames until it ends; plain data on latency and faults.

    `InputError`: the source broke off, stalled or holds no frame; what was answered stays. `KeyboardInterrupt`: the
    user ended it; the files are whole.
    """
    model = load_model(job.model)
    remarks = model_remarks(model, params)
    params = params_of(model, params, job.model)
    if job.source.startswith("tcp://"):
        place_of(job.source)
    elif job.source != "-":
        open_on_trajectory(Path(job.source), params, job.trajectory)
    with working_in(job.target, job.overwrite):
        return _answer(job, model, params, remarks, say)


def _answer(
    job: Run, model: Model, params: StreetParams, remarks: list[str], say: Callable[[str], None]
) -> dict[str, Any]:
    """As `run`, into a directory that is held."""
    warm(model, params)
    with interruptible() as ended, ExitStack() as stack, without_garbage():
        faults: Counter[str] = Counter()
        frames, stream, recording = _source(job, params, ended, say, stack)
        files = Files(job.target, params, int(model.codes[0]))
        loop, latency, late = Loop(model, params), Latency(), 0
        broken: InputError | None = None
        read_from = () if recording is None else (Path(job.source), *job.trajectory.files)
        try:
            with check_unchanged(*read_from):
                for frame, there in frames:
                    delivered = False
                    for one in loop.take(frame):
                        files.write(one, loop.track.geometry)
                        delivered = True
                    took = time.perf_counter() - there
                    if delivered:
                        latency.add(took)
                    late += math.isfinite(loop.track.period) and took > loop.track.period
        except InputError as fault:
            broken = fault
        for one in loop.rest():
            files.write(one, loop.track.geometry)
        files.end()
        interrupted = ended()
        faults.update(stream.faults if stream is not None else {})
    summary = _summary(loop, latency, late, faults, params)
    outside = loop.answering.outside if loop.answering is not None else None
    drifted = drift(model.card, [outside.counts()] if outside is not None else [])
    remarks += [*(drifted or {}).get("remarks", []), *seen_again(files.again), *untested_words(recording, summary)]
    summary |= {
        "drift": drifted,
        "implausible": implausible(recording, summary, params, summary["stream"]),
        "remarks": remarks,
    }
    summary = finish(job.target, None, summary)
    if broken is not None:
        raise broken
    if stream is not None and stream.stalled:
        raise InputError(
            f"no frame came for {params.stream.stall:g} s",
            where=job.source,
            got=f"{summary['frames']} frames before"
            + "".join(f", {n} {name}" for name, n in stream.faults.items() if n),
            do="what was answered stays; look at the sender, or give --set street.stream.stall=SECONDS",
        )
    if interrupted:
        raise KeyboardInterrupt
    if not summary["frames"]:
        raise InputError("not one frame came", where=job.source, expected="frames", got=dict(faults) or "nothing")
    return summary


def _source(
    job: Run, params: StreetParams, ended: Callable[[], bool], say: Callable[[str], None], stack: ExitStack
) -> tuple[Iterator[tuple[Frame, float]], Any, Recording | None]:
    if job.source == "-":
        stream = standard_input(params.stream, ended)
        return stream.frames(), stream, None
    if job.source.startswith("tcp://"):
        stream = stack.enter_context(listening(job.source, params.stream, ended, say))
        return stream.frames(), stream, None
    recording = open_on_trajectory(Path(job.source), params, job.trajectory)
    return from_recording(recording, job.paced, ended), None, recording


def warm(model: Model, params: StreetParams) -> None:
    """Go through everything once, in memory: kernels are loaded, or compiled, before the first frame."""
    scan = Scan.of(scanner(params.scanner))
    loop = Loop(model, params.model_copy(update={"speed": 1.0}))
    random = np.random.default_rng(1)
    answers = []
    for k in range(WARM):
        ranges = random.uniform(0.5 * scan.range_max, scan.range_max, scan.beams).astype(np.float32)
        light = np.zeros(scan.beams, np.float32) if params.intensity is not None else None
        answers += list(loop.take(Frame(k, 0.025 * k, scan, ranges, intensities=light)))
    answers += list(loop.rest())
    geometry = loop.track.geometry
    writer = Writer(scan.beams, geometry is not None and geometry.tilted)
    prescriber = Prescriber(params, int(model.codes[0]), geometry)
    for one in answers:
        writer.frame(one)
        list(prescriber.take(one))


@contextmanager
def without_garbage() -> Iterator[None]:
    """No collector meanwhile: nothing of the loop refers to itself, and a full collection takes some milliseconds."""
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.unfreeze()


@contextmanager
def interruptible() -> Iterator[Callable[[], bool]]:
    """A function that says whether SIGINT or SIGTERM came."""
    seen: list[int] = []
    before = {}
    for number in (signal.SIGINT, signal.SIGTERM):
        with contextlib.suppress(ValueError):  # not the main thread
            before[number] = signal.signal(number, lambda s, _: seen.append(s))
    try:
        yield lambda: bool(seen)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _summary(loop: Loop, latency: Latency, late: int, faults: Counter[str], params: StreetParams) -> dict[str, Any]:
    most, cut = (loop.answering.most, loop.answering.cut) if loop.answering is not None else (0, 0)
    return {
        **loop.track.counts(),
        "latency": latency.summary(),
        "late": int(late),
        "stream": {name: n for name, n in faults.items() if n},
        "neighbourhood": {"most_frames": most, "held": 2 * params.most_frames + 1, "cut": cut},
        "street": params.model_dump(mode="json"),
    }


def describe(summary: dict[str, Any], target: Path) -> str:
    """The same for a terminal."""
    spent, near = summary["latency"], summary["neighbourhood"]
    lines = [f"frames       {summary['frames']}, {summary['used']} used, {summary['returns']} returns"]
    if spent["frames"]:
        lines.append(
            f"latency      median {spent['median_ms']:.2f} ms, 99 % {spent['p99_ms']:.2f}, 99.9 % "
            f"{spent['p999_ms']:.2f}, most {spent['most_ms']:.2f}"
        )
    lines.append(f"late         {summary['late']} frames took longer than the next one")
    lines.append(
        f"spheres      reach over up to {near['most_frames']} frames of {near['held']} held; {near['cut']} cut"
    )
    counts = {**summary["faults"], **summary["stream"]}
    if counts:
        lines.append("counted      " + ", ".join(f"{n} {cause}" for cause, n in counts.items()))
    return "\n".join([*lines, *output_lines(summary, target)])


def output_lines(summary: dict[str, Any], target: Path) -> list[str]:
    """How the scanner sat, what is implausible, and where answers and prescription lie."""
    mounting, height = summary["street"]["mounting"], summary["sound"]["scanner_height"]
    turned = "".join(f", {name} {mounting[name]:g}°" for name in ("roll", "pitch", "yaw") if mounting[name])
    measured = "" if height is None else f" (measured: {height:.2f} m)"
    return [
        f"mounting     looks {mounting['side']}, {mounting['height']:g} m above the road{measured}{turned}",
        *(f"remark       {text}" for text in summary["remarks"]),
        *(f"  ! {text}" for text in summary["implausible"]),
        f"answers      {target}",
        f"prescription {summary['segments']} segments: {target / CSV}",
    ]


def describe_batch(summary: dict[str, Any], target: Path) -> str:
    """What `street classify` tells."""
    near = summary["neighbourhood"]
    lines = [
        f"frames       {summary['frames']}, {summary['used']} used, {summary['returns']} returns",
        f"spheres      reach over up to {near['most_frames']} frames of {near['held']} held; {near['cut']} cut",
    ]
    if summary["faults"]:
        lines.append("counted      " + ", ".join(f"{n} {cause}" for cause, n in summary["faults"].items()))
    lines += crown_lines(summary["accuracy"]) if summary["accuracy"] else []
    return "\n".join([*lines, *output_lines(summary, target)])


BIN, BINS = 1e-5, 200_000
"""s; two seconds of them: the last bin holds what takes longer, so that an hour takes no more memory than a second."""


class Latency:
    """How long answers take: counts by bins of `BIN` seconds."""

    def __init__(self) -> None:
        self._counts = np.zeros(BINS, np.int64)
        self._most = 0.0

    def add(self, seconds: float) -> None:
        """Count one time [s]."""
        self._counts[min(int(seconds / BIN), BINS - 1)] += 1
        self._most = max(self._most, seconds)

    def summary(self) -> dict[str, float | int | None]:
        """Frames, median, 99 and 99.9 %, and the most [ms]; upper ends of bins."""
        total = int(self._counts.sum())
        sums = np.cumsum(self._counts)

        def quantile(share: float) -> float | None:
            return 1e3 * BIN * (int(np.searchsorted(sums, share * total)) + 1) if total else None

        return {
            "frames": total,
            "median_ms": quantile(0.5),
            "p99_ms": quantile(0.99),
            "p999_ms": quantile(0.999),
            "most_ms": round(1e3 * self._most, 3) if total else None,
        }
