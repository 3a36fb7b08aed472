"""Recordings of a vehicle's scanner: rows that train and test, the model, and how good it is."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.assess.blocks import BlockCounts
from fwclass.assess.confusion import figures
from fwclass.assess.intervals import DRAWS, LEVEL, SEED, intervals
from fwclass.classify.shares import answer
from fwclass.conf import Config
from fwclass.errors import ConfigError, InputError
from fwclass.graph.street_answers import Answering
from fwclass.graph.street_recordings import NO_TRAJECTORY, TrajectoryFiles, implausible, open_on_trajectory
from fwclass.hashing import hash_keys
from fwclass.model import ClassDef, Model, class_index
from fwclass.schema import Table
from fwclass.street.answers import Answer
from fwclass.street.frames import Geometry, Placed
from fwclass.street.params import StreetParams
from fwclass.street.ring import Ring, Seen, feature_names
from fwclass.street.sphere_kernels import UNIT
from fwclass.street.track import Track
from fwclass.survey.files import matching_paths
from fwclass.train.baselines.params import CompareParams
from fwclass.train.baselines.stage import fit_classifier
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample, draw, join

Tell = Callable[[Path, list[str]], None]

BLOCK = 100
"""Frames whose rows are held at a time."""

LEAST = 5
"""Blocks of road that an interval needs; see `assess.intervals`."""


def recordings_of(config: Config, directory: Path | None = None) -> list[Path]:
    """The survey's recordings in order; `ConfigError` where there are none. `directory`: in place of the survey's."""
    base = directory or config.path.parent / (config.survey.directory or ".")
    excluded = {path for pattern in config.survey.exclude for path in matching_paths(pattern, base)}
    paths = [p for pattern in config.survey.sources for p in matching_paths(pattern, base) if p not in excluded]
    if not paths:
        raise ConfigError(
            "no recording of this name",
            where=f"{config.path}: survey.sources",
            expected=f"files in {base}",
            got=", ".join(config.survey.sources),
            do="check survey.directory and survey.sources",
        )
    return list(dict.fromkeys(paths))


def feature_parameters(params: StreetParams) -> dict[str, Any]:
    """What the values of the features depend on; plain data for a model's card."""
    return {
        "street": {
            "radii": list(params.radii),
            "features": params.features,
            "window": params.window,
            "most_frames": params.most_frames,
            "spacing": params.spacing,
            "stood": params.stood,
            **({} if params.intensity is None else {"intensity": params.intensity}),
        },
        "mounting": params.mounting.model_dump(mode="json"),
    }


def params_of(model: Model, params: StreetParams, where: object) -> StreetParams:
    """`params` with what the features of `model` were computed by; `ConfigError` for a model of other features."""
    settings = _learned_settings(model)
    try:
        changed = (
            StreetParams.model_validate({**params.model_dump(), "intensity": None, **settings})
            if settings is not None
            else None
        )
    except ValueError:
        changed = None
    if changed is None or feature_names(changed) != model.features:
        raise ConfigError(
            "the model does not decide by features of frames",
            where=where,
            expected="a model of `fwclass street train`",
            got=", ".join(model.features[:5]) + (" …" if len(model.features) > 5 else ""),
            do="train one: fwclass street train CONF --model DIR",
        )
    return changed


def _learned_settings(model: Model) -> Mapping[str, Any] | None:
    """What the features of `model` were computed by; None where its card does not say."""
    settings = model.card.get("computed", {}).get("street")
    return settings if isinstance(settings, Mapping) else None


def learned_mounting(model: Model) -> dict[str, Any] | None:
    """How the scanner sat where `model` learned; None where its card does not say."""
    mounting = model.card.get("computed", {}).get("mounting")
    return dict(mounting) if isinstance(mounting, Mapping) else None


