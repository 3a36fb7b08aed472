"""Shi 2019: what heights, selection, trimming and the fine layer each bring, and our figures as plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.assess.confusion import confusion_by_square, figures
from fwclass.assess.intervals import caution, class_gains, difference, intervals
from fwclass.classes import GROUND
from fwclass.conf import Config
from fwclass.conf.papers import paper
from fwclass.errors import ConfigError
from fwclass.graph.areas import rows_to_test
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import StageInputs
from fwclass.graph.training_rows import SAMPLE
from fwclass.grid import Box, millimetres, whole_millimetres
from fwclass.model import ClassDef, class_index
from fwclass.select.search import f_scores
from fwclass.study.papers.begin import features_like
from fwclass.study.papers.claims import judge_claims
from fwclass.study.papers.facts import Receipts, differences, heading, rows_by_class, times
from fwclass.study.papers.shi_claims import CLAIMS
from fwclass.study.papers.variants import VERSION, Comparison, make_variant
from fwclass.study.papers.work import TRAINING, Variant, spans
from fwclass.survey.layout import Layout
from fwclass.train.baselines.params import CompareParams
from fwclass.train.sample import Sample

HEIGHT = "height_above_ground"
WITHOUT, FILTERED, HEIGHTS = "without_heights", "iptd", "iptd_heights"
ALL, SVM, TRIMMED = "svm_all", "svm", "nn_svm"
LAYER_STAGES = ("coarse", "refine", "classify")
LAYERS = ("coarse", "fine", "coarse_boundary", "fine_boundary")


def require_layers(config: Config) -> None:
    """`ConfigError` without a second layer."""
    if not config.classify.refine.between:
        raise ConfigError(
            "--workflow shi2019 tells what a second layer brings, and there is none",
            where=f"{config.path}: classify.refine.between",
            expected="two classes",
            got="[]",
            do='--set "classify.refine.between=[building, vegetation]"',
        )


def variants(config: Config, names: tuple[str, ...]) -> tuple[Variant, ...]:
    """The steps of the ladder below the second layer; `names` are all features of the paper. Those of the ground filter
    are left out where no class is ground, or nothing would be left to tell apart."""
    four, squares = config.features_asked, (config.select.block, config.select.gap)
    flat, ground = [n for n in names if n != HEIGHT], ground_class(config)
    filtered = (
        ()
        if ground is None
        else (
            replace(make_variant(config, FILTERED, flat, method="rbf-svm"), filtered=ground),
            replace(make_variant(config, HEIGHTS, names, method="rbf-svm"), filtered=ground),
        )
    )
    steps = (
        make_variant(config, WITHOUT, flat, method="rbf-svm"),
        *filtered,
        make_variant(config, ALL, names, method="rbf-svm"),
        make_variant(config, SVM, four, method="rbf-svm"),
        make_variant(config, TRIMMED, four, method="rbf-svm"),
    )
    return tuple(replace(one, squares=squares) for one in steps)


def ground_class(config: Config) -> int | None:
    """Index of the class that a ground filter tells, of three and more; None without one."""
    ground = [k for k, c in enumerate(config.classes) if c.code == GROUND]
    return ground[0] if ground and len(config.classes) > 2 else None


def comparisons(variants: Sequence[Variant]) -> list[tuple[Variant, Variant]]:
    """Every step against the one before."""
    return list(zip(variants[1:], variants[:-1], strict=True))


def trimming(plan: Plan, one: Variant) -> CompareParams:
    """The settings that a variant learns by: all but the last are untrimmed."""
    compare: CompareParams = plan.config.compare
    trim = (compare.rbf_svm.trim if compare.rbf_svm.trim != "none" else "nearest") if one.name == TRIMMED else "none"
    return compare.model_copy(update={"rbf_svm": compare.rbf_svm.model_copy(update={"trim": trim})})


def columns(plan: Plan) -> tuple[str, ...]:
    """The paper's features, and those that the run's own classifiers decide by."""
    return tuple(dict.fromkeys((*features_of(plan.config), *plan.names)))


def features_of(config: Config) -> tuple[str, ...]:
    """The survey's features that the paper has too."""
    printed = paper("shi2019")["fscore"]
    return features_like(config, (*printed["kept"], *printed["dropped"]))


def _count_arguments(plan: Plan) -> dict[str, Any]:
    areas = plan.config.areas
    return {
        "classes": plan.config.classes,
        "train": areas.boxes("train"),
        "test": areas.boxes("test"),
        "gap": areas.gap,
        "edge": plan.config.papers.block,
    }


def count_layers(
    here: StageInputs,
    classes: tuple[ClassDef, ...],
    train: tuple[Box, ...],
    test: tuple[Box, ...],
    gap: float,
    edge: float,
) -> dict[str, Any]:
    """Confusion of both layers in every square of `edge` [m], over all test echoes and over those at the boundary."""
    table = here.own_rows()
    index = class_index(table["reference"], classes)
    rows = np.flatnonzero(rows_to_test(table, train, test, gap) & (index >= 0))
    of_code = np.zeros(256, np.int64)
    of_code[[c.code for c in classes]] = np.arange(len(classes))
    square = np.stack([millimetres(table[c][rows]) for c in ("x", "y")], axis=1) // whole_millimetres(
        edge, "papers.block"
    )
    answers = [of_code[table[column][rows]] for column in ("coarse_class", "classification")]
    cases = ((answer, some) for some in (None, table["boundary"][rows]) for answer in answers)
    counts = [confusion_by_square(square, index[rows], answer, len(classes), some) for answer, some in cases]
    return {
        "squares": counts[0][0].astype(int).tolist(),
        **{name: of_layer.tolist() for name, (_, of_layer) in zip(LAYERS, counts, strict=True)},
    }


