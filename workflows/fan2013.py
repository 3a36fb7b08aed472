"""Fan 2013 as a run: everything that `classification` makes, and a page that sets our figures beside the paper's."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from fwclass.conf import Config
from fwclass.conf.papers import paper
from fwclass.graph.corrections import without_corrections
from fwclass.graph.stage import Plan
from fwclass.graph.stages import check_features
from fwclass.run.runner import Runner, require_all
from fwclass.study.papers import fan
from fwclass.study.papers.begin import require_whole
from fwclass.study.papers.page import write_paper
from fwclass.study.selection import selection
from fwclass.survey.area_of_interest import Area
from fwclass.walk.steps import tasks_of, until_report, until_tiles
from fwclass.walk.workflow import Workflow, after_tiles

from .classification import classification

NAME = "fan2013"


def walk(config: Config, runner: Runner, tiles: frozenset[str] | Area | None = None) -> dict[str, Any]:
    """Run all stages, then the paper's tables on training and test areas; return the run's report.

    `tiles` cannot be chosen: the figures are those of the whole survey.
    """
    require_whole(config, tiles, NAME)
    printed = paper(NAME)
    used = config.features_asked
    computed = (*used, *config.features.also)
    check_features(config, computed, f"{config.path}: survey.features, features.also")
    names = fan.features_of(config)
    plan = without_corrections(until_tiles(Plan(config, used, computed), runner, delivers=True))
    report = until_report(plan, runner, after_tiles(classification.stages))
    if runner.failures:
        return report
    aside = runner.beside()
    every = replace(config, select=config.select.model_copy(update={"patience": len(names)}))
    curves = {
        "paper": selection(config, aside, names, "forward", order=names, computed=computed),
        "best": selection(every, aside, names, "forward", computed=computed),
    }
    variants = fan.variants(config, names, printed)
    receipts = dict(require_all(runner, tasks_of(plan, fan.TABLES.stages)))
    receipts |= require_all(runner, tasks_of(plan, fan.TABLES.times))

    def page() -> dict[str, Any]:
        facts = fan.facts(config, printed, report, curves, variants, receipts)
        return write_paper(config, runner, plan.layout, report, facts)

    return runner.carry_out(page)


fan2013 = Workflow(NAME, "Fan 2013: figures beside the paper's", classification.stages, walk, study=fan.STAGES)
