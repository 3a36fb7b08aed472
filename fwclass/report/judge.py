"""Whether a delivered run ends with exit code 4: for what no sound survey shows, or a threshold that is missed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fwclass.assess.remarks import judge_chance
from fwclass.assess.stage import judge
from fwclass.classify.unsure import judge_unsure
from fwclass.conf import Config
from fwclass.quality.judge import judge_check_points, judge_quality
from fwclass.quality.roughness import judge_roughness
from fwclass.quality.steps import judge_steps
from fwclass.quality.strips import judge_strips
from fwclass.report.drift import judge_drift
from fwclass.report.earlier import judge_sources
from fwclass.report.ground import judge_ground, judge_halls, judge_pits
from fwclass.report.labels import judge_labels
from fwclass.report.places import judge_file_places, judge_place
from fwclass.report.plausibility import judge_plausibility
from fwclass.report.radiometry import judge_radiometry
from fwclass.report.repeated import judge_repeated
from fwclass.report.returns import judge_returns


def judge_report(report: Mapping[str, Any], config: Config, replaces: bool) -> None:
    """`QualityError` of the first thing in a run's `report` that is unsound, or misses its threshold.

    `replaces`: the delivery is shown in the place of an earlier one.
    """
    accepted, where, model = config.plausibility.accept, config.path, config.survey.model or config.path
    if report.get("plausibility"):
        judge_plausibility(report["plausibility"]["strips"], config.plausibility)
    if replaces:
        judge_sources(report.get("earlier"), accepted, where)
    judge_place(report.get("place") or report.get("input", {}).get("place"), accepted, where)
    judge_file_places(report.get("input", {}).get("places"), config.plausibility, where)
    if report.get("ground"):
        judge_pits(report["ground"], config.plausibility, where)
        judge_halls(report["ground"], config.plausibility, where)
        judge_ground(report["ground"], config.plausibility, where)
    judge_radiometry((report.get("radiometry") or {}).get("implausible", ()), accepted, where)
    judge_repeated(report.get("repeated"), config.plausibility)
    judge_returns(report.get("returns"), config.plausibility, where)
    judge_labels(report.get("labels"), config.plausibility, where)
    judge_drift(report.get("drift"), config.classify, model)
    judge_unsure(report.get("unsure"), config.classify, model)
    if report.get("quality"):
        judge_strips(report["quality"]["strips"], accepted, where)
        judge_steps(report["quality"]["strips"], config.plausibility.max_height_step, accepted, where)
        if config.survey.model:
            rough = report["quality"]["strips"]["roughness"]
            judge_roughness(rough, config.classify.max_rough, config.classify.accept_drift, model)
        judge_check_points(report["quality"]["check_points"], accepted, where)
        judge_quality(report["quality"], config.quality)
    if report["accuracy"]:
        judge_chance(report["accuracy"], accepted, where)
        judge(report["accuracy"], config.assess)