def rank_features(here: StageInputs, names: tuple[str, ...]) -> dict[str, Any]:
    """F-score of every feature on the training rows."""
    sample = Sample.from_arrays(names, here.inputs.arrays(TRAINING, "all", SAMPLE)[0])
    return {"scores": dict(zip(names, f_scores(sample.X, sample.y).tolist(), strict=True))}


def layers_of(receipts: Receipts, names: Sequence[str], tiles: Sequence[str]) -> dict[str, Any]:
    """Figures of both layers with intervals, over all test echoes and at the boundary."""
    squares: dict[tuple[int, int], dict[str, NDArray[np.int64]]] = {}
    for key in tiles:
        meta = receipts["paper-layers", key].meta
        for k, (a, b) in enumerate(meta["squares"]):
            matrices = squares.setdefault((a, b), {n: np.zeros((len(names), len(names)), np.int64) for n in LAYERS})
            for name in LAYERS:
                matrices[name] += np.array(meta[name][k], np.int64)
    blocks = {name: np.array([s[name] for s in squares.values()]) for name in LAYERS}
    layers: dict[str, Any] = {}
    for name, of in blocks.items():
        layers[name] = {**figures(of.sum(axis=0), list(names)), "intervals": intervals(of)} if of.any() else None
    gains = {}
    for name, first, second in (("all", "coarse", "fine"), ("boundary", "coarse_boundary", "fine_boundary")):
        gains[name] = _gain(blocks[first], blocks[second]) if blocks[first].any() else None
    of_class = None
    if blocks["coarse_boundary"].any():
        gained = class_gains(blocks["coarse_boundary"], blocks["fine_boundary"])
        of_class = dict(zip(names, gained, strict=True))
    return {**layers, "gains": gains, "class_gains": of_class, "blocks": len(squares)}


def _gain(first: NDArray[np.int64], second: NDArray[np.int64]) -> dict[str, Any] | None:
    gain = difference(first, second)
    if gain is None:
        return None
    return {"blocks": gain["blocks"], "caution": caution(gain["blocks"]), **spans(gain)}


def facts(
    config: Config,
    printed: Mapping[str, Any],
    report: Mapping[str, Any],
    variants: Sequence[Variant],
    layout: Layout,
    receipts: Receipts,
) -> dict[str, Any]:
    """Everything that the page tells, as plain data."""
    classes = [c.name for c in config.classes]
    scores = receipts["paper-fscore", "all"].meta["scores"]
    gathered: dict[str, Any] = {
        **heading("shi2019", config, printed, ("combinations", "boundary", "algorithms", "fscore")),
        "classes": [{"name": c.name, "code": c.code, "codes": list(c.codes)} for c in config.survey.classes],
        "rows": rows_by_class(receipts, variants[0], classes),
        "areas": report["areas"],
        "whole": report["accuracy"],
        "refine": config.classify.refine.model_dump(mode="json"),
        "ground": config.ground.method,
        "heights": config.terrain.height,
        "scaling": config.compare.scaling,
        "steps": {v.name: _step(receipts, v, classes) for v in variants},
        "differences": differences(receipts, comparisons(variants)),
        "layers": layers_of(receipts, classes, [t.key for t in layout.tiles]),
        "fscores": sorted(scores.items(), key=lambda one: -one[1]),
        "times": times(receipts, variants),
        "second_layer": (report["training"] or {}).get("second_layer"),
        "seconds": {s["name"]: s["seconds"] for s in report["stages"] if s["name"] in LAYER_STAGES},
    }
    return {**gathered, "claims": judge_claims(printed["claims"], CLAIMS, gathered)}


def _step(receipts: Receipts, one: Variant, names: Sequence[str]) -> dict[str, Any]:
    answers, model = receipts["paper-judged", one.name].meta, receipts["paper-model", one.name].meta
    return {
        **figures(np.array(answers["matrix"], np.int64)[: one.classes], list(names)),
        "intervals": answers["intervals"],
        "features": list(one.features),
        "vectors": model["vectors"],
        "params": model["params"],
        "notes": model["notes"],
    }


def _all_variants(plan: Plan) -> tuple[Variant, ...]:
    return variants(plan.config, features_of(plan.config))


TABLES = Comparison(
    columns,
    _all_variants,
    pairs=lambda plan: comparisons(_all_variants(plan)),
    timed=_all_variants,
    filtered=True,
    compare=trimming,
)
COUNT_LAYERS = Stage(
    "paper-layers",
    VERSION,
    "tile",
    "echo",
    count_layers,
    arguments=_count_arguments,
    own=("x", "y", "reference", "coarse_class", "boundary", "classification"),
)
RANK_FEATURES = Stage(
    "paper-fscore",
    VERSION,
    "survey",
    "row",
    rank_features,
    arguments=lambda plan: {"names": columns(plan)},
    after=(TRAINING,),
    needs=lambda plan, part: ((TRAINING, "all"),),
)
STAGES = (*TABLES.stages, COUNT_LAYERS, RANK_FEATURES, *TABLES.times)
