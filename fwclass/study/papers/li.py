"""Li 2018: tables 1 and 2 as parts, our figures as plain data, and their page."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from fwclass.conf import Config
from fwclass.publish.papers.page import render_paper
from fwclass.run.inputs import PartInputs
from fwclass.run.part import Task
from fwclass.run.runner import Runner
from fwclass.store.atomic import write_json
from fwclass.street.ring import BASES
from fwclass.study.papers.claims import judge_claims
from fwclass.study.papers.facts import Receipts, heading
from fwclass.study.papers.li_claims import CLAIMS
from fwclass.study.papers.li_work import DRIVE, GRIDS, judge_feature, judge_radius, simulate_drive

RADIUS, SINGLE = "street-radius", "street-single"
DRIVE_VERSION, VERSION = 1, 2
FASTER = 1.4
"""Speed of the drive that tests, over that of the one that trains."""


def drives(config: Config) -> dict[str, dict[str, Any]]:
    """What is changed of `street_scene` for every drive."""
    scene = config.street_scene
    other = {"seed": scene.seed + 1, "speed": FASTER * scene.speed}
    return {"main": {}, "other": other, "leafless": {**other, "seed": scene.seed + 2, "leaves": False}}


def drive_tasks(config: Config) -> list[Task]:
    """A simulated recording for every drive."""
    about = [config.street_scene.model_dump(), config.street.scanner, config.street.mounting.model_dump()]
    return [
        Task(DRIVE, name, DRIVE_VERSION, [*about, changed], partial(simulate_drive, config, changed))
        for name, changed in drives(config).items()
    ]


def table_tasks(config: Config, printed: Mapping[str, Any]) -> list[Task]:
    """A part for every radius, and one for every feature alone."""
    sections = ("street", "train", "compare", "papers", "assess")
    about = [getattr(config, n).model_dump(mode="json") for n in sections]
    about.append([c.plain() for c in config.classes])
    needs = tuple((DRIVE, name) for name in drives(config))
    tasks = [
        Task(RADIUS, f"{100 * r:.0f}", VERSION, [*about, r], partial(judge_radius, config, r), needs)
        for r in printed["radii"]
    ]
    metres = printed["single"]["radius"]
    return tasks + [
        Task(SINGLE, base, VERSION, [*about, metres, k], partial(judge_feature, config, metres, k), needs)
        for k, base in enumerate(BASES)
    ]


def facts(config: Config, printed: Mapping[str, Any], receipts: Receipts) -> dict[str, Any]:
    """Everything that the page tells, as plain data."""
    radii = [dict(receipts[RADIUS, f"{100 * r:.0f}"].meta) for r in printed["radii"]]
    singles = [dict(receipts[SINGLE, base].meta) for base in BASES]
    best = min(radii, key=lambda r: r["other"]["error"])
    matrix = radii[0]["random"]["confusion"]
    total = sum(map(sum, matrix))
    crowns = sum(matrix[0]) / total
    gathered: dict[str, Any] = {
        **heading("li2018", config, printed, ("points", "share", "radii", "bounds", "single")),
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


def deliver(runner: Runner, facts: Mapping[str, Any]) -> dict[str, Any]:
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