def model_remarks(model: Model, params: StreetParams) -> list[str]:
    """Settings of `params` that the model's own stand for, and another mounting than it learned with."""
    asked = {**feature_parameters(params)["street"], "intensity": params.intensity}
    learned = {**asked, "intensity": None, **(_learned_settings(model) or {})}
    said = [
        f"street.{name} is the model's, {learned[name]}, not {value}"
        for name, value in asked.items()
        if learned[name] != value and not (name == "intensity" and value is None)
    ]
    mounting, here = learned_mounting(model), params.mounting.model_dump(mode="json")
    there = {name: (mounting or here).get(name) for name in here}
    other = [name for name in here if there[name] != here[name]]
    if other:
        words = ", ".join(f"{name} {there[name]} there, {here[name]} here" for name in other)
        said.append(f"the model learned with another mounting ({words}): heights and sides count from the scanner")
    return said


@dataclass(frozen=True)
class Rows:
    """Returns of some frames, in order.

    `X`: float32 (rows, features). `codes`: uint8 (rows,), reference class codes, 0 none. `key`: uint64 (rows,), of
    recording, frame and beam. `place`, `depth`: float64 (rows,), along the road and to the left [m].
    """

    X: NDArray[np.float32]
    codes: NDArray[np.uint8]
    key: NDArray[np.uint64]
    place: NDArray[np.float64]
    depth: NDArray[np.float64]

    def take(self, rows: NDArray) -> Rows:
        """Only `rows` (index or mask)."""
        return Rows(self.X[rows], self.codes[rows], self.key[rows], self.place[rows], self.depth[rows])


def rows_of(
    paths: Sequence[Path], params: StreetParams, trajectory: TrajectoryFiles = NO_TRAJECTORY, tell: Tell | None = None
) -> Iterator[Rows]:
    """All returns of the recordings, by blocks of frames; `tell` takes what each recording shows that no sound one does
    (`implausible`), after its last frame."""
    for number, path in enumerate(paths):
        frames = frames_with_features(path, params, trajectory, tell)
        yield from _blocks(_rows(number, at, one.frame, one.features) for at, one in enumerate(frames))


def answered_rows(
    paths: Sequence[Path], params: StreetParams, model: Model, trajectory: TrajectoryFiles = NO_TRAJECTORY
) -> Iterator[Rows]:
    """As `rows_of`, with the class codes that `model` answers in place of features (rows, 1)."""
    for number, path in enumerate(paths):
        answers = _answered(path, params, model, trajectory)
        yield from _blocks(_rows(number, at, frame, codes) for at, (frame, codes) in enumerate(answers))


def _answered(
    path: Path, params: StreetParams, model: Model, trajectory: TrajectoryFiles
) -> Iterator[tuple[Placed, NDArray[np.float32]]]:
    """The frames of a recording, and the class codes of their beams (beams, 1)."""
    answering: Answering | None = None

    def columns(answers: Iterable[tuple[Placed, Answer]]) -> Iterator[tuple[Placed, NDArray[np.float32]]]:
        return ((frame, one.classification[:, None].astype(np.float32)) for frame, one in answers)

    for placed, geometry in _placed_frames(path, params, trajectory):
        answering = answering or Answering(model, params, geometry)
        yield from columns(answering.take(placed))
    if answering is not None:
        yield from columns(answering.rest())


def _blocks(frames: Iterable[Rows]) -> Iterator[Rows]:
    """The rows of `BLOCK` frames at a time."""
    frames = iter(frames)
    while some := list(islice(frames, BLOCK)):
        yield join_rows(some)


def frames_with_features(
    path: Path, params: StreetParams, trajectory: TrajectoryFiles = NO_TRAJECTORY, tell: Tell | None = None
) -> Iterator[Seen]:
    """The frames of a recording with their features; `tell` as `rows_of` has it."""
    ring: Ring | None = None
    for placed, geometry in _placed_frames(path, params, trajectory, tell):
        ring = ring or Ring(geometry, params)
        yield from ring.take(placed)
    if ring is not None:
        yield from ring.rest()


