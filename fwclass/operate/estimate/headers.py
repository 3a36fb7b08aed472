"""What the sources' headers say of a survey, and one part of one file that is really read."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fwclass.conf import Config
from fwclass.errors import InputError
from fwclass.graph.stage import Plan
from fwclass.grid import Box, Tile, TileGrid, groups, joint_box
from fwclass.read.las import LasSource
from fwclass.read.points import PointReader, coordinates
from fwclass.read.projection import box_brought, project_places
from fwclass.read.source import BeamSource, PulseSource, Source, open_source
from fwclass.run.local import Loop
from fwclass.run.progress import Display
from fwclass.run.runner import Runner
from fwclass.simulate.params import SimulateParams
from fwclass.store.remote_file import local
from fwclass.survey.bounds import CLOUD_ROWS
from fwclass.survey.files import find_files
from fwclass.survey.gather import directory_of, open_survey
from fwclass.survey.systems import common_crs

SPARSE = 0.01
"""Points/m2 over its header's bounds below which a file is read to see where its points lie: the sparsest surveys have
0.1."""

PLACE = 1000.0
"""Squares [m] that points lie in the same place in, where they touch."""

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
    places : (bounds [m], records) of each of the places far apart that its points lie in; empty where they were not
        looked for.
    point_format : of LAS; -1 in formats that hold pulses only.
    """

    path: Path
    points: int
    pulses: int
    waves: bool
    wave_bytes: int
    bounds: Box
    places: tuple[tuple[Box, float], ...] = ()
    point_format: int = -1

    @property
    def records(self) -> int:
        """Points, or pulses of a file that has no points."""
        return self.points or self.pulses

    @property
    def where(self) -> tuple[tuple[Box, float], ...]:
        """Bounds and records of its places, or of the file."""
        return self.places or ((self.bounds, float(self.records)),)


@dataclass(frozen=True)
class PointSample:
    """One part of one file, read.

    Attributes
    ----------
    points : of it.
    density : mean over its points of how dense others lie around them [1/m²].
    even : what the header alone gives, points over bounds, or over those of its places [1/m²].
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
    """All that a plan knows of a survey. `reference`: points of every file of a reference cloud; `simulated`: no file
    is there yet; `crs` is WKT or None."""

    sources: tuple[SourceFacts, ...]
    reference: tuple[int, ...]
    crs: str | None
    sample: PointSample | None
    simulated: bool = False

    @property
    def reference_points(self) -> int:
        """Of all its files."""
        return sum(self.reference)

    @property
    def box(self) -> Box:
        """What holds all files."""
        boxes = [s.bounds for s in self.sources]
        return Box(
            min(b.xmin for b in boxes),
            min(b.ymin for b in boxes),
            max(b.xmax for b in boxes),
            max(b.ymax for b in boxes),
        )


def survey_facts(config: Config, root: Path, copied: bool = False) -> SurveyFacts:
    """Headers of all files of the survey, and a sample of the one with most points.

    `root` is the run directory: a simulated survey that lies there is taken, otherwise the simulator's numbers.
    `copied`: strips will be delivered.

    `InputError`: files that cannot be used, or whose headers do not say where their points lie.
    """
    directory = directory_of(config, root)
    if config.simulate is not None and isinstance(directory, Path) and not any(directory.glob("strips/*")):
        return simulated_facts(config)
    _, _, full, _ = open_survey(config, directory, copied)
    with Display() as display:
        crs = common_crs(config, full, Runner(root, Loop(), display))
    reference: tuple[int, ...] = ()
    if config.survey.reference.kind == "cloud":
        files = find_files(
            config.survey.reference.files, directory, "survey.reference.files", config.path, config.store
        )
        reference = tuple(open_source(local(p)).n_points for p in files)
    sources = tuple(_with_places(facts_of(s), s) for s in full)
    largest, of_it = max(zip(full, sources, strict=True), key=lambda pair: pair[0].n_points)
    sample = sample_points(largest, config.plan.sample_points, of_it) if isinstance(largest, LasSource) else None
    return SurveyFacts(sources, reference, crs, sample)


def facts_of(source: Source) -> SourceFacts:
    """Of an opened file; `InputError` where its header gives no extent."""
    xmin, ymin, _, xmax, ymax, _ = bounds = source.bounds
    if not all(map(math.isfinite, (xmin, ymin, xmax, ymax))) or xmin > xmax or ymin > ymax:
        raise InputError(
            "the header does not say where the file's points lie",
            where=source.path,
            expected="bounds [xmin, ymin, xmax, ymax]",
            got=f"[{xmin:g}, {ymin:g}, {xmax:g}, {ymax:g}]",
            do="export the file again; `fwclass run` reads all its points to find out, a plan does not",
        )
    pulses = source.n_records if isinstance(source, PulseSource | BeamSource) else 0
    waves = source.has_waves and source.waves.kind != "none"
    rim = [max(0.001, scale / 2) for scale in source.scales[:2]]  # points of [x - scale / 2, x + scale / 2) lie at x
    xmin, ymin, _, xmax, ymax, _ = box_brought(source, bounds)
    box = Box(xmin, ymin, xmax + rim[0], ymax + rim[1])
    size = source.waves.available if waves else 0
    return SourceFacts(source.path, source.n_points, pulses, waves, size, box, point_format=source.point_format)


def with_returns(plan: Plan, facts: SurveyFacts) -> tuple[Plan, SurveyFacts]:
    """`plan` and `facts` as they are where the waveforms of files that all have returns too are left aside."""
    if not plan.returns or any(s.waves and not s.points for s in facts.sources):
        return replace(plan, returns=False), facts
    return plan, replace(facts, sources=tuple(replace(s, waves=False) for s in facts.sources))


def _with_places(facts: SourceFacts, source: Source) -> SourceFacts:
    """`facts` with the places that the file's points lie in, where its bounds are far too wide for so many."""
    if not isinstance(source, LasSource) or facts.bounds.area * SPARSE <= max(facts.points, SPARSE * PLACE**2):
        return facts
    grid = TileGrid(PLACE)
    occupied: dict[Tile, tuple[Box, int]] = {}
    with PointReader(source) as reader:
        for first in range(0, source.n_points, CLOUD_ROWS):
            points = reader.read(first, min(source.n_points, first + CLOUD_ROWS))
            x, y, _ = project_places(source, coordinates(source, points))
            tiles, inverse = np.unique(np.stack(grid.indices(x, y), axis=1), axis=0, return_inverse=True)
            order = np.argsort(inverse.reshape(-1), kind="stable")
            starts = np.flatnonzero(np.r_[True, np.diff(inverse.reshape(-1)[order]) > 0])
            low, high_ = ([f.reduceat(v[order], starts).tolist() for v in (x, y)] for f in (np.minimum, np.maximum))
            counts = np.diff(np.r_[starts, len(x)]).tolist()
            for (cx, cy), x0, y0, x1, y1, n in zip(tiles.tolist(), *low, *high_, counts, strict=True):
                tile, box = Tile(cx, cy, PLACE), Box(x0, y0, x1 + 0.001, y1 + 0.001)
                before, number = occupied.get(tile, (box, 0))
                occupied[tile] = (joint_box((before, box)), number + n)
    places = (([occupied[t][0] for t in part], sum(occupied[t][1] for t in part)) for part in groups(occupied))
    return replace(facts, places=tuple((joint_box(boxes), float(n)) for boxes, n in places))


