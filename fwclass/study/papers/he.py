"""He 2023: filters on samples as parts, our figures as plain data, and their page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.conf import Config
from fwclass.conf.papers import paper
from fwclass.errors import ConfigError, InputError
from fwclass.graph.stage import Plan, Stage
from fwclass.publish.papers.page import render_paper
from fwclass.run.inputs import PartInputs
from fwclass.run.runner import Runner
from fwclass.store.atomic import write_json
from fwclass.store.remote_file import Location, local
from fwclass.store.run_store import Store
from fwclass.study.papers.claims import judge_claims
from fwclass.study.papers.facts import Receipts, heading
from fwclass.study.papers.he_claims import CLAIMS, COMBINED
from fwclass.study.papers.he_work import describe_sample, judge_filter, terrain_of
from fwclass.survey.file_digests import Digests
from fwclass.survey.files import without_excluded
from fwclass.survey.gather import directory_of
from fwclass.survey.layout import FileDigests, Survey

NAME = "he2023"
FILTER, SAMPLE = "filter-search", "filter-sample"
VERSION = 2
FIGURES = ("type_i", "type_ii", "total_error", "kappa")
SHOWN = ("smrf", "csf", COMBINED)
"""Filters whose terrain is drawn beside the reference's, as in figures 6 to 8."""


def with_samples(plan: Plan, store: Store) -> Plan:
    """The plan with the labelled files and their digests; `InputError` for two of one name, or none."""
    config = plan.config
    if config.simulated:
        raise ConfigError(
            "ground filters are judged on labelled files",
            where=f"{config.path}: survey.simulated",
            do="name labelled files in survey.sources, as conf/surveys/he2023-isprs.yaml does",
        )
    directory, digests = directory_of(config, Path()), Digests(store)
    matching = digests.find(config.survey.sources, directory, "survey.sources", config)
    places, _ = without_excluded(matching, config.survey.exclude, directory, config.path, config.store)
    samples: dict[str, tuple[Location, FileDigests]] = {}
    for place in places:
        path = local(place)
        if path.stem in samples:
            raise InputError(
                "two samples have one name", where=path, got=samples[path.stem][0], do="rename one of them"
            )
        samples[path.stem] = place, digests.of([path], place)
    digests.save()
    return replace(plan, files=Survey((), (), None, False, echo_labels=tuple(samples.values())))


def _name(sample: tuple[Location, FileDigests]) -> str:
    """The file's name without its ending."""
    return local(sample[0]).stem


def methods_of(printed: Mapping[str, Any]) -> tuple[str, ...]:
    """The families and their combination."""
    return (*printed["families"], COMBINED)


DESCRIBE_SAMPLE = Stage(
    SAMPLE,
    VERSION,
    "file",
    "part",
    describe_sample,
    parts=lambda plan: plan.survey.echo_labels,
    part_name=_name,
    arguments=lambda plan: {"params": plan.config.ground, "terrain": plan.config.terrain},
    source=lambda plan, sample: sample,
)
JUDGE_FILTER = Stage(
    FILTER,
    VERSION,
    "file",
    "part",
    judge_filter,
    parts=lambda plan: [(one, method) for one in plan.survey.echo_labels for method in methods_of(paper(NAME))],
    part_name=lambda part: f"{_name(part[0])}-{part[1]}",
    arguments=lambda plan: {"limits": plan.config.ground_search, "terrain": plan.config.terrain},
    each=lambda plan, part: {"params": plan.config.ground.model_copy(update={"method": part[1]})},
    source=lambda plan, part: part[0],
)
STAGES = (DESCRIBE_SAMPLE, JUDGE_FILTER)


def facts(config: Config, printed: Mapping[str, Any], samples: Sequence[str], receipts: Receipts) -> dict[str, Any]:
    """Everything that the page tells, as plain data."""
    methods = methods_of(printed)
    about = {name: dict(receipts[SAMPLE, name].meta) for name in samples}
    by_sample = {s: {m: dict(receipts[FILTER, f"{s}-{m}"].meta) for m in methods} for s in samples}
    middle = float(np.median([a["slope"] for a in about.values()]))
    gathered: dict[str, Any] = {
        **heading(NAME, config, printed, ("families", "optima", "gains")),
        "methods": list(methods),
        "samples": about,
        "steep": [name for name, a in about.items() if a["slope"] >= middle],
        "by_sample": by_sample,
        "means": {m: _means([by_sample[s][m] for s in samples]) for m in methods},
    }
    return {**gathered, "claims": judge_claims(printed["claims"], CLAIMS, gathered)}


def _means(results: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Means of the figures over samples, and points a second."""
    means: dict[str, Any] = {
        kind: {f: float(np.mean([r[kind][f] for r in results])) for f in FIGURES}
        for kind in ("start", "best", "held_out")
    }
    seconds = sum(r["seconds"] for r in results)
    return {**means, "speed": sum(r["points"] for r in results) / max(seconds, 1e-9)}


def write_he2023(config: Config, runner: Runner, samples: Sequence[str], facts: Mapping[str, Any]) -> dict[str, Any]:
    """Write ``he2023.json``, ``he2023.html`` and ``report.json``; the report."""
    inputs = PartInputs(runner.store)
    write_json(runner.pending / "he2023.json", dict(facts))
    by_slope = sorted(samples, key=lambda name: (facts["samples"][name]["slope"], name))
    drawn = dict.fromkeys(by_slope[k] for k in (0, len(by_slope) // 2, -1))
    reliefs = {name: _reliefs(config, inputs, name) for name in drawn}
    render_paper({**facts, "reliefs": reliefs}, None, runner.pending / "he2023.html")
    held = {m: facts["means"][m]["held_out"] for m in facts["methods"]}
    words = [f"samples     {len(samples)}, {len(held)} filters each", "held out    total error, Type II, kappa"]
    words += [
        f"  {m:<15} {100 * h['total_error']:6.2f} % {100 * h['type_ii']:6.2f} % {100 * h['kappa']:6.2f} %"
        for m, h in held.items()
    ]
    report = {"survey": facts["survey"], "words": words, "accuracy": None, "failed": []}
    report["outputs"] = {"he2023.html": ["he2023.html"]}
    write_json(runner.pending / "report.json", report)
    return report


def _reliefs(config: Config, inputs: PartInputs, sample: str) -> list[tuple[str, bytes]]:
    """PNG of the reference's terrain and of filters', in one tint."""
    from fwclass.publish.figures import relief, tint_range  # matplotlib is slow to load

    terrains: list[tuple[str, tuple[NDArray[np.float32], Any]]] = [("reference", terrain_of(inputs, SAMPLE, sample))]
    terrains += [(method, terrain_of(inputs, FILTER, f"{sample}-{method}")) for method in SHOWN]
    tints = tint_range(terrains[0][1][0])
    params = config.publish.model_copy(update={"figure_pixels": 420})
    return [(name, relief(dtm, window, params, tints, aside=False)) for name, (dtm, window) in terrains]
