"""What the sources' headers say of a survey, and one part of one file that is really read."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fwclass.conf import Config
from fwclass.errors import InputError
from fwclass.grid import Box
from fwclass.read.las import LasSource
from fwclass.read.points import PointReader, coordinates
from fwclass.read.source import PulseSource, Source, open_source
from fwclass.run.files import found_files
from fwclass.run.local import Loop
from fwclass.run.progress import Display
from fwclass.run.road import Road
from fwclass.run.survey import common_crs, directory_of, opened_all
from fwclass.simulate.params import SimulateParams
from fwclass.store.outside import local

PER_CELL = 16.0
"""Points that a cell of the sampled part holds on average: hardly any is empty by chance."""


@dataclass(frozen=True)
class SourceFacts:
    """A source file by its header.

    Attributes
    ----------
    points : returns that it holds; 0 where it holds pulses only.
    pulses : where it holds pulses only; 0 elsewhere.
    waves : it has waveforms.
    wave_bytes : of them [bytes].
    bounds : of its points [m].
    """

    path: Path
    points: int
    pulses: int
    waves: bool
    wave_bytes: int
    bounds: Box

    @property
    def records(self) -> int:
        return self.points or self.pulses


@dataclass(frozen=True)
class Sample:
    """One part of one file, read.

    Attributes
    ----------
    points : of it.
    density : mean over its points of how dense others lie around them [1/m²].
    even : what the header alone gives, points over bounds [1/m²].
    returns_per_pulse : mean.
    """

    path: Path
    points: int
    density: float
    even: float
    returns_per_pulse: float

    @property
    def crowding(self) -> float:
        """Times that points lie denser than evenly over the header's bounds; 1 where a file's order tells nothing."""
        return max(1.0, self.density / self.even)


@dataclass(frozen=True)
class SurveyFacts:
    """All that a plan knows of a survey. `simulated`: no file is there yet; `crs` is WKT or None."""

    sources: tuple[SourceFacts, ...]
    reference_points: int
    crs: str | None
    sample: Sample | None
    simulated: bool = False

    @property
    def box(self) -> Box:
        boxes = [s.bounds for s in self.sources]
        return Box(
            min(b.xmin for b in boxes), min(b.ymin for b in boxes), max(b.xmax for b in boxes),
            max(b.ymax for b in boxes),
        )  # fmt: skip


def survey_facts(config: Config, root: Path) -> SurveyFacts:
    """Headers of all files of the survey, and a sample of the one with most points.

    `root` is the run directory: a simulated survey that lies there is taken, otherwise the simulator's numbers.

    Raises
    ------
    InputError
        Files that cannot be used, or whose headers do not say where their points lie.
    """
    directory = directory_of(config, root)
    if config.simulate is not None and isinstance(directory, Path) and not any(directory.glob("strips/*")):
        return simulated_facts(config)
    places = found_files(config.survey.sources, directory, "survey.sources", config.path, config.store)
    opened = opened_all(places, config)
    full = [s for s in opened if s.n_records]
    if not full:
        raise InputError(
            "the source files have no points and no pulses", where=", ".join(str(s.path) for s in opened[:3]),
            do="check the delivery; there is nothing to classify",
        )  # fmt: skip
    with Display() as display:
        crs = common_crs(config, {s.path: s.crs for s in full}, Road(root, Loop(), display))
    reference = 0
    if config.survey.reference.kind == "cloud":
        files = found_files(
            config.survey.reference.files, directory, "survey.reference.files", config.path, config.store
        )
        reference = sum(open_source(local(p)).n_points for p in files)
    largest = max(full, key=lambda s: s.n_points)
    sample = sampled(largest, config.plan.sample_points) if isinstance(largest, LasSource) else None
    return SurveyFacts(tuple(facts_of(s) for s in full), reference, crs, sample)


def facts_of(source: Source) -> SourceFacts:
    """Of an opened file; `InputError` where its header gives no extent."""
    xmin, ymin, _, xmax, ymax, _ = source.bounds
    if not all(map(math.isfinite, (xmin, ymin, xmax, ymax))) or xmin > xmax or ymin > ymax:
        raise InputError(
            "the header does not say where the file's points lie", where=source.path,
            expected="bounds [xmin, ymin, xmax, ymax]", got=f"[{xmin:g}, {ymin:g}, {xmax:g}, {ymax:g}]",
            do="export the file again; `fwclass run` reads all its points to find out, a plan does not",
        )  # fmt: skip
    pulses = source.n_records if isinstance(source, PulseSource) else 0
    waves = source.has_waves and source.waves.kind != "none"
    box = Box(xmin, ymin, xmax + 0.001, ymax + 0.001)
    return SourceFacts(source.path, source.n_points, pulses, waves, source.waves.available if waves else 0, box)


def sampled(source: LasSource, points: int) -> Sample:
    """The middle `points` of a file."""
    first = max(0, (source.n_points - points) // 2)
    with PointReader(source) as reader:
        read = reader.read(first, min(source.n_points, first + points))
    x, y, _ = coordinates(source, read)
    box = facts_of(source).bounds
    even = source.n_points / max(1.0, (box.xmax - box.xmin) * (box.ymax - box.ymin))
    edge = math.sqrt(PER_CELL / even)
    _, held = np.unique(np.c_[np.floor(x / edge), np.floor(y / edge)], axis=0, return_counts=True)
    others = float((held * (held - 1)).sum()) / len(x)  # as points meet it: rims count little, chance nothing
    returns = np.maximum(1, np.asarray(read["number_of_returns"], np.int64))
    return Sample(source.path, len(x), others / edge**2, even, len(x) / float((1.0 / returns).sum()))


def simulated_facts(config: Config) -> SurveyFacts:
    """A survey that is still to be simulated: every strip lies evenly over the whole area."""
    params = config.simulate
    assert isinstance(params, SimulateParams)  # noqa: S101 - who calls has looked
    pulses = params.pulse_density * params.size**2 / params.strips
    points, size = round(pulses * config.plan.returns_per_pulse), params.size
    x, y = params.origin_x, params.origin_y
    box = Box(x, y, x + size, y + size)
    strips = tuple(
        SourceFacts(Path(f"strip_{k + 1:02d}.las"), points, 0, True, round(pulses * config.plan.wave_bytes), box)
        for k in range(params.strips)
    )
    reference = points * params.strips if config.survey.reference.kind == "cloud" else 0
    return SurveyFacts(strips, reference, config.survey.crs or params.crs, None, simulated=True)
