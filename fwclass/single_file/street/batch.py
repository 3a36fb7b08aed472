"""A whole recording classified in chunks of frames on Dask: the bytes of the on-line run."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from fwclass.assess.blocks import BlockCounts
from fwclass.conf import Config
from fwclass.conf.street import scanner
from fwclass.errors import InputError
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import StageInputs
from fwclass.graph.street import crown_accuracy, model_remarks, params_of
from fwclass.graph.street_answers import Answering, halo
from fwclass.graph.street_recordings import (
    NO_TRAJECTORY,
    TrajectoryFiles,
    implausible,
    open_on_trajectory,
    untested_words,
)
from fwclass.model import Model
from fwclass.publish.files import written_whole
from fwclass.report.drift import drift
from fwclass.run.inputs import PartInputs
from fwclass.run.runner import Runner, require_all
from fwclass.single_file.street.output import finish
from fwclass.store.models import load_model, load_same, model_digest
from fwclass.store.unchanged import check_unchanged
from fwclass.street.answers import ANSWERS, END, Writer, read_answers
from fwclass.street.frames import Geometry, Placed, Scan
from fwclass.street.params import StreetParams
from fwclass.street.prescription import seen_again, segments
from fwclass.street.track import Track

FRAMES, CHUNK, VERSION = "street-frames", "street-chunk", 6
PART = "frames.bin"
_COLUMNS = {"number": "<i8", "time": "<f8", "place": "<i8", "road": "<f8"}
_GRIDS = {"ranges": "<f4", "x": "<i4", "y": "<i4", "z": "<i4", "light": "<i4", "labels": "u1"}
"""What is kept of a frame's beams; x only of a leaning scanner, light only where the model asks for it, labels only
where there are some."""


@dataclass(frozen=True)
class Work:
    """What is classified by what."""

    recording: Path
    model: Path
    params: StreetParams
    trajectory: TrajectoryFiles = NO_TRAJECTORY
    digest: str = ""


def check(work: Work) -> None:
    """`InputError` or `ConfigError` where the model or the recording cannot be used, before anything is written."""
    params_of(load_model(work.model), work.params, work.model)
    open_on_trajectory(work.recording, work.params, work.trajectory)


def read(here: StageInputs, work: Work) -> Mapping[str, Any]:
    """Take the frames of the recording one after the other and keep those that are used, as flat files."""
    with check_unchanged(work.recording, *work.trajectory.files):
        return _read(work, here.directory)


def _read(work: Work, directory: Path) -> Mapping[str, Any]:
    scan = Scan.of(scanner(work.params.scanner))
    track = Track(work.params)
    columns: dict[str, list[Any]] = {n: [] for n in _COLUMNS}
    files: dict[str, BinaryIO] = {}
    kept: tuple[str, ...] = ()
    try:
        recording = open_on_trajectory(work.recording, work.params, work.trajectory)
        for frame in recording.frames():
            placed = track.take(frame)
            if placed is None or placed.repeats:
                continue
            if not files and track.geometry is not None:
                leaning = ("x",) if track.geometry.tilted else ()
                light = ("light",) if len(placed.light) else ()
                kept = ("ranges", *leaning, "y", "z", *light, *(("labels",) if placed.labels is not None else ()))
                files = {n: (directory / f"{n}.bin").open("wb") for n in kept}
            for name in _COLUMNS:
                columns[name].append(getattr(placed, name))
            for name in kept:
                values = placed.r if name == "ranges" else getattr(placed, name)
                none = np.zeros(len(placed.r), np.uint8)
                files[name].write(np.ascontiguousarray(none if values is None else values, _GRIDS[name]).tobytes())
    finally:
        for file in files.values():
            file.close()
    for name, kind in _COLUMNS.items():
        (directory / f"{name}.bin").write_bytes(np.array(columns[name], kind).tobytes())
    used = track.geometry.scan if track.geometry else scan
    return {
        "frames": len(columns["number"]),
        "kept": list(kept),
        "scan": [used.beams, used.first, used.step, used.range_min, used.range_max],
        "counts": track.counts(),
        "implausible": implausible(recording, track.counts(), work.params),
        "untested": untested_words(recording, track.counts()),
    }


def _scan(meta: Mapping[str, Any]) -> Scan:
    return Scan(int(meta["scan"][0]), *map(float, meta["scan"][1:]))


def chunk(here: StageInputs, work: Work, first: int, last: int) -> Mapping[str, Any]:
    """Answer the frames `first` to `last`, with as many before and after as their answers may reach over."""
    meta = here.inputs.meta(FRAMES, "all")
    scan, model = _scan(meta), load_same(work.model, work.digest)
    around = halo(work.params)
    low, high = max(0, first - around), min(int(meta["frames"]), last + around)
    geometry = Geometry.of(scan, work.params.mounting)
    answering = Answering(model, work.params, geometry, range(first - low, last - low))
    writer = Writer(scan.beams, geometry.tilted)
    with (here.directory / PART).open("wb") as file:
        for frame in _frames(here.inputs, meta, scan, low, high):
            for _, one in answering.take(frame):
                file.write(writer.frame(one))
        for _, one in answering.rest():
            file.write(writer.frame(one))
    outside = answering.outside
    return {"most": answering.most, "cut": answering.cut, "outside": outside.counts() if outside is not None else {}}


def _frames(inputs: PartInputs, meta: Mapping[str, Any], scan: Scan, low: int, high: int) -> Iterator[Placed]:
    def column(name: str) -> NDArray:
        return np.fromfile(inputs.path(FRAMES, "all", f"{name}.bin"), _COLUMNS[name])[low:high]

    def grid(name: str) -> NDArray:
        kind = np.dtype(_GRIDS[name])
        path = inputs.path(FRAMES, "all", f"{name}.bin")
        values = np.fromfile(path, kind, (high - low) * scan.beams, offset=low * scan.beams * kind.itemsize)
        return values.reshape(high - low, scan.beams)

    columns = {n: column(n) for n in _COLUMNS}
    grids = {n: grid(n) for n in meta["kept"] if n != "labels"}
    none = np.empty(0, np.int32)
    for k in range(high - low):
        x = grids["x"][k] if "x" in grids else none
        row = (grids["y"][k], grids["z"][k], grids["ranges"][k], grids["light"][k] if "light" in grids else none)
        number, time, place, road = (columns[n][k] for n in _COLUMNS)
        yield Placed(int(number), float(time), int(place), float(road), x, *row)


def stages(work: Work, frames: int) -> tuple[Stage, Stage]:
    """Reading the frames, and answering those that are used, `frames` in all, in chunks."""
    step = work.params.chunk
    read_frames = Stage(FRAMES, VERSION, "survey", "part", read, arguments=lambda plan: {"work": work})
    answer_chunk = replace(
        read_frames,
        name=CHUNK,
        function=chunk,
        parts=lambda plan: range(0, frames, step),
        part_name=lambda at: f"{at:09d}",
        each=lambda plan, at: {"first": at, "last": min(at + step, frames)},
        after=(FRAMES,),
        needs=lambda plan, at: ((FRAMES, "all"),),
    )
    return read_frames, answer_chunk


def classify(work: Work, target: Path, runner: Runner, config: Config) -> dict[str, Any]:
    """Classify a recording into `target` (see `output`), judged where it has labels; plain data."""
    digest = model_digest(work.model)
    model = load_same(work.model, digest)
    remarks = model_remarks(model, work.params)
    work = replace(work, params=params_of(model, work.params, work.model), digest=digest)
    plan = Plan(config)
    read_frames, _ = stages(work, 0)
    meta = require_all(runner, read_frames.tasks(plan))[FRAMES, "all"].meta
    count = int(meta["frames"])
    if not count:
        raise InputError(
            "no frame of the recording can be used", where=work.recording, got=meta["counts"], do="fwclass street info"
        )
    _, answer_chunk = stages(work, count)
    tasks = list(answer_chunk.tasks(plan))
    receipts = require_all(runner, tasks)
    geometry = Geometry.of(_scan(meta), work.params.mounting)
    with written_whole(target / ANSWERS) as beside, beside.open("wb") as file:
        file.write(Writer(geometry.scan.beams, geometry.tilted).head)
        for task in tasks:
            with runner.store.path(CHUNK, task.part, PART).open("rb") as part:
                shutil.copyfileobj(part, file, 1 << 20)
        file.write(END)
    accuracy = _judge(runner, meta, model, target, config.assess.block) if "labels" in meta["kept"] else None
    most, cut = (f(receipts[t.name].meta[k] for t in tasks) for f, k in ((max, "most"), (sum, "cut")))
    drifted = drift(model.card, [receipts[t.name].meta["outside"] for t in tasks])
    most_frames = 2 * work.params.most_frames + 1
    prescribed, again = segments(read_answers(target / ANSWERS), work.params, int(model.codes[0]), geometry)
    summary = {
        **meta["counts"],
        "neighbourhood": {"most_frames": most, "held": most_frames, "cut": cut},
        "accuracy": accuracy,
        "implausible": meta["implausible"],
        "drift": drifted,
        "remarks": [*remarks, *(drifted or {}).get("remarks", ()), *seen_again(again), *meta["untested"]],
        "street": work.params.model_dump(mode="json"),
    }
    return finish(target, prescribed, summary)


def _judge(runner: Runner, meta: Mapping[str, Any], model: Model, target: Path, block: float) -> dict[str, Any] | None:
    """Figures where the recording has labels."""
    scan = _scan(meta)
    labels = np.memmap(runner.store.path(FRAMES, "all", "labels.bin"), np.uint8, "r").reshape(-1, scan.beams)
    parts = []
    for row, one in zip(labels, read_answers(target / ANSWERS), strict=True):
        here = one.classification > 0
        place = one.along[here]
        parts.append(
            BlockCounts.of(place, np.zeros_like(place), row[here], one.classification[here], model.classes, block)
        )
        if len(parts) > 500:
            parts = [BlockCounts.merged(parts, len(model.classes))]
    accuracy = crown_accuracy(BlockCounts.merged(parts, len(model.classes)), model.classes)
    return accuracy if accuracy["rows"] else None
