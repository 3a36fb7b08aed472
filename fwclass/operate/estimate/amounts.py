"""What every stage of a run will have to do: its parts, their units, and the largest of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fwclass.conf import Config
from fwclass.features.params import Asked, is_feature
from fwclass.graph.forest import TREES_PER_PART
from fwclass.graph.layout import has_range
from fwclass.graph.sites import in_sites
from fwclass.graph.thin import thins
from fwclass.graph.work.sources import CLOUD_ROWS
from fwclass.grid import Box, TileGrid, groups, joint_box
from fwclass.ground.stage import GROUND_FILTER, TERRAIN
from fwclass.label.stage import LABEL
from fwclass.operate.estimate.headers import SurveyFacts
from fwclass.operate.estimate.spread import Piece, Spread, spread_of
from fwclass.publish.cog import STRIPE
from fwclass.radiometry.stage import OVERLAP
from fwclass.store.models import load_model
from fwclass.thin.sample import THIN

MIB = 1 << 20


@dataclass(frozen=True)
class Amount:
    """The work of a stage.

    Attributes
    ----------
    parts : how many.
    units : of all parts, in the unit of the stage's cost.
    longest : units of the largest part.
    held : units that the part with most in memory reads, its halo's too.
    """

    parts: int
    units: float
    longest: float
    held: float


@dataclass(frozen=True)
class Counts:
    """Points, pulses and echoes of every file, (files,) each; `waves` where a file has waveforms."""

    points: NDArray[np.float64]
    pulses: NDArray[np.float64]
    echoes: NDArray[np.float64]
    waves: NDArray[np.bool_]

    @classmethod
    def of(cls, config: Config, facts: SurveyFacts) -> Counts:
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


def features_of(config: Config) -> tuple[str, ...]:
    """Features of a neighbourhood that the run computes, those that are described besides too."""
    model = config.survey.model
    if model is None:
        names = config.features_asked
    else:
        path = Path(model)
        names = load_model(path if path.is_absolute() else (config.path.parent / path).resolve()).features
    return tuple(n for n in dict.fromkeys((*names, *config.features.also)) if is_feature(n))


def tile_halo(config: Config) -> float:
    """The furthest that any stage reads around a tile [m]."""
    halos = [Asked.of(features_of(config)).halo(config.features)]
    if config.survey.reference.kind != "none":
        halos.append(LABEL.halo(config.label))
    if has_range(config) and (config.radiometry.balance or config.radiometry.target is not None):
        halos.append(OVERLAP.halo(config.radiometry))
    if thins(config):
        halos += [THIN.halo(config.thin), config.thin.reach]
    return max(halos)


def crowding(config: Config, facts: SurveyFacts) -> float:
    """Echoes of the fullest tile over what evenly spread files give it."""
    return config.plan.crowding * (facts.sample.crowding if facts.sample else 1.0)


def amounts(config: Config, facts: SurveyFacts, size: float) -> dict[str, Amount]:
    """The work of every stage with tiles of `size` [m], in the order of the run."""
    counts = Counts.of(config, facts)
    tiles = spread_of(counts.pieces(facts), size)
    return {
        **_of_files(config, facts, counts),
        **_of_reference(facts, tiles, crowding(config, facts)),
        **_of_tiles(config, facts, tiles),
        **_of_blocks(config, facts, counts),
        **_of_training(config),
        **_of_delivery(config, facts, counts),
    }


def _of_files(config: Config, facts: SurveyFacts, counts: Counts) -> dict[str, Amount]:
    wanted = config.read.chunk_pulses
    pulses, points = counts.pulses, counts.points
    number = pulses // wanted + 1
    chunk = float(min(pulses.max(), wanted * 1.0))
    chunks = Amount(int(number.sum()), float(pulses.sum()), chunk, chunk)
    files, waving = len(pulses), int(counts.waves.sum())
    indexed = float(np.where(counts.waves, points, 0.0).max())
    waves = np.where(counts.waves, pulses, 0.0)
    made = {
        "index": Amount(files, float(points.sum()), float(points.max()), indexed),
        "read": Amount(int(number[counts.waves].sum()), float(waves.sum()), min(chunk, float(waves.max())), chunk),
        "pulse": Amount(waving, float(waves.sum()), float(waves.max()), chunk),
        "decompose": chunks,
        "split": chunks,
    }
    if facts.simulated:
        made = {"simulate": Amount(files, float(pulses.sum()), float(pulses.max()), 0.0), **made}
    return made


def _of_reference(facts: SurveyFacts, tiles: Spread, crowd: float) -> dict[str, Amount]:
    points = facts.reference_points
    if not points:
        return {}
    share = points / float(tiles.counts.sum())
    most, fullest = min(points, CLOUD_ROWS), float(tiles.counts.max()) * share * crowd
    return {
        "reference-split": Amount(math.ceil(points / CLOUD_ROWS), points, most, most),
        "reference": Amount(tiles.number, points, fullest, fullest),
    }


def _of_tiles(config: Config, facts: SurveyFacts, tiles: Spread) -> dict[str, Amount]:
    crowd, total = crowding(config, facts), float(tiles.counts.sum())
    fullest = float(tiles.counts.max()) * crowd
    plain = Amount(tiles.number, total, fullest, fullest)
    around = tiles.grown(Asked.of(features_of(config)).halo(config.features))
    seen = float(around.max()) * crowd
    labelled = config.survey.reference.kind != "none"
    made = dict.fromkeys(("tile", "ground", "height"), plain)
    made["features"] = Amount(tiles.number, float(around[tiles.occupied].sum()), seen, seen)
    if has_range(config):
        made["radiometry"] = plain
    if labelled:
        made["label"] = plain
    if labelled and config.survey.model is None:
        made["census"] = plain
    made["classify"] = plain
    if labelled:
        made["confusion"] = plain
        made["assess"] = Amount(1, total, total, 0.0)
    made["publish-tile"] = plain
    return made


def _of_blocks(config: Config, facts: SurveyFacts, counts: Counts) -> dict[str, Amount]:
    crowd, pieces, made = crowding(config, facts), counts.pieces(facts), {}
    for name, block, halo, margin in (
        ("ground-filter", config.ground.block, GROUND_FILTER.halo(config.ground), 0),
        ("terrain", config.terrain.block, TERRAIN.halo(config.terrain), 1),
    ):
        blocks = spread_of(pieces, block)
        longest, held = float(blocks.counts.max()) * crowd, float(blocks.grown(halo).max()) * crowd
        made[name] = Amount(blocks.within(margin), float(blocks.counts.sum()), longest, held)
    total = float(counts.echoes.sum())
    if total <= config.run.seam_check_echoes:
        made["seams"] = Amount(1, total, total, total)
    return made


def _of_training(config: Config) -> dict[str, Amount]:
    if config.survey.model is not None or config.train.method != "forest":
        return {}
    rows = float(config.train.samples_per_class * len(config.survey.classes))
    trees = config.train.trees
    parts, each = math.ceil(trees / TREES_PER_PART), rows * min(trees, TREES_PER_PART)
    return {"trees": Amount(parts, rows * trees, each, each), "train": Amount(1, rows * trees, rows * trees, 0.0)}


def _of_delivery(config: Config, facts: SurveyFacts, counts: Counts) -> dict[str, Amount]:
    cell, edge = min(config.terrain.cell, config.publish.class_cell), config.terrain.block
    boxes = raster_boxes(config, facts, counts)
    sizes = [b.area / cell**2 for b in boxes]
    cells, most = sum(sizes), max(sizes)
    held = max(_held_for_rasters(config, b.xmax - b.xmin, n, cell) for b, n in zip(boxes, sizes, strict=True))
    blocks = sum(math.ceil(b.area / edge**2) for b in boxes)
    largest = float(counts.points.max())
    return {
        "publish-strip": Amount(len(counts.points), float(counts.points.sum()), largest, largest),
        "class-block": Amount(blocks, cells, min(cells, (edge / cell) ** 2), 0.0),
        "publish-rasters": Amount(len(boxes), cells, most, held),
    }


def raster_boxes(config: Config, facts: SurveyFacts, counts: Counts) -> list[Box]:
    """Where rasters are made: the survey's box, or those of its places where most of it is empty (`plan.sites`)."""
    cell, edge = min(config.terrain.cell, config.publish.class_cell), config.terrain.block
    blocks = spread_of(counts.pieces(facts), edge)
    if not in_sites(facts.box.area / cell**2, blocks.number * (edge / cell) ** 2):
        return [facts.box]
    found = groups(dict.fromkeys(t for b in blocks.squares() for t in TileGrid(edge).touching(b.box.grown(edge))))
    boxes = []
    for part in found:
        around = joint_box(t.box for t in part)
        boxes.append([shared for box, _ in counts.pieces(facts) if (shared := box.common(around)) is not None])
    return [joint_box(some) for some in boxes if some] or [facts.box]


def _held_for_rasters(config: Config, width: float, cells: float, cell: float) -> float:
    """Cells in memory: a stripe's, a quarter as much for those of a row of blocks, and what GDAL keeps of all."""
    cache = min(cells, config.publish.raster_cache * MIB / config.plan.stages["publish-rasters"].held)
    return width / cell * (STRIPE + config.terrain.block / cell / 4) + cache
