"""Fan 2013: which variants its tables need, and our figures as plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fwclass.assess.confusion import figures
from fwclass.conf import Config
from fwclass.conf.papers import paper
from fwclass.graph.stage import Plan
from fwclass.schema import base_of
from fwclass.study.papers.begin import features_like
from fwclass.study.papers.claims import judge_claims
from fwclass.study.papers.facts import Receipts, differences, heading, rows_by_class, times
from fwclass.study.papers.fan_claims import CLAIMS
from fwclass.study.papers.variants import Comparison, all_classes, make_variant
from fwclass.study.papers.work import Variant
from fwclass.study.select.trials import TRY_FEATURES
from fwclass.study.selection import SELECTION

WAVEFORM = ("amplitude", "width", "backscatter")
"""Bases of features that only a waveform tells; how many echoes there are a discrete return tells too."""

MACHINES = ("rbf-svm", "linear-svm")
FEWER = "forest-fewer"
"""The forest on the rows that the RBF SVM trains on."""

_PRINTED = ("classes", "distribution", "selection", "splits", "svm", "seconds")


def variants(config: Config, names: tuple[str, ...], printed: Mapping[str, Any]) -> tuple[Variant, ...]:
    """The paper's m, the SVMs, with and without waveform features for every seed, all features, all classes."""
    used = config.features_asked
    tried = [m for m in map(int, printed["splits"]) if m <= len(used)] or [len(used)]
    variants = [make_variant(config, f"m{m}", used, features_per_split=m) for m in tried]
    variants += [make_variant(config, name, used, method=name) for name in MACHINES]
    variants += [make_variant(config, FEWER, used, rows=config.compare.rbf_svm.max_rows)]
    if waveforms(config):
        for seed in config.papers.seeds:
            variants += [make_variant(config, f"with-{seed}", used, seed=seed)]
            variants += [make_variant(config, f"without-{seed}", echoes_only(used), seed=seed)]
    variants += [make_variant(config, "every-feature", names)]
    if config.papers.more_classes:
        variants += [make_variant(config, "every-class", used, len(all_classes(config)))]
    return tuple(variants)


def waveforms(config: Config) -> bool:
    """The run's features hold what only a waveform tells (amplitude may be a discrete return's), and others besides."""
    return "width" in config.features_asked and bool(echoes_only(config.features_asked))


def echoes_only(names: Sequence[str]) -> tuple[str, ...]:
    """`names` without what only a waveform tells."""
    return tuple(n for n in names if base_of(n) not in WAVEFORM)


def comparisons(config: Config, variants: Sequence[Variant]) -> list[tuple[Variant, Variant]]:
    """The forest against the SVMs; with against without waveform features, seed by seed."""
    by_name = {v.name: v for v in variants}
    first = variants[0]
    pairs = [(first, by_name[name]) for name in MACHINES] + [(by_name[FEWER], by_name["rbf-svm"])]
    if waveforms(config):
        pairs += [(by_name[f"with-{s}"], by_name[f"without-{s}"]) for s in config.papers.seeds]
    return pairs


def timed_variants(variants: Sequence[Variant]) -> list[Variant]:
    """The paper's m and the SVMs."""
    return [v for v in variants if v.name in (variants[0].name, FEWER, *MACHINES)]