def _placed_frames(
    path: Path, params: StreetParams, trajectory: TrajectoryFiles, tell: Tell | None = None
) -> Iterator[tuple[Placed, Geometry]]:
    """The frames of a recording that are used; `tell` as `rows_of` has it."""
    track, recording = Track(params), open_on_trajectory(path, params, trajectory)
    for frame in recording.frames():
        placed = track.take(frame)
        if placed is not None and not placed.repeats and track.geometry is not None:
            yield placed, track.geometry
    if tell is not None:
        tell(path, implausible(recording, track.counts(), params))


def _rows(recording: int, at: int, frame: Placed, values: NDArray[np.float32]) -> Rows:
    """`values`: (beams, features) of the frame."""
    beams = np.flatnonzero(~np.isnan(frame.r))
    codes = frame.labels[beams] if frame.labels is not None else np.zeros(len(beams), np.uint8)
    key = (np.uint64(recording) << np.uint64(48)) | (np.uint64(at) << np.uint64(16))
    return Rows(
        values[beams],
        codes,
        key | beams.astype(np.uint64),
        (frame.place + (frame.x[beams] if len(frame.x) else np.zeros(len(beams)))).astype(np.float64) * UNIT,
        frame.y[beams].astype(np.float64) * UNIT,
    )


def join_rows(parts: Sequence[Rows]) -> Rows:
    """The rows of all parts, in order."""
    return Rows(
        np.concatenate([p.X for p in parts]),
        np.concatenate([p.codes for p in parts]),
        np.concatenate([p.key for p in parts]),
        np.concatenate([p.place for p in parts]),
        np.concatenate([p.depth for p in parts]),
    )


@dataclass(frozen=True)
class Split:
    """Which returns train and which test: a `share` at random, or those in `boxes` [m along the road, to the left]
    and those further than `gap` along the road from all of them."""

    kind: str
    share: float
    seed: int
    boxes: tuple[tuple[float, float, float, float], ...]
    gap: float

    @classmethod
    def of(cls, config: Config) -> Split:
        """That of `street.split` and `areas.train`."""
        street = config.street
        return cls(street.split, street.share, config.train.seed, config.areas.train, config.areas.gap)

    def trains(self, rows: Rows) -> NDArray[np.bool_]:
        """bool (rows,): which train."""
        if self.kind == "random":
            return hash_keys(self.seed, rows.key) < np.uint64(min(self.share * 2.0**64, 2.0**64 - 2048))
        inside = np.zeros(len(rows.place), bool)
        for x0, y0, x1, y1 in self.boxes:
            inside |= (rows.place >= x0) & (rows.place < x1) & (rows.depth >= y0) & (rows.depth < y1)
        return inside

    def tests(self, rows: Rows) -> NDArray[np.bool_]:
        """bool (rows,): which test; with boxes, those that are further than the gap from each along the road."""
        if self.kind == "random":
            return ~self.trains(rows)
        far = np.ones(len(rows.place), bool)
        for x0, _, x1, _ in self.boxes:
            far &= (rows.place < x0 - self.gap) | (rows.place >= x1 + self.gap)
        return far


def sample_of(
    blocks: Iterable[Rows], names: tuple[str, ...], split: Split, classes: Sequence[ClassDef], per_class: int
) -> Sample:
    """The training rows; `InputError` where no return trains."""
    parts = []
    for rows in blocks:
        inside = split.trains(rows) & (class_index(rows.codes, classes) >= 0)
        if inside.any():
            few = rows.take(inside)
            table = Table({n: few.X[:, k] for k, n in enumerate(names)})
            every = np.ones(len(few.key), bool)
            parts.append(draw(table, few.codes, few.key, every, classes, per_class, split.seed))
    if not parts:
        raise InputError(
            "no labelled return trains",
            where="areas.train" if split.kind == "stretch" else "street.share",
            expected="frames with labels in the recordings",
            got="none",
            do="label some (fwclass street annotate), or give boxes along the road that they lie in",
        )
    return join(parts, per_class)


