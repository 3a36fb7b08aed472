"""Xiong 2018: the four strategies, the thinning curve, and our figures as plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fwclass.assess.confusion import figures
from fwclass.conf import Config
from fwclass.graph.stage import Plan
from fwclass.schema import base_of
from fwclass.select.work import scale_of
from fwclass.study.papers.claims import judge_claims
from fwclass.study.papers.facts import Receipts, differences, heading, rows_by_class, times
from fwclass.study.papers.variants import Comparison, make_variant
from fwclass.study.papers.work import Variant
from fwclass.study.papers.xiong_claims import CLAIMS
from fwclass.study.select.thinning import THINNING_STAGES
from fwclass.study.selection import ELIMINATION

SELECTED, ALL, SVM_SELECTED, SVM = "rf_selected", "rf", "svm_selected", "svm"
_PRINTED = ("strategies", "samples", "selection", "radii", "groups", "thinning")


def variants(config: Config, names: tuple[str, ...], chosen: tuple[str, ...]) -> tuple[Variant, ...]:
    """The paper's four strategies."""
    return (
        make_variant(config, SELECTED, chosen),
        make_variant(config, ALL, names),
        make_variant(config, SVM_SELECTED, chosen, method="linear-svm"),
        make_variant(config, SVM, names, method="linear-svm"),
    )


def comparisons(variants: Sequence[Variant]) -> list[tuple[Variant, Variant]]:
    """What selection gains for either classifier, and the forest over the SVM."""
    by_name = {v.name: v for v in variants}
    pairs = ((SELECTED, ALL), (SVM_SELECTED, SVM), (SELECTED, SVM_SELECTED), (ALL, SVM))
    return [(by_name[a], by_name[b]) for a, b in pairs]


def facts(
    config: Config,
    printed: Mapping[str, Any],
    report: Mapping[str, Any],
    selection: Mapping[str, Any],
    thinning: Mapping[str, Any],
    variants: Sequence[Variant],
    receipts: Receipts,
) -> dict[str, Any]:
    """Everything that the page tells, as plain data."""
    names = [c.name for c in config.classes]
    gathered: dict[str, Any] = {
        **heading("xiong2018", config, printed, _PRINTED),
        "candidates": selection["candidates"],
        "chosen": selection["chosen"],
        "rows": rows_by_class(receipts, variants[0], names),
        "areas": report["areas"],
        "whole": report["accuracy"],
        "settings": _settings(config),
        "selection": dict(selection),
        "thinning": dict(thinning),
        "strategies": {v.name: _strategy(receipts, v, names) for v in variants},
        "differences": differences(receipts, comparisons(variants)),
        "importance": importances(receipts["paper-importance", "all"].meta, printed["groups"]),
        "radii": radii(selection["candidates"], selection["chosen"], printed["radii"]),
        "times": times(receipts, variants),
    }
    return {**gathered, "claims": judge_claims(printed["claims"], CLAIMS, gathered)}


def _settings(config: Config) -> dict[str, Any]:
    """What the page says of how it was run."""
    train, csf = config.train, config.ground.csf
    return {
        "trees": train.trees,
        "criterion": train.criterion,
        "split": train.split,
        "bagging": train.bagging,
        "replacement": train.replacement,
        "min_samples_split": train.min_samples_split,
        "features_per_split": train.features_per_split,
        "ground": config.ground.method,
        "cloth_resolution": csf.cloth_resolution,
        "iterations": csf.iterations,
        "rigidness": csf.rigidness,
        "height": config.terrain.height,
        "cell": config.terrain.cell,
        "svm_c": config.compare.linear_svm.c,
    }


def _strategy(receipts: Receipts, one: Variant, names: Sequence[str]) -> dict[str, Any]:
    answers, model = receipts["paper-judged", one.name].meta, receipts["paper-model", one.name].meta
    table = figures(np.array(answers["matrix"], np.int64)[: one.classes], list(names))

    def rest(values: Sequence[float | None]) -> dict[str, float | None]:
        return {n: None if v is None else 1 - v for n, v in zip(names, values, strict=True)}

    return {
        **table,
        "intervals": answers["intervals"],
        "features": len(one.features),
        "nodes": model["nodes"],
        "out_of_bag": model["out_of_bag"],
        "notes": model["notes"],
        "omission": rest(table["producers_accuracy"]),
        "commission": rest(table["users_accuracy"]),
    }


def importances(meta: Mapping[str, Any], groups: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """Scores of the features by falling worth, the first 100; and the sum of each group's."""
    kind = {base: group for group, bases in groups.items() for base in bases}
    drop = meta["drop"]
    falling = sorted(drop, key=lambda n: (-drop[n]["mean"], n))
    top = drop[falling[0]]["mean"] or 1.0
    rows = [
        {
            "name": n,
            "group": kind.get(base_of(n), "other"),
            "score": 100 * drop[n]["mean"] / top,
            "std": 100 * (drop[n]["std"] or 0.0) / top,
            "drop": drop[n]["mean"],
        }
        for n in falling
    ]
    shares: dict[str, float] = {}
    for row in rows:
        shares[row["group"]] = shares.get(row["group"], 0.0) + row["score"]
    return {"repeats": meta["repeats"], "rows": rows, "groups": shares}


def radii(
    candidates: Sequence[str], chosen: Sequence[str], printed: Mapping[str, Sequence[str]]
) -> list[dict[str, Any]]:
    """Per radius [m]: which features survive, which could have, and which survive in the paper."""

    def at(names: Sequence[str]) -> dict[float, list[str]]:
        by_radius: dict[float, list[str]] = {}
        for name in names:
            scale = scale_of(name)
            if scale is not None and scale.kind == "r":
                by_radius.setdefault(scale.metres, []).append(base_of(name))
        return by_radius

    tried, ours = at(candidates), at(chosen)
    paper = {float(r): list(v) for r, v in printed.items()}
    return [
        {"radius": r, "ours": ours.get(r, []), "of": len(tried.get(r, [])), "paper": paper.get(r)}
        for r in sorted({*tried, *paper})
    ]


def _all_variants(plan: Plan) -> tuple[Variant, ...]:
    return variants(plan.config, plan.computed, plan.names)


def _forest(plan: Plan) -> Variant:
    return next(v for v in _all_variants(plan) if v.name == ALL)


TABLES = Comparison(
    columns=lambda plan: plan.computed,
    variants=_all_variants,
    pairs=lambda plan: comparisons(_all_variants(plan)),
    timed=_all_variants,
    ranked=_forest,
)
"""The plan's names are those that were chosen among all that it computes."""
STAGES = (*ELIMINATION, *TABLES.stages, *THINNING_STAGES, *TABLES.times)