def facts(
    config: Config,
    printed: Mapping[str, Any],
    report: Mapping[str, Any],
    curves: Mapping[str, Any],
    variants: Sequence[Variant],
    receipts: Receipts,
) -> dict[str, Any]:
    """Everything that the page tells, as plain data."""
    classes = all_classes(config)
    tables = {v.name: _figures(receipts, v, classes) for v in variants}
    gathered: dict[str, Any] = {
        **heading("fan2013", config, printed, _PRINTED),
        "more_classes": [{"name": c.name, "code": c.code} for c in config.papers.more_classes],
        "features": list(config.features_asked),
        "rows": rows_by_class(receipts, variants[0], [c.name for c in classes]),
        "areas": report["areas"],
        "whole": report["accuracy"],
        "distribution": _distribution(report, curves["paper"]["candidates"]),
        "selection": curves,
        "splits": {v.name[1:]: tables[v.name] for v in variants if v.name[1:].isdigit()},
        "machines": {name: {**tables[name], **_machine(receipts, name)} for name in MACHINES},
        "forest_fewer": {**tables[FEWER], **_machine(receipts, FEWER)},
        "forest": variants[0].name,
        "every_feature": tables["every-feature"],
        "every_class": tables.get("every-class"),
        "unscored": _unscored(receipts, variants[0].name, classes, len(config.classes)),
        "differences": differences(receipts, comparisons(config, variants)),
        "thesis": _thesis(config, tables),
        "times": times(receipts, timed_variants(variants)),
    }
    return {**gathered, "claims": judge_claims(printed["claims"], CLAIMS, gathered)}


def _figures(receipts: Receipts, one: Variant, classes: Sequence[Any]) -> dict[str, Any]:
    answers = receipts["paper-judged", one.name].meta
    matrix = np.array(answers["matrix"], np.int64)[: one.classes]
    model = receipts["paper-model", one.name].meta
    table = figures(matrix, [c.name for c in classes[: one.classes]])
    table["intervals"] = answers["intervals"]
    return {**table, "features": list(one.features), "out_of_bag": model["out_of_bag"], "nodes": model["nodes"]}


def _machine(receipts: Receipts, name: str) -> dict[str, Any]:
    meta = receipts["paper-model", name].meta
    notes = [n for n in meta["notes"] if not n.startswith("class ")]
    return {"rows": meta["rows"], "notes": notes, "params": meta["params"]}


def _distribution(report: Mapping[str, Any], names: Sequence[str]) -> dict[str, Any]:
    """Quantiles of the paper's features, the classes in the survey's order."""
    order = [c["name"] for c in report["classes"]]
    quantiles = {name: report["distribution"][name] for name in names if name in report["distribution"]}
    return {name: {c: by_class[c] for c in order if c in by_class} for name, by_class in quantiles.items()}


def _unscored(receipts: Receipts, name: str, classes: Sequence[Any], n: int) -> dict[str, Any]:
    """What the classes that the paper does not have are taken for: {class: {class: echoes}}."""
    matrix = receipts["paper-judged", name].meta["matrix"]
    return {c.name: {classes[j].name: matrix[n + i][j] for j in range(n)} for i, c in enumerate(classes[n:])}


def _thesis(config: Config, tables: Mapping[str, Any]) -> dict[str, Any] | None:
    """With and without waveform features, seed by seed; None where there are no waveforms."""
    if not waveforms(config):
        return None
    seeds = list(config.papers.seeds)
    return {
        "seeds": seeds,
        "features": {k: tables[f"{k}-{seeds[0]}"]["features"] for k in ("with", "without")},
        **{k: [tables[f"{k}-{s}"] for s in seeds] for k in ("with", "without")},
    }


def columns(plan: Plan) -> tuple[str, ...]:
    """The paper's features, and those of the run's own forest, which may decide by what the paper lacks."""
    return tuple(dict.fromkeys((*features_of(plan.config), *plan.names)))


def features_of(config: Config) -> tuple[str, ...]:
    """The survey's features that the paper has too."""
    return features_like(config, paper("fan2013")["selection"]["order"])


def _all_variants(plan: Plan) -> tuple[Variant, ...]:
    return variants(plan.config, features_of(plan.config), paper("fan2013"))


def _trials(plan: Plan) -> int:
    """Forward in the paper's order, and in the best."""
    candidates = len(features_of(plan.config))
    return plan.config.select.folds * (candidates + candidates * (candidates + 1) // 2)


TABLES = Comparison(
    columns,
    _all_variants,
    pairs=lambda plan: comparisons(plan.config, _all_variants(plan)),
    timed=lambda plan: timed_variants(_all_variants(plan)),
)
STAGES = (
    *(replace(stage, number=_trials) if stage is TRY_FEATURES else stage for stage in SELECTION),
    *TABLES.stages,
    *TABLES.times,
)
