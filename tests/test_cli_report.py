"""`fwclass run --report`: Dask's performance report as one page, and the dashboard's address."""

from __future__ import annotations

import json
import re
from pathlib import Path

import laspy
import numpy as np
import pytest
from commandline import fwclass, process

from fwclass.conf import load
from fwclass.errors import QualityError
from fwclass.report import write
from fwclass.report.judge import judge_report
from fwclass.run import libraries as told
from fwclass.store import libraries

CONFIG = """
survey:
  name: small
  directory: .
  sources: [a.las]
  reference: {kind: source}
  crs: none
  features: [zc]
  classes: [{name: a, code: 2, codes: [2]}, {name: b, code: 6, codes: [6]}]
areas: {train: [[0, 0, 5, 10]], gap: 0.5}
tile: {size: 5.0}
train: {trees: 2}
plausibility: {accept: true}
"""


@pytest.fixture
def survey(tmp_path) -> Path:
    r = np.random.default_rng(0)
    las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    las.header.scales = [0.001] * 3
    las.x, las.y, las.z = r.uniform(0, 10, (3, 400))
    las.classification = r.choice([2, 6], 400)
    las.write(tmp_path / "a.las")
    (tmp_path / "c.yaml").write_text(CONFIG)
    return tmp_path


@pytest.mark.slow
def test_the_report_is_one_page(survey):
    pytest.importorskip("bokeh")
    ended = process("run", "c.yaml", "--out", "r", "--workers", 1, "--report", cwd=survey)
    assert ended.returncode == 0, ended.stderr
    assert re.search(r"^dask +http://127\.0\.0\.1:\d+/status$", ended.stderr, re.MULTILINE)
    page = (survey / "r" / "performance.html").read_text()
    assert "dask" in page.lower() and "features" in page
    outside = re.findall(r"""<(?:script|link|img)[^>]+(?:src|href)=["']?(?:https?:)?//[^"'> ]+""", page)
    assert outside == []
    assert not list((survey / "r").glob(".*performance*"))


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--workers", 0, "--report"), "plain loop"),
        (("--workers", 1, "--report", "page.txt"), "ends in .html"),
        (("--workers", 1, "--report", "there.html"), "such a file already"),
        (("--only", "features/0_0", "--report"), "--report out"),
    ],
)
def test_without_workers_or_a_page_it_is_refused_before_anything_starts(survey, words, told):
    (survey / "there.html").touch()
    ended = fwclass("run", "c.yaml", "--out", "r", *words, cwd=survey)
    assert ended.returncode == 2 and told in ended.stderr, ended.stderr
    assert not (survey / "r").exists()


def test_without_bokeh_it_is_refused_before_anything_starts(survey, monkeypatch):
    import importlib.util

    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *rest: None if name == "bokeh" else find(name, *rest))
    ended = fwclass("run", "c.yaml", "--out", "r", "--workers", 1, "--report", cwd=survey)
    assert ended.returncode == 2 and "pip install 'fwclass[dashboard]'" in ended.stderr
    assert not (survey / "r").exists()


def test_report_of_a_workflow_without_sources_is_judged(survey: Path) -> None:
    config = load(survey / "c.yaml", ("plausibility.accept=false",))
    judge_report({"accuracy": None}, config, replaces=False)
    nowhere = {"accuracy": None, "input": {"place": {"elsewhere": True, "remarks": ["far"]}}}
    with pytest.raises(QualityError, match="do not lie where"):
        judge_report(nowhere, config, replaces=False)


def test_other_code_writes_the_report_anew_though_no_part_is(survey, monkeypatch):
    """Its words and figures are those of the code that is there; by the same code the report stays."""

    def run() -> tuple[str, str]:
        words = ("--workers", 0, "--workflow", "ground", "--set", "survey.reference={kind: none}")
        ended = fwclass("run", "c.yaml", "--out", "r", *words, cwd=survey)
        assert ended.returncode == 0, ended.stderr
        shown = survey / "r" / "current"
        return json.loads((shown / "report.json").read_text())["libraries"]["here"]["source"], shown.resolve().name

    assert run() == run() == (libraries.source_digest(), "0001")
    other = {**libraries.fingerprint(), "source": "0123456789abcdef"}
    for module in (told, write):
        monkeypatch.setattr(module, "fingerprint", lambda: other)
    assert run() == run() == ("0123456789abcdef", "0002")
