"""What a workflow is: a list of stages, and the walk that binds them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from fwclass.columns import declare
from fwclass.conf import Config
from fwclass.errors import ConfigError, nearest
from fwclass.graph.regularize import CLASSIFY_REGULARIZED
from fwclass.graph.simulation import SIMULATE
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stages import LEARNING, STAGES, TO_TILES, check_order, check_reads
from fwclass.run.runner import Runner
from fwclass.survey.area_of_interest import Area
from fwclass.walk.steps import plan_with_features, until_report, until_tiles

Tiles = frozenset[str] | Area | None
"""What a run is restricted to: keys of tiles, an area of interest, or nothing."""

Walk = Callable[[Config, Runner, Tiles], dict[str, Any]]


@dataclass(frozen=True)
class Workflow:
    """A workflow by its name: `what` it is for, in one sentence, its `stages` in order, and the `walk` that binds them.

    Without a `walk` of its own it goes from files to tiles, makes all stages and writes the report. `settle` gives the
    configuration that it runs by; with it classes, labels and training areas need not be in the survey's file.
    `only_judges`: it says how good the survey is and delivers no echoes, for which the sources' returns are enough
    where `survey.echoes` is ``auto``. `study`: what a walk of its own selects, trains and judges besides `stages`.
    `choose`: the configuration with the features that such a walk chooses among those that it is given.
    """

    name: str
    what: str
    stages: tuple[Stage, ...]
    walk: Walk | None = None
    settle: Callable[[Config], Config] | None = None
    only_judges: bool = False
    study: tuple[Stage, ...] = ()
    choose: Callable[[Config, Runner], Config] | None = None

    @property
    def all_stages(self) -> tuple[Stage, ...]:
        """Every stage that a run of it has."""
        return (*self.stages, *self.study)

    @property
    def classifies(self) -> bool:
        """The configuration must say by which classes, and by what they are learned."""
        return self.settle is None

    def __call__(self, config: Config, runner: Runner, tiles: Tiles = None) -> dict[str, Any]:
        """Make all parts and write the report; return it. `tiles`: only these, and what they need."""
        if self.walk is not None:
            return self.walk(config, runner, tiles)
        runner.lean = config.run.keep_intermediate == "lean"
        plan = until_tiles(self.begin(config), runner, self.stages, delivers=True)
        return until_report(plan, runner, after_tiles(self.stages), tiles)

    def begin(self, config: Config) -> Plan:
        """What is planned by before any file of the survey is read, though models are loaded.

        `ConfigError` for features that no stage writes.
        """
        config = config if self.settle is None else self.settle(config)
        classifying = [s for s in self.stages if s.name == CLASSIFY_REGULARIZED.name]
        regularized = any(s is CLASSIFY_REGULARIZED for s in classifying)
        if self.classifies and classifying and not regularized and config.classify.regularize.strength > 0:
            raise ConfigError(
                "this workflow's own classifier knows no neighbours that agree",
                where=f"workflow {self.name}: classify.regularize.strength",
                expected="0",
                got=config.classify.regularize.strength,
                do="--set classify.regularize.strength=0",
            )
        if not regularized:
            lines = config.classify.lines.model_copy(update={"codes": ()})
            config = replace(config, classify=config.classify.model_copy(update={"lines": lines}))
        columns = tuple(c for stage in self.stages for c in stage.declares)
        declare(columns)
        returns = config.survey.echoes == "returns" or (self.only_judges and config.survey.echoes == "auto")
        plan = replace(
            plan_with_features(config, self.stages), declares=columns, returns=returns, only_judges=self.only_judges
        )
        ours = {id(stage) for stage in STAGES}
        more = check_reads(plan, [stage for stage in self.stages if id(stage) not in ours])
        plan = replace(plan, computed=tuple(dict.fromkeys((*plan.computed, *more))))
        check_order(plan, after_tiles(self.stages))
        return plan

    def with_stage(self, stage: Stage, after: str) -> Workflow:
        """This workflow with one stage more, behind the last one of the name `after`."""
        names = [s.name for s in self.stages]
        if after not in names:
            raise ConfigError(
                "no stage of this name", where=f"workflow {self.name}", got=after, do=nearest(after, names)
            )
        place = len(names) - names[::-1].index(after)
        return replace(self, stages=(*self.stages[:place], stage, *self.stages[place:]))

    def with_stage_instead(self, stage: Stage, of: str = "") -> Workflow:
        """This workflow with `stage` in the place of the stages of the name `of` (its own name, unless given)."""
        name = of or stage.name
        places = [k for k, s in enumerate(self.stages) if s.name == name]
        if not places:
            raise ConfigError(
                "no stage of this name",
                where=f"workflow {self.name}",
                got=name,
                do=nearest(name, [s.name for s in self.stages]),
            )
        others = [s for s in self.stages if s.name != name]
        return replace(self, stages=(*others[: places[0]], stage, *others[places[0] :]))

    def without_training(self) -> Workflow:
        """This workflow without the stages that learn: for a classifier that needs no model."""
        learning = {id(stage) for stage in LEARNING}
        return replace(self, stages=tuple(s for s in self.stages if id(s) not in learning))

    def check(self, where: object) -> None:
        """`ConfigError` for a list of stages that no run can go through.

        That is: one that replaces a stage before the tiles, two of one name, two that write one column, one that comes
        before what it reads, one that reads what no stage makes.
        """
        names: set[str] = set()
        every = {s.name for s in self.stages}
        ours = {id(stage) for stage in STAGES}
        early = {stage.name for stage in (SIMULATE, *TO_TILES)}
        written: dict[str, str] = {}
        for stage in self.stages:
            if id(stage) in ours:
                continue
            if stage.name in early:
                raise ConfigError(
                    "a stage before the tiles cannot be replaced: what it finds decides which tiles there are",
                    where=where,
                    got=stage.name,
                    do="add a stage behind `tile` that changes what it gives, and is read in its place",
                )
            if sum(s.name == stage.name for s in self.stages) > 1:
                raise ConfigError(
                    "two stages have one name, and would write the same parts",
                    where=where,
                    got=stage.name,
                    do="give it another, or put it in the other's place (Workflow.with_stage_instead)",
                )
            for column in (c.name for c in stage.declares):
                if column in written:
                    raise ConfigError(
                        "two stages write one column", where=where, got=f"{column}: {written[column]} and {stage.name}"
                    )
                written[column] = stage.name
        for stage in self.stages:
            late = [name for name in stage.after if name in every and name not in names and name != stage.name]
            if late:
                raise ConfigError(
                    "a stage comes before what it reads", where=where, got=f"{stage.name} before {late[0]}"
                )
            settled = self.settle is not None and id(stage) in ours  # such a workflow has no stages of the classifier
            missing = [name for name in stage.after if name not in every and not settled]
            if missing:
                raise ConfigError(
                    "a stage reads what no stage of the workflow makes",
                    where=where,
                    got=f"{stage.name} reads {missing[0]}",
                    do=nearest(missing[0], every),
                )
            names.add(stage.name)


def after_tiles(stages: tuple[Stage, ...]) -> tuple[Stage, ...]:
    """The stages that are planned by the tiles."""
    before = {id(stage) for stage in (SIMULATE, *TO_TILES)}
    return tuple(stage for stage in stages if id(stage) not in before)
