"""Li 2018: tables 1 and 2 as parts, our figures as plain data, and their page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from fwclass.conf import Config
from fwclass.conf.papers import paper
from fwclass.graph.stage import Plan, Stage
from fwclass.publish.papers.page import render_paper
from fwclass.run.inputs import PartInputs
from fwclass.run.runner import Runner
from fwclass.store.atomic import write_json
from fwclass.street.ring import BASES
from fwclass.study.papers.claims import judge_claims
from fwclass.study.papers.facts import Receipts, heading
from fwclass.study.papers.li_claims import CLAIMS
from fwclass.study.papers.li_work import DRIVE, GRIDS, StreetSettings, judge_feature, judge_radius, simulate_drive

NAME = "li2018"
RADIUS, SINGLE = "street-radius", "street-single"
DRIVE_VERSION, VERSION = 2, 3
FASTER = 1.4
"""Speed of the drive that tests, over that of the one that trains."""


def drives(config: Config) -> dict[str, dict[str, Any]]:
    """What is changed of `street_scene` for every drive."""
    scene = config.street_scene
    other = {"seed": scene.seed + 1, "speed": FASTER * scene.speed}
    return {"main": {}, "other": other, "leafless": {**other, "seed": scene.seed + 2, "leaves": False}}


def _settings(plan: Plan) -> dict[str, Any]:
    config = plan.config
    return {
        "settings": StreetSettings(
            config.street, config.train, config.compare, config.papers, config.assess, config.classes
        )
    }


SIMULATE_DRIVE = Stage(
    DRIVE,
    DRIVE_VERSION,
    "survey",
    "part",
    simulate_drive,
    parts=lambda plan: tuple(drives(plan.config)),
    arguments=lambda plan: {
        "scene": plan.config.street_scene,
        "scanner_name": plan.config.street.scanner,
        "mounting": plan.config.street.mounting,
    },
    each=lambda plan, name: {"changes": drives(plan.config)[name]},
)
JUDGE_RADIUS = Stage(
    RADIUS,
    VERSION,
    "survey",
    "part",
    judge_radius,
    parts=lambda plan: paper(NAME)["radii"],
    part_name=lambda metres: f"{100 * metres:.0f}",
    arguments=_settings,
    each=lambda plan, metres: {"metres": metres},
    after=(DRIVE,),
    needs=lambda plan, part: [(DRIVE, name) for name in drives(plan.config)],
)
JUDGE_FEATURE = replace(
    JUDGE_RADIUS,
    name=SINGLE,
    function=judge_feature,
    parts=lambda plan: BASES,
    part_name=str,
    each=lambda plan, base: {"metres": paper(NAME)["single"]["radius"], "feature": BASES.index(base)},
)
STAGES = (SIMULATE_DRIVE, JUDGE_RADIUS, JUDGE_FEATURE)


def facts(config: Config, printed: Mapping[str, Any], receipts: Receipts) -> dict[str, Any]:
    """Everything that the page tells, as plain data."""
    radii = [dict(receipts[RADIUS, f"{100 * r:.0f}"].meta) for r in printed["radii"]]
    singles = [dict(receipts[SINGLE, base].meta) for base in BASES]
    best = min(radii, key=lambda r: r["other"]["error"])
    matrix = radii[0]["random"]["confusion"]
    total = sum(map(sum, matrix))
    crowns = sum(matrix[0]) / total
    gathered: dict[str, Any] = {
        **heading(NAME, config, printed, ("points", "share", "radii", "bounds", "single")),
        "drives": {n: {**receipts[DRIVE, n].meta} for n in drives(config)},
        "scene": config.street_scene.model_dump(mode="json"),
        "method": config.train.method,
        "crowns": crowns,
        "guess": min(crowns, 1 - crowns),
        "radii": radii,
        "best": best["radius"],
        "singles": singles,
        "block": config.assess.block,
    }
    return {**gathered, "claims": judge_claims(printed["claims"], CLAIMS, gathered)}


def write_li2018(runner: Runner, facts: Mapping[str, Any]) -> dict[str, Any]:
    """Write ``li2018.json``, ``li2018.html`` and ``report.json``; the report."""
    inputs = PartInputs(runner.store)
    grids = {base: inputs.arrays(SINGLE, base, GRIDS)[0] for base in BASES}
    write_json(runner.pending / "li2018.json", dict(facts))
    render_paper({**facts, "grids": grids}, None, runner.pending / "li2018.html")
    best = next(r for r in facts["radii"] if r["radius"] == facts["best"])
    words = [
        f"frames      {sum(d['frames'] for d in facts['drives'].values())} on {len(facts['drives'])} simulated streets",
        f"at random   error {100 * best['random']['error']:.2f} % at δ = {best['radius']:g} m",
        f"elsewhere   error {100 * best['other']['error']:.2f} %",
        f"no leaves   error {100 * best['leafless']['error']:.2f} %",
    ]
    report = {"survey": facts["survey"], "words": words, "accuracy": None, "failed": []}
    report["outputs"] = {"li2018.html": ["li2018.html"]}
    write_json(runner.pending / "report.json", report)
    return report
