"""Amounts times costs: seconds, bytes and memory of every stage, and which size of tile takes least of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from fwclass.conf import Config
from fwclass.conf.planning import StageCost
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stages import STAGES
from fwclass.grid import TileGrid
from fwclass.operate.estimate.amounts import Amount, amounts
from fwclass.operate.estimate.headers import SurveyFacts
from fwclass.operate.estimate.spread import MOST_SQUARES, held_squares
from fwclass.units import MIB

NEAR = 0.1
"""A gain of less than this share is none: a size that is set stays."""

Costs = Mapping[str, StageCost]


@dataclass(frozen=True)
class StageEstimate:
    """What a stage will take.

    Attributes
    ----------
    seconds : processor time of all its parts.
    longest : of its longest part [s].
    bytes : that it writes.
    memory_mib : of a worker while the largest part runs.
    """

    name: str
    unit: str
    amount: Amount
    seconds: float
    longest: float
    bytes: float
    memory_mib: float


@dataclass(frozen=True)
class Estimate:
    """A whole run with tiles of `size` [m] on `workers` workers; `compile_seconds` of every worker come once."""

    size: float
    workers: int
    stages: tuple[StageEstimate, ...]
    compile_seconds: float
    unknown: tuple[str, ...]

    @property
    def seconds(self) -> float:
        """Processor time."""
        return sum(s.seconds for s in self.stages)

    @property
    def wall(self) -> float:
        """Time on a clock [s], stage after stage: no stage ends before its longest part."""
        return sum(max(s.seconds / self.workers, s.longest) for s in self.stages)

    @property
    def bytes(self) -> float:
        """Bytes of all parts together."""
        return sum(s.bytes for s in self.stages)

    @property
    def largest(self) -> StageEstimate:
        """The stage that needs most memory."""
        return max(self.stages, key=lambda s: s.memory_mib)

    @property
    def tiles(self) -> int:
        """Number of tiles."""
        return next(s.amount.parts for s in self.stages if s.name == "tile")


def estimate_run(
    plan: Plan, facts: SurveyFacts, size: float, workers: int, costs: Costs, stages: Sequence[Stage] = STAGES
) -> Estimate:
    """The run of `stages` with tiles of `size` [m]; those that `costs` does not know are told in `unknown`."""
    waves = float(sum(s.wave_bytes for s in facts.sources))
    works, unknown, units = [], [], {stage.name: stage.unit for stage in stages}
    for name, amount in amounts(plan, facts, size, stages).items():
        if name in costs:
            works.append(_stage(name, units[name], amount, costs[name], waves, plan.config.plan.base_mib))
        else:
            unknown.append(name)
    return Estimate(size, max(1, workers), tuple(works), plan.config.plan.compile_seconds, tuple(unknown))


def _stage(name: str, unit: str, amount: Amount, cost: StageCost, waves: float, base_mib: float) -> StageEstimate:
    return StageEstimate(
        name,
        unit,
        amount,
        seconds=amount.parts * cost.part * 1e-3 + amount.units * cost.each * 1e-6,
        longest=cost.part * 1e-3 + amount.longest * cost.each * 1e-6,
        bytes=amount.written * cost.stored + waves * cost.waves,
        memory_mib=base_mib + amount.held * cost.held / MIB,
    )


@dataclass(frozen=True)
class Choice:
    """A size of tiles that was looked at; `fits` if every part has the memory of a worker and no worker is idle."""

    size: float
    tiles: int
    wall: float
    memory_mib: float
    enough: bool
    fits: bool


def choices(
    plan: Plan, facts: SurveyFacts, workers: int, costs: Costs, allowed_mib: float, stages: Sequence[Stage] = STAGES
) -> list[Choice]:
    """All sizes of ``plan.sizes`` and the one that is set; sizes with too many tiles for this extent are left out."""
    config, boxes, choices_by_size = plan.config, [box for s in facts.sources for box, _ in s.where], []
    for size in sorted({*config.plan.sizes, config.tile.size}):
        if math.prod(map(len, held_squares(boxes, size))) > MOST_SQUARES / 2:
            continue
        TileGrid(size)
        estimate = estimate_run(plan, facts, size, workers, costs, stages)
        memory, enough = estimate.largest.memory_mib, estimate.tiles >= config.plan.tiles_per_worker * max(1, workers)
        choices_by_size.append(Choice(size, estimate.tiles, estimate.wall, memory, enough, memory <= allowed_mib))
    return choices_by_size


def propose_size(config: Config, choices: list[Choice]) -> Choice | None:
    """The size that is fastest of those that fit and leave no worker idle; the one that is set where it is as good.

    None where no size fits: memory is short somewhere else.
    """
    good = [c for c in choices if c.fits and c.enough] or [c for c in choices if c.fits]
    if not good:
        return None
    best = min(good, key=lambda c: (c.wall, c.size))
    own = next((c for c in good if c.size == config.tile.size), None)
    return own if own is not None and own.wall <= best.wall * (1 + NEAR) else best
