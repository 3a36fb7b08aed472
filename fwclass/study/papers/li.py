"""Li 2018: tables 1 and 2 as parts, and our figures as plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from fwclass import __version__
from fwclass.conf import Config
from fwclass.run.part import Name, Task
from fwclass.store.receipts import Receipt
from fwclass.street.ring import BASES
from fwclass.study.papers.claims import judged
from fwclass.study.papers.li_claims import CLAIMS
from fwclass.study.papers.li_work import DRIVE, drive, radius, single

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
    about = [config.street_scene.model_dump(), config.street.scanner, config.street.mounting.model_dump()]
    return [
        Task(DRIVE, name, DRIVE_VERSION, [*about, changed], partial(drive, config, changed))
        for name, changed in drives(config).items()
    ]


def table_tasks(config: Config, printed: Mapping[str, Any]) -> list[Task]:
    """A part for every radius, and one for every feature alone."""
    sections = ("street", "train", "compare", "papers", "assess")
    about = [getattr(config, n).model_dump(mode="json") for n in sections]
    about.append([c.plain() for c in config.classes])
    needs = tuple((DRIVE, name) for name in drives(config))
    tasks = [
        Task(RADIUS, f"{100 * r:.0f}", VERSION, [*about, r], partial(radius, config, r), needs)
        for r in printed["radii"]
    ]
    metres = printed["single"]["radius"]
    return tasks + [
        Task(SINGLE, base, VERSION, [*about, metres, k], partial(single, config, metres, k), needs)
        for k, base in enumerate(BASES)
    ]


def facts(config: Config, printed: Mapping[str, Any], receipts: Mapping[Name, Receipt]) -> dict[str, Any]:
    """Everything that the page tells, as plain data."""
    radii = [dict(receipts[RADIUS, f"{100 * r:.0f}"].meta) for r in printed["radii"]]
    singles = [dict(receipts[SINGLE, base].meta) for base in BASES]
    best = min(radii, key=lambda r: r["other"]["error"])
    matrix = radii[0]["random"]["confusion"]
    total = sum(map(sum, matrix))
    crowns = sum(matrix[0]) / total
    gathered: dict[str, Any] = {
        "paper": "li2018",
        "survey": config.survey.name,
        "fwclass": __version__,
        **{k: printed[k] for k in ("citation", "doi", "data", "notes")},
        "printed": {k: printed[k] for k in ("points", "share", "radii", "bounds", "single")},
        "classes": [{"name": c.name, "code": c.code} for c in config.survey.classes],
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
    return {**gathered, "claims": judged(printed["claims"], CLAIMS, gathered)}


def worst(radii: Sequence[Mapping[str, Any]], split: str, key: str) -> float:
    """The least favourable figure over the radii."""
    values = [r[split][key] for r in radii]
    return float(min(values) if key == "detection" else max(values))
