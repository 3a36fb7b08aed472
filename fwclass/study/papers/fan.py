"""Fan 2013: which variants its tables need, and our figures as plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fwclass import __version__
from fwclass.assess.stage import figures
from fwclass.conf import Config
from fwclass.run.part import Name
from fwclass.store.receipts import Receipt
from fwclass.study.papers.begin import base_of
from fwclass.study.papers.claims import judged
from fwclass.study.papers.fan_claims import CLAIMS
from fwclass.study.papers.variants import Variant, all_classes, changed
from fwclass.study.papers.work import cautioned

WAVEFORM = ("amplitude", "width", "backscatter")
"""Bases of features that only a waveform tells; how many echoes there are a discrete return tells too."""

MACHINES = ("rbf-svm", "linear-svm")
FEWER = "forest-fewer"
"""The forest on the rows that the RBF SVM trains on."""

Made = Mapping[Name, Receipt]


def variants(config: Config, names: tuple[str, ...], printed: Mapping[str, Any]) -> tuple[Variant, ...]:
    """The paper's m, the SVMs, with and without waveform features for every seed, all features, all classes."""
    used = config.features_asked
    tried = [m for m in map(int, printed["splits"]) if m <= len(used)] or [len(used)]
    found = [changed(config, f"m{m}", used, features_per_split=m) for m in tried]
    found += [changed(config, name, used, method=name) for name in MACHINES]
    found += [changed(config, FEWER, used, rows=config.compare.rbf_svm.max_rows)]
    if waveforms(config):
        for seed in config.papers.seeds:
            found += [changed(config, f"with-{seed}", used, seed=seed)]
            found += [changed(config, f"without-{seed}", echoes_only(used), seed=seed)]
    found += [changed(config, "every-feature", names)]
    if config.papers.more_classes:
        found += [changed(config, "every-class", used, len(all_classes(config)))]
    return tuple(found)


def waveforms(config: Config) -> bool:
    """The run's features hold what only a waveform tells (amplitude may be a discrete return's), and others besides."""
    return "width" in config.features_asked and bool(echoes_only(config.features_asked))


def echoes_only(names: Sequence[str]) -> tuple[str, ...]:
    """`names` without what only a waveform tells."""
    return tuple(n for n in names if base_of(n) not in WAVEFORM)


def comparisons(config: Config, found: Sequence[Variant]) -> list[tuple[Variant, Variant]]:
    """The forest against the SVMs; with against without waveform features, seed by seed."""
    by_name = {v.name: v for v in found}
    first = found[0]
    pairs = [(first, by_name[name]) for name in MACHINES] + [(by_name[FEWER], by_name["rbf-svm"])]
    if waveforms(config):
        pairs += [(by_name[f"with-{s}"], by_name[f"without-{s}"]) for s in config.papers.seeds]
    return pairs


def timed(found: Sequence[Variant]) -> list[Variant]:
    """The paper's m and the SVMs."""
    return [v for v in found if v.name in (found[0].name, FEWER, *MACHINES)]


def facts(
    config: Config,
    printed: Mapping[str, Any],
    report: Mapping[str, Any],
    curves: Mapping[str, Any],
    found: Sequence[Variant],
    made: Made,
) -> dict[str, Any]:
    """Everything that the page tells, as plain data."""
    classes = all_classes(config)
    n = len(config.classes)
    tables = {v.name: _figures(made, v, classes) for v in found}
    meta = made["paper-training", "all"].meta
    rows = np.array(made["paper-judged", found[0].name].meta["matrix"]).sum(axis=1).tolist()
    known = {c.name: [int(meta["counts"][k]), int(rows[k])] for k, c in enumerate(classes)}
    told: dict[str, Any] = {
        "paper": "fan2013",
        "survey": config.survey.name,
        "fwclass": __version__,
        **{k: printed[k] for k in ("citation", "doi", "data", "notes")},
        "printed": {k: printed[k] for k in ("classes", "distribution", "selection", "splits", "svm", "seconds")},
        "classes": [{"name": c.name, "code": c.code} for c in config.survey.classes],
        "more_classes": [{"name": c.name, "code": c.code} for c in config.papers.more_classes],
        "features": list(config.features_asked),
        "rows": known,
        "areas": report["areas"],
        "whole": report["accuracy"],
        "distribution": _distribution(report, curves["paper"]["candidates"]),
        "selection": curves,
        "splits": {v.name[1:]: tables[v.name] for v in found if v.name[1:].isdigit()},
        "machines": {name: {**tables[name], **_machine(made, name)} for name in MACHINES},
        "forest_fewer": {**tables[FEWER], **_machine(made, FEWER)},
        "forest": found[0].name,
        "every_feature": tables["every-feature"],
        "every_class": tables.get("every-class"),
        "unscored": _unscored(made, found[0].name, classes, n),
        "differences": {"/".join(pair): _difference(made, pair) for pair in _pairs(config, found)},
        "thesis": _thesis(config, tables),
        "times": {v.name: dict(made["paper-time", v.name].meta) for v in timed(found)},
    }
    return {**told, "claims": judged(printed["claims"], CLAIMS, told)}


def _figures(made: Made, one: Variant, classes: Sequence[Any]) -> dict[str, Any]:
    answers = made["paper-judged", one.name].meta
    matrix = np.array(answers["matrix"], np.int64)[: one.classes]
    model = made["paper-model", one.name].meta
    told = figures(matrix, [c.name for c in classes[: one.classes]])
    told["intervals"] = answers["intervals"]
    return {**told, "features": list(one.features), "out_of_bag": model["out_of_bag"], "nodes": model["nodes"]}


def _machine(made: Made, name: str) -> dict[str, Any]:
    meta = made["paper-model", name].meta
    notes = [n for n in meta["notes"] if not n.startswith("class ")]
    return {"rows": meta["rows"], "notes": notes, "params": meta["params"]}


def _distribution(report: Mapping[str, Any], names: Sequence[str]) -> dict[str, Any]:
    """Quantiles of the paper's features, the classes in the survey's order."""
    order = [c["name"] for c in report["classes"]]
    found = {name: report["distribution"][name] for name in names if name in report["distribution"]}
    return {name: {c: by_class[c] for c in order if c in by_class} for name, by_class in found.items()}


def _unscored(made: Made, name: str, classes: Sequence[Any], n: int) -> dict[str, Any]:
    """What the classes that the paper does not have are taken for: {class: {class: echoes}}."""
    matrix = made["paper-judged", name].meta["matrix"]
    return {c.name: {classes[j].name: matrix[n + i][j] for j in range(n)} for i, c in enumerate(classes[n:])}


def _pairs(config: Config, found: Sequence[Variant]) -> list[tuple[str, str]]:
    return [(a.name, b.name) for a, b in comparisons(config, found)]


def _difference(made: Made, pair: tuple[str, str]) -> dict[str, Any]:
    return cautioned(made["paper-difference", "-".join(pair)].meta)


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