def sample_points(source: LasSource, points: int, facts: SourceFacts | None = None) -> PointSample:
    """The middle `points` of a file."""
    first = max(0, (source.n_points - points) // 2)
    with PointReader(source) as reader:
        read = reader.read(first, min(source.n_points, first + points))
    x, y, _ = project_places(source, coordinates(source, read))
    even = source.n_points / max(1.0, sum(b.area for b, _ in (facts or facts_of(source)).where))
    edge = math.sqrt(PER_CELL / even)
    _, counts = np.unique(np.c_[np.floor(x / edge), np.floor(y / edge)], axis=0, return_counts=True)
    others = float((counts * (counts - 1)).sum()) / len(x)  # as points meet it: rims count little, chance nothing
    returns = np.maximum(1, np.asarray(read["number_of_returns"], np.int64))
    return PointSample(source.path, len(x), others / edge**2, even, len(x) / float((1.0 / returns).sum()))


def simulated_facts(config: Config) -> SurveyFacts:
    """A survey that is still to be simulated: every strip lies evenly over the whole area."""
    params = config.simulate
    assert isinstance(params, SimulateParams)  # noqa: S101 - who calls has looked
    pulses = params.pulse_density * params.size**2 / params.strips
    points, size = round(pulses * config.plan.returns_per_pulse), params.size
    x, y = params.origin_x, params.origin_y
    box = Box(x, y, x + size, y + size)
    size_of_waves, formats = round(pulses * config.plan.wave_bytes), [r.point_format for r in params.recordings]
    strips = tuple(
        SourceFacts(Path(f"strip_{k + 1:02d}.las"), points, 0, True, size_of_waves, box, (), formats[k % len(formats)])
        for k in range(params.strips)
    )
    reference = (points,) * params.strips if config.survey.reference.kind == "cloud" else ()
    return SurveyFacts(strips, reference, config.survey.crs or params.crs, None, simulated=True)
