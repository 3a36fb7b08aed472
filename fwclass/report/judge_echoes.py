"""Whether a command on one file ends with exit code 4, for what no sound echoes show."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fwclass.decompose.params import PlausibilityParams
from fwclass.quality.steps import judge_steps
from fwclass.quality.strips import judge_strips
from fwclass.report.ground import judge_halls, judge_pits, judge_sunken
from fwclass.report.labels import judge_labels
from fwclass.report.places import judge_place
from fwclass.report.plausibility import judge_plausibility
from fwclass.report.radiometry import judge_radiometry
from fwclass.report.repeated import judge_repeated
from fwclass.report.returns import judge_returns


def judge_echoes(judged: Mapping[str, Any], bounds: PlausibilityParams, where: object) -> None:
    """`QualityError` of the first thing in what a command tells of one file's echoes that is unsound: their
    ``plausibility``, ``place``, ``repeated``, ``returns``, ``ground`` (`sunken_remarks`), ``pits``, ``halls``,
    ``radiometry``, ``strips``, ``labels``, each where it is known."""
    if judged.get("plausibility"):
        judge_plausibility([judged["plausibility"]], bounds)
    judge_place(judged.get("place"), bounds.accept, where)
    judge_repeated(judged.get("repeated"), bounds)
    judge_returns(judged.get("returns"), bounds, where)
    judge_sunken(judged.get("ground", ()), bounds, where)
    judge_pits(judged.get("pits"), bounds, where)
    judge_halls(judged.get("halls"), bounds, where)
    judge_radiometry(judged.get("radiometry") or (), bounds.accept, where)
    if judged.get("strips"):
        judge_strips(judged["strips"], bounds.accept, where)
        judge_steps(judged["strips"], bounds.max_height_step, bounds.accept, where)
    judge_labels(judged.get("labels"), bounds, where)
