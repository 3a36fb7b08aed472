"""Shi 2019 as a run: a coarse and a fine layer, and a page that tells what each of the paper's steps brings."""

from __future__ import annotations

from typing import Any

from fwclass.conf import Config
from fwclass.conf.papers import paper
from fwclass.graph.corrections import without_corrections
from fwclass.graph.stage import Plan
from fwclass.graph.stages import check_features
from fwclass.run.inputs import PartInputs
from fwclass.run.runner import Runner, require_all
from fwclass.study.papers import shi
from fwclass.study.papers.begin import require_whole
from fwclass.study.papers.page import write_paper
from fwclass.study.papers.shi_scenes import scenes
from fwclass.survey.area_of_interest import Area
from fwclass.walk.steps import tasks_of, until_report, until_tiles
from fwclass.walk.workflow import Workflow, after_tiles

from .classification import classification

NAME = "shi2019"


def walk(config: Config, runner: Runner, tiles: frozenset[str] | Area | None = None) -> dict[str, Any]:
    """Run all stages, then the ladder of the paper's steps on the test areas; return the run's report.

    `tiles` cannot be chosen: the figures are those of the whole survey.
    """
    require_whole(config, tiles, NAME)
    shi.require_layers(config)
    printed = paper(NAME)
    used = config.features_asked
    computed = (*used, *config.features.also)
    check_features(config, computed, f"{config.path}: survey.features, features.also")
    check_features(config, config.classify.refine.shares, f"{config.path}: classify.refine.scales")
    names = shi.features_of(config)
    plan = without_corrections(until_tiles(Plan(config, used, computed), runner, delivers=True))
    report = until_report(plan, runner, after_tiles(classification.stages))
    if runner.failures:
        return report
    variants = shi.variants(config, names)
    receipts = dict(require_all(runner, tasks_of(plan, (*shi.TABLES.stages, shi.COUNT_LAYERS, shi.RANK_FEATURES))))
    receipts |= require_all(runner, tasks_of(plan, shi.TABLES.times))

    def page() -> dict[str, Any]:
        facts = shi.facts(config, printed, report, variants, plan.layout, receipts)
        inputs = PartInputs(runner.store)
        return write_paper(config, runner, plan.layout, report, facts, scenes=scenes(plan.layout, receipts, inputs))

    return runner.carry_out(page)


shi2019 = Workflow(
    NAME, "Shi 2019: two layers, figures beside the paper's", classification.stages, walk, study=shi.STAGES
)