def fit_model(
    sample: Sample, params: StreetParams, train: TrainParams, compare: CompareParams, classes: Sequence[ClassDef]
) -> Model:
    """A model of the method that `train` names, whose card says how its features were computed."""
    model: Any = fit_classifier(sample, train, compare, classes, judged=False)
    return replace(model, card={**model.card, "computed": feature_parameters(params)})


def judge_answers(
    blocks: Iterable[Rows],
    answers: Callable[[Rows], NDArray[np.uint8]],
    split: Split | None,
    classes: Sequence[ClassDef],
    block: float,
) -> dict[str, Any]:
    """`crown_accuracy` of the test rows (of all without `split`). `block`: of road, for intervals [m]."""
    parts = []
    for rows in blocks:
        chosen = class_index(rows.codes, classes) >= 0
        if split is not None:
            chosen &= split.tests(rows)
        few = rows.take(chosen)
        if len(few.key):
            road = few.place + 1e6 * (few.key >> np.uint64(48))  # recordings are apart
            parts.append(BlockCounts.of(road, np.zeros(len(road)), few.codes, answers(few), classes, block))
    return crown_accuracy(BlockCounts.merged(parts, len(classes)), classes)


def as_answered(rows: Rows) -> NDArray[np.uint8]:
    """Class codes of `answered_rows`."""
    return rows.X[:, 0].astype(np.uint8)


def by_model(model: Model) -> Callable[[Rows], NDArray[np.uint8]]:
    """Class codes that `model` gives rows."""
    return lambda rows: model.codes[answer(rows.X, model)[0]]


CROWN_FIGURES = ("error", "detection", "false_alarm")


def crown_accuracy(blocks: BlockCounts, classes: Sequence[ClassDef]) -> dict[str, Any]:
    """Figures of `confusion.figures`, and of the first class, the crowns, those of Li 2018 with 95 % intervals.

    error: wrong / all. detection: crown returns found / crown returns. false_alarm: other returns taken for crown /
    other returns.
    """
    counts = blocks.counts[:, :, : len(classes)]
    matrix = counts.sum(axis=0)
    values, ends = crown_figures(matrix[None])[0], None
    if len(counts) >= LEAST:
        random = np.random.Generator(np.random.PCG64(SEED))
        flat = counts.reshape(len(counts), -1)
        drawn = np.stack([flat[random.integers(0, len(flat), len(flat))].sum(axis=0) for _ in range(DRAWS)])
        tails = (0.5 * (1.0 - LEVEL), 0.5 * (1.0 + LEVEL))
        ends = np.nanquantile(crown_figures(drawn.reshape(-1, *matrix.shape)), tails, axis=0)
    accuracy: dict[str, Any] = {**figures(matrix, [c.name for c in classes]), "rows": int(matrix.sum())}
    accuracy["intervals"] = intervals(counts)
    accuracy["blocks"] = len(counts)
    for k, name in enumerate(CROWN_FIGURES):
        accuracy[name] = None if np.isnan(values[k]) else float(values[k])
        accuracy[f"{name}_interval"] = None if ends is None else [float(v) for v in ends[:, k]]
    return accuracy


def crown_figures(matrices: NDArray[np.int64]) -> NDArray[np.float64]:
    """(matrices, 3): error, detection and false alarm of the first class; NaN for 0 / 0."""
    m = matrices.astype(float)
    rows = m.sum(axis=2)
    right = np.trace(m, axis1=1, axis2=2)
    with np.errstate(invalid="ignore", divide="ignore"):
        error = 1.0 - right / rows.sum(axis=1)
        detection = m[:, 0, 0] / rows[:, 0]
        alarm = m[:, 1:, 0].sum(axis=1) / rows[:, 1:].sum(axis=1)
    return np.stack([error, detection, alarm], axis=1)
