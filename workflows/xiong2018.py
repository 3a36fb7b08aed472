"""Xiong 2018 as a run: features are selected, what is kept classifies, a page sets our figures beside the paper's."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from fwclass.conf import Config
from fwclass.conf.papers import paper
from fwclass.graph.corrections import without_corrections
from fwclass.graph.stage import Plan
from fwclass.graph.stages import check_features
from fwclass.run.runner import Runner, require_all
from fwclass.study.papers import xiong
from fwclass.study.papers.begin import require_whole
from fwclass.study.papers.page import write_paper
from fwclass.study.select.thinning import measure_rates
from fwclass.study.selection import with_selected
from fwclass.survey.area_of_interest import Area
from fwclass.walk.steps import tasks_of, until_report, until_tiles
from fwclass.walk.workflow import Workflow, after_tiles

from .classification import classification

NAME = "xiong2018"


def walk(config: Config, runner: Runner, tiles: frozenset[str] | Area | None = None) -> dict[str, Any]:
    """Select among the survey's features, run all stages with the best set, then the paper's tables; return the report.

    `tiles` cannot be chosen: the figures are those of the whole survey.
    """
    require_whole(config, tiles, NAME)
    printed, names = paper(NAME), config.features_asked
    check_features(config, names, f"{config.path}: survey.features")
    aside = runner.beside()
    choice, final = with_selected(config, aside)
    chosen = final.features_asked
    plan = without_corrections(until_tiles(Plan(config, names, names), runner, delivers=True))
    best = replace(plan, config=final, names=chosen, tiled=replace(plan.layout, config=final))
    report = until_report(best, runner, after_tiles(classification.stages))
    if runner.failures:
        return report
    variants = xiong.variants(config, names, chosen)
    judged = replace(plan, names=chosen)
    receipts = dict(require_all(runner, tasks_of(judged, xiong.TABLES.stages)))
    thinned = measure_rates(judged, aside)
    receipts |= require_all(runner, tasks_of(judged, xiong.TABLES.times))

    def page() -> dict[str, Any]:
        facts = xiong.facts(config, printed, report, choice, thinned, variants, receipts)
        return write_paper(config, runner, plan.layout, report, facts)

    return runner.carry_out(page)


xiong2018 = Workflow(
    NAME,
    "Xiong 2018: features are chosen, figures beside the paper's",
    classification.stages,
    walk,
    study=xiong.STAGES,
    choose=lambda config, runner: with_selected(config, runner)[1],
)
