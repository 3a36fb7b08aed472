"""What every stage of a run will have to do: its parts, their units, and the largest of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.conf import Config
from fwclass.graph.areas import training_tiles
from fwclass.graph.corrections import READ_CORRECTIONS
from fwclass.graph.ground_seams import CHECK_SEAMS
from fwclass.graph.learn import TREES_PER_PART
from fwclass.graph.overview import DRAW_OVERVIEW
from fwclass.graph.radiometry import READ_TRAJECTORY
from fwclass.graph.simulation import SIMULATE
from fwclass.graph.sites import in_sites
from fwclass.graph.sources import INDEX
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stages import STAGES
from fwclass.graph.training_rows import sample_rows
from fwclass.grid import Box, TileGrid, groups, joint_box
from fwclass.operate.estimate.headers import SurveyFacts
from fwclass.operate.estimate.spread import Piece, Spread, spread_of
from fwclass.publish.cog import STRIPE
from fwclass.survey.bounds import CLOUD_ROWS
from fwclass.units import MIB


@dataclass(frozen=True)
class Amount:
    """The work of a stage.

    Attributes
    ----------
    parts : how many.
    units : of all parts, in the unit of the stage's cost.
    longest : units of the largest part.
    held : units that the part with most in memory reads, its halo's too.
    own : units without the halos, for which it writes; None where none has a halo.
    """

    parts: int
    units: float
    longest: float
    held: float
    own: float | None = None

    @property
    def written(self) -> float:
        """Units that its parts write for."""
        return self.units if self.own is None else self.own

    def joined(self, other: Amount | None) -> Amount:
        """Of both together, whose stages have one name."""
        if other is None:
            return self
        return Amount(
            self.parts + other.parts,
            self.units + other.units,
            max(self.longest, other.longest),
            max(self.held, other.held),
            self.written + other.written,
        )


@dataclass(frozen=True)
class SurveyCounts:
    """Points, pulses and echoes of every file, (files,) each; `waves` where a file has waveforms."""

    points: NDArray[np.float64]
    pulses: NDArray[np.float64]
    echoes: NDArray[np.float64]
    waves: NDArray[np.bool_]

    @classmethod
    def of(cls, config: Config, facts: SurveyFacts) -> SurveyCounts:
        """Returns become pulses and echoes as the sample, or `plan`, has them; without waveforms each is a pulse."""
        sample, plan = facts.sample, config.plan
        each = sample.returns_per_pulse if sample else plan.returns_per_pulse
        points = np.array([s.points or s.pulses * each for s in facts.sources], float)
        waves = np.array([s.waves for s in facts.sources])
        pulses = np.array([s.pulses or (s.points / each if s.waves else s.points) for s in facts.sources], float)
        return cls(points, pulses, np.where(waves, points * plan.echoes_per_return, points), waves)

    def pieces(self, facts: SurveyFacts) -> tuple[Piece, ...]:
        """Bounds and echoes of every file, or of every place that one of them lies in."""
        return tuple(
            (box, float(n) * part / s.records)
            for s, n in zip(facts.sources, self.echoes, strict=True)
            for box, part in s.where
        )


def tile_halo(plan: Plan, stages: Sequence[Stage] = STAGES) -> float:
    """The furthest that any of `stages` reads around a tile [m]."""
    return max(s.reach(plan) for s in stages if s.over == "tile" and s.when(plan))


def crowding(config: Config, facts: SurveyFacts) -> float:
    """Echoes of the fullest tile over what evenly spread files give it."""
    return config.plan.crowding * (facts.sample.crowding if facts.sample else 1.0)


def amounts(plan: Plan, facts: SurveyFacts, size: float, stages: Sequence[Stage] = STAGES) -> dict[str, Amount]:
    """The work of each of `stages` with tiles of `size` [m], in the order of the run. `plan`: as a workflow begins."""
    quantities = _Quantities.of(plan.config, facts, size)
    by_stage: dict[str, Amount] = {}
    for stage in stages:
        amount = quantities.amount(stage, plan) if stage.when(plan) else None
        if amount is not None and amount.parts:
            by_stage[stage.name] = amount.joined(by_stage.get(stage.name))
    return by_stage


@dataclass(frozen=True)
class _Quantities:
    """What the amounts of all stages follow from: the files, and how their echoes are spread over tiles of a size."""

    config: Config
    facts: SurveyFacts
    counts: SurveyCounts
    tiles: Spread
    crowd: float

    @classmethod
    def of(cls, config: Config, facts: SurveyFacts, size: float) -> _Quantities:
        counts = SurveyCounts.of(config, facts)
        return cls(config, facts, counts, spread_of(counts.pieces(facts), size), crowding(config, facts))

    def amount(self, stage: Stage, plan: Plan) -> Amount | None:
        """By what a part of the stage is and what its cost is counted in; None where it has no part."""
        if stage is SIMULATE:
            pulses = self.counts.pulses
            return Amount(len(pulses), float(pulses.sum()), float(pulses.max()), 0.0) if self.facts.simulated else None
        by_kind = {
            "file": self._of_files,
            "strip": self._of_strips,
            "chunk": self._of_chunks,
            "tile": self._of_tiles,
            "block": self._of_blocks,
            "survey": self._of_survey,
        }
        return by_kind[stage.over](stage, plan)

    def _of_files(self, stage: Stage, plan: Plan) -> Amount | None:
        if stage.unit == "reference":
            files, points = self.facts.reference, self.facts.reference_points
            most = min(max(files, default=0), CLOUD_ROWS)
            return Amount(sum(math.ceil(n / CLOUD_ROWS) for n in files), points, most, most) if points else None
        survey = self.config.survey
        if stage is READ_CORRECTIONS:  # the run directory may have some, and they take next to nothing
            return Amount(1, 1.0, 1.0, 1.0) if survey.reference.corrections else None
        number = len(survey.trajectory.files if stage.name == READ_TRAJECTORY.name else survey.reference.files)
        return Amount(number, float(number), 1.0, 1.0)

    def _of_strips(self, stage: Stage, plan: Plan) -> Amount | None:
        counts = self.counts
        own = counts.points if stage.unit == "point" else counts.pulses
        held = float(np.where(counts.waves, own, 0.0).max()) if stage is INDEX else float(own.max())
        if stage.waves:
            own = own[counts.waves]
            held = self._chunk()
        return Amount(len(own), float(own.sum()), float(own.max()), held) if len(own) else None

    def _chunk(self) -> float:
        return float(min(self.counts.pulses.max(), self.config.read.chunk_pulses * 1.0))

    def _of_chunks(self, stage: Stage, plan: Plan) -> Amount | None:
        counts, chunk = self.counts, self._chunk()
        chosen = np.ones(len(counts.pulses), bool) if stage.waves is None else counts.waves == stage.waves
        pulses = counts.pulses[chosen]
        number = int((pulses // self.config.read.chunk_pulses + 1).sum())
        return Amount(number, float(pulses.sum()), min(chunk, float(pulses.max())), chunk) if len(pulses) else None

    def _of_tiles(self, stage: Stage, plan: Plan) -> Amount | None:
        tiles, crowd = self.tiles, self.crowd
        if stage.unit == "reference":
            points = self.facts.reference_points
            fullest = float(tiles.counts.max()) * points / float(tiles.counts.sum()) * crowd
            return Amount(tiles.number, points, fullest, fullest) if points else None
        reads = stage.reads(plan) if callable(stage.reads) else stage.reads
        echoes = tiles.grown(stage.reach(plan)) if reads else tiles.counts
        chosen = tiles.occupied
        if stage.parts is training_tiles:
            chosen = chosen & tiles.touching(self.config.areas.boxes("train"))
        fullest = float(echoes.max()) * crowd
        own = float(tiles.counts[chosen].sum())
        return Amount(int(chosen.sum()), float(echoes[chosen].sum()), fullest, fullest, own)

    def _of_blocks(self, stage: Stage, plan: Plan) -> Amount | None:
        if stage.edge is None:
            return None
        edge = stage.edge(plan)
        if stage.unit == "cell":
            cell = self._cell()
            boxes = raster_boxes(self.config, self.facts, self.counts)
            cells = sum(b.area / cell**2 for b in boxes)
            blocks = sum(math.ceil(b.area / edge**2) for b in boxes)
            return Amount(blocks, cells, min(cells, (edge / cell) ** 2), 0.0)
        spread = spread_of(self.counts.pieces(self.facts), edge)
        total = float(self.counts.echoes.sum())
        if stage is DRAW_OVERVIEW and (total <= self.config.publish.overview_echoes or spread.within(0) == 1):
            return None
        longest = float(spread.counts.max()) * self.crowd
        held = float(spread.grown(stage.reach(plan)).max()) * self.crowd
        return Amount(spread.within(stage.margin), float(spread.counts.sum()), longest, held)

    def _cell(self) -> float:
        return min(self.config.terrain.cell, self.config.publish.class_cell)

    def _of_survey(self, stage: Stage, plan: Plan) -> Amount | None:
        config, total = self.config, float(self.counts.echoes.sum())
        if stage is CHECK_SEAMS:
            spread = spread_of(self.counts.pieces(self.facts), config.ground.block)
            echoes = min(total, float(config.run.seam_check_echoes) + float(spread.counts.max()))
            return Amount(
                1,
                echoes,
                echoes,
                float(spread.grown(max(config.ground.halo, config.terrain.block_halo)).max()) * self.crowd,
            )
        if stage.unit == "cell":
            cell, boxes = self._cell(), raster_boxes(config, self.facts, self.counts)
            sizes = [b.area / cell**2 for b in boxes]
            held = max(_held_for_rasters(config, b.xmax - b.xmin, n, cell) for b, n in zip(boxes, sizes, strict=True))
            return Amount(len(boxes), sum(sizes), max(sizes), held)
        if stage.unit == "echo":
            return Amount(1, total, total, total if stage.reads else 0.0)
        parts = len(stage.all_parts(plan)) if stage.number is None else stage.number(plan)
        if stage.unit == "part":
            return Amount(parts, float(parts), 1.0, 1.0)
        rows = float(sample_rows(config))
        if stage.load is not None:
            each = stage.load(plan)
            return Amount(parts, parts * each, each, each if stage.unit == "row" else rows * TREES_PER_PART)
        if stage.unit == "row":
            return Amount(parts, rows, rows, rows)
        units = rows * config.train.trees
        each = rows * min(config.train.trees, TREES_PER_PART) if parts > 1 else units
        return Amount(parts, units, each, each if parts > 1 else 0.0)


def raster_boxes(config: Config, facts: SurveyFacts, counts: SurveyCounts) -> list[Box]:
    """Where rasters are made: the survey's box, or those of its places where most of it is empty (`graph.sites`)."""
    cell, edge = min(config.terrain.cell, config.publish.class_cell), config.terrain.block
    blocks = spread_of(counts.pieces(facts), edge)
    if not in_sites(facts.box, cell, blocks.number * (edge / cell) ** 2, config.publish.cog_block):
        return [facts.box]
    tile_groups = groups(dict.fromkeys(t for b in blocks.squares() for t in TileGrid(edge).touching(b.box.grown(edge))))
    boxes = []
    for part in tile_groups:
        around = joint_box(t.box for t in part)
        boxes.append([shared for box, _ in counts.pieces(facts) if (shared := box.common(around)) is not None])
    return [joint_box(some) for some in boxes if some] or [facts.box]


def _held_for_rasters(config: Config, width: float, cells: float, cell: float) -> float:
    """Cells in memory: a stripe's, a quarter as much for those of a row of blocks, and what GDAL keeps of all."""
    cache = min(cells, config.publish.raster_cache * MIB / config.plan.stages["publish-rasters"].held)
    return width / cell * (STRIPE + config.terrain.block / cell / 4) + cache
