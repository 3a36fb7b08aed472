"""A stranger's finished run, whose manifest fits: what it names lies nowhere else, and is told in words."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from commandline import fwclass
from smallsurvey import deliver, small_survey

from fwclass.store.atomic import bytes_digest, file_digest
from fwclass.store.seal import seal, unseal

TILE = "20000_216000"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("stranger")
    small_survey(place, tile=25)
    deliver(place)
    return place / "run"


def rewrite(path: Path, data: bytes) -> None:
    path.unlink()
    path.write_bytes(data)


def forged(run: Path, name: str, change: Callable[[Any], object]) -> None:
    """Change a file of the delivery, and make its manifest fit."""
    delivery = (run / "current").resolve()
    told = json.loads((delivery / name).read_bytes())
    change(told)
    rewrite(delivery / name, json.dumps(told).encode())
    manifest = json.loads((delivery / "manifest.json").read_bytes())
    manifest["files"][name] |= {"bytes": (delivery / name).stat().st_size, "digest": file_digest(delivery / name)}
    rewrite(delivery / "manifest.json", json.dumps(manifest).encode())
    facts = unseal(json.loads((delivery / "generation.json").read_bytes()))
    facts["manifest"] = bytes_digest((delivery / "manifest.json").read_bytes())
    rewrite(delivery / "generation.json", json.dumps(seal(facts)).encode())


def first(change: Callable[[Any], object]) -> Callable[[Any], object]:
    return lambda told: change(told["features"][0])


VPC, REPORT = "laz/survey.vpc", "report.json"
FORGED: dict[str, tuple[str, Callable[[Any], object]]] = {
    "a path that leads up": (VPC, first(lambda t: t["assets"]["data"].update(href="../../../../../../etc/passwd"))),
    "an absolute path": (VPC, first(lambda t: t["assets"]["data"].update(href="/etc/passwd"))),
    "a tile elsewhere": (VPC, first(lambda t: t.update(id="../../../../etc/passwd"))),
    "no bounds": (VPC, first(lambda t: t["properties"].update({"proj:bbox": [1]}))),
    "bounds without end": (VPC, first(lambda t: t["properties"].update({"proj:bbox": [-1e300] * 3 + [1e300] * 3}))),
    "a count that is none": (VPC, first(lambda t: t["properties"].update({"pc:count": "x"}))),
    "no height": (VPC, first(lambda t: t["properties"].update({"pc:statistics": []}))),
    "a tile that is listed twice": (VPC, lambda told: told["features"].append(told["features"][0])),
    "a tile in another's file": (VPC, first(lambda t: t.update(id="20001_216001"))),
    "a list of nothing": (VPC, lambda told: told.clear()),
    "classes without code": (REPORT, lambda told: told.update(classes=[{"name": "a"}])),
    "a survey without name": (REPORT, lambda told: told.update(survey=None)),
}


def within(*way: str | int, value: Any) -> Callable[[Any], object]:
    """The value at a place of a report."""

    def change(told: Any) -> None:
        for name in way[:-1]:
            told = told[name]
        told[way[-1]] = value

    return change


FIGURES: dict[str, Callable[[Any], object]] = {
    "no size of tiles": within("config", value={}),
    "a size that is none": within("config", "tile", "size", value=[1]),
    "counts that are none": within("accuracy", "confusion", value=[[1, [0, 1]], [2, 3]]),
    "a figure that is text": within("accuracy", "kappa", value="x"),
    "files without path": within("input", "files", value=[{"strip": 1}]),
    "libraries that are none": within("libraries", "here", value=7),
    "a model of nothing": within("model", value=[]),
    "areas of text": within("areas", "test", value="all"),
    "a gap of text": within("config", "areas", "gap", value="wide"),
    "a reference of nothing": within("config", "survey", "reference", value=None),
}
"""Each but the last ended a command with a traceback."""


@pytest.mark.parametrize("kind", FIGURES)
@pytest.mark.parametrize("words", [("diff", "1", "1"), ("suggest", "s.gpkg"), ("view", "--export", "page")])
def test_a_report_that_somebody_made_is_told_in_words(run: Path, tmp_path: Path, kind: str, words: tuple) -> None:
    before = {n: (run / "current" / n).read_bytes() for n in (REPORT, "manifest.json", "generation.json")}
    forged(run, REPORT, FIGURES[kind])
    try:
        ended = fwclass(words[0], run, *(tmp_path / w if "g" in w and w[0] != "-" else w for w in words[1:]))
    finally:
        for name, data in before.items():
            rewrite((run / "current").resolve() / name, data)
    assert ended.returncode in (1, 2) and "tells what no run writes" in ended.stderr, ended.stderr


@pytest.mark.parametrize("kind", FORGED)
def test_a_delivery_that_somebody_made_is_told_in_words(run: Path, tmp_path: Path, kind: str) -> None:
    before = {n: (run / "current" / n).read_bytes() for n in (VPC, REPORT, "manifest.json", "generation.json")}
    forged(run, *FORGED[kind])
    try:
        ended = fwclass("label", "checkout", run, tmp_path / "out", "--tiles", TILE)
    finally:
        for name, data in before.items():
            rewrite((run / "current").resolve() / name, data)
    assert ended.returncode in (1, 2) and "tells what no run writes" in ended.stderr, ended.stderr
    assert not (tmp_path / "out").exists()
