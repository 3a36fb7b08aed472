"""The page of Li 2018: tables, grids, verdicts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fwclass.publish.papers.page import render_paper
from fwclass.run.inputs import PartInputs
from fwclass.run.runner import Runner
from fwclass.store.atomic import write_json
from fwclass.street.ring import BASES
from fwclass.study.papers.li import SINGLE
from fwclass.study.papers.li_work import GRIDS


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
