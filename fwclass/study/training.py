"""Training only: the stages up to the model, and its assessment on the test areas."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from fwclass.classify.context import context_from, with_context
from fwclass.classify.unsure import MEASURED_BELOW, share_below
from fwclass.conf import Config
from fwclass.errors import ConfigError, InputError
from fwclass.graph.context_training import MERGED, NEAR
from fwclass.graph.density import COUNT_TRAINING_ECHOES
from fwclass.graph.stage import Plan
from fwclass.graph.stages import CLASSIFYING, JUDGING, LEARNING
from fwclass.graph.training_rows import DRAW_SAMPLE, MERGE_SAMPLE, SAMPLE
from fwclass.report.accuracy_remarks import accuracy_remarks
from fwclass.report.labels import label_facts
from fwclass.run.runner import Runner, ancestors, require_all
from fwclass.run.tasks import Tasks
from fwclass.store.arrays import read_arrays
from fwclass.store.model_rows import ModelRows
from fwclass.store.run_store import Store
from fwclass.study.compare import compare_methods
from fwclass.study.select.sample import require_own_labels
from fwclass.study.select.trials import cross_validate
from fwclass.survey.layout import Layout
from fwclass.train.sample import Sample, thin
from fwclass.walk.models import with_model
from fwclass.walk.steps import plan_with_features, tasks_of, tasks_until_labels, until_tiles

NOTHING_TESTED = (
    "Nothing is left to test on: no labelled echo lies in a test area, or further than areas.gap from every training "
    "area: the accuracy is unknown: give smaller training areas."
)

OF_A_BASE = (
    "Nothing tells how good it is elsewhere: the base model's rows have no place, and the survey's are few: name areas "
    "of labels that do not train (areas.test)."
)


def training(config: Config, runner: Runner, assess: bool) -> dict[str, Any]:
    """Train the model of `config` on `runner`, and with `assess` judge it on the test areas; plain data.

    ``card`` is the model's; ``accuracy`` the figures of `figures`, or None where nothing was judged, and then
    ``cross_validation`` what `cross_validate` gives of a forest; ``ambiguous`` how many echoes of the tiles that were
    looked at lie in polygons of different classes; ``labels`` what `label_facts` says of them; ``unsure`` the share of
    the test echoes with a confidence below `MEASURED_BELOW`, None where nothing was judged; ``remarks`` what is to be
    said beside the accuracy, or why there is none. The parts are those of `classification`: a run in the same directory
    takes them over.
    """
    _check_labelled(config)
    if assess:
        _check_tested(config)
    plan, before = _begin(config, runner)
    config = plan.config
    layout = tested_layout(plan.layout) if assess else plan.layout  # known before anything is trained
    tasks = before + tasks_of(plan, LEARNING)
    require_all(runner, ancestors(tasks, [("train", "model")]))
    receipt = runner.store.receipt("train", "model")
    plain: dict[str, Any] = {"card": dict(receipt.meta["card"]) if receipt else {}, "accuracy": None}
    plain |= {"ambiguous": 0, "remarks": [], "cross_validation": None, "unsure": None}
    if assess:
        tasks += tasks_of(plan, CLASSIFYING) + tasks_of(replace(plan, tiled=layout), JUDGING)
        require_all(runner, ancestors(tasks, [("assess", "all")]))
        judged = runner.store.receipt("assess", "all")
        accuracy = judged.meta["accuracy"] if judged else None
        sentences = _remarks_beside(accuracy, plain["card"], plan) if accuracy else [NOTHING_TESTED]
        plain |= {"accuracy": accuracy, "remarks": sentences}
        plain |= {"unsure": share_below(judged.meta["automation"], MEASURED_BELOW) if judged and accuracy else None}
    if plain["accuracy"] is None and plan.base is not None:
        plain["remarks"] += [OF_A_BASE]
    elif (
        plain["accuracy"] is None
        and config.train.method == "forest"
        and not config.classify.refine.between
        and not plain["card"].get("context")
    ):
        try:
            plain["cross_validation"] = cross_validate(plan, runner, before)
        except InputError as fault:
            why = f"{fault.what}{fault.got and f' ({fault.got})'}"
            plain["remarks"] += [f"Nothing tells how good it is elsewhere, for it cannot be cross-validated: {why}."]
    judged_by = (runner.store.receipt(stage, "all") for stage in (("training", "assess") if assess else ("training",)))
    known = (runner.store.receipt(*name) for name in runner.outcomes if name[0] == "label")
    labelled = [receipt for receipt in known if receipt]
    plain["labels"] = label_facts([r for r in judged_by if r], (), config.plausibility, labelled)
    plain["remarks"] += (plain["labels"] or {}).get("remarks", [])
    plain["ambiguous"] = sum(int(r.meta.get("ambiguous", 0)) for r in labelled)
    return plain


def _remarks_beside(accuracy: Mapping[str, Any], card: Mapping[str, Any], plan: Plan) -> list[str]:
    config, cells = plan.config, (card.get("context") or {}).get("cells") or ()
    return accuracy_remarks(accuracy, config, config.features_asked, plan.layout.echoes, cells=cells)


def kept_rows(config: Config, store: Store, most: int) -> ModelRows:
    """Of every class at most so many of the survey's training rows, those with the smallest hashes."""
    config = with_model(config)
    receipt = store.receipt("train", "model")
    sample = Sample.from_arrays((), read_arrays(store.arrays_path("training", "all", SAMPLE))[0])
    if receipt and receipt.meta["card"].get("context"):
        near = read_arrays(store.arrays_path(MERGED, "all", SAMPLE))[0][NEAR]
        sample = replace(sample, X=with_context(sample.X, near))
    sample = thin(sample, most)
    codes, features = np.array([c.code for c in config.classes], np.uint8)[sample.y], len(config.features_asked)
    return ModelRows(sample.X[:, :features], codes, context_from(sample.X[:, features:]))


def comparison(config: Config, runner: Runner, methods: tuple[str, ...]) -> dict[str, Any]:
    """Several kinds of classifier on one sample and the same test echoes; see `compare_methods`. Nothing is thinned."""
    _check_labelled(config)
    _check_tested(config)
    require_own_labels(config)
    config = replace(config, thin=config.thin.model_copy(update={"rate": 1.0}))
    plan, tasks = _begin(config, runner)
    config = plan.config
    layout, names = tested_layout(plan.layout), config.features_asked
    sample = tasks_of(plan, (COUNT_TRAINING_ECHOES, DRAW_SAMPLE, MERGE_SAMPLE))
    columns = {*layout.columns(names).values(), "label", "tile"}
    parts = [("training", "all"), *((stage, t.key) for t in layout.tiles for stage in columns if stage != "tile")]
    require_all(runner, ancestors([*tasks, *sample], parts))
    return compare_methods(config, runner.store, layout, methods, runner.display.say)


def _begin(config: Config, runner: Runner) -> tuple[Plan, Tasks]:
    plan = until_tiles(plan_with_features(config), runner)
    return plan, tasks_until_labels(plan)


def _check_labelled(config: Config) -> None:
    if config.survey.model is not None:
        raise ConfigError(
            "the survey names a model, and one is to be trained",
            where=f"{config.path}: survey.model",
            got=config.survey.model,
            do="--set survey.model=null",
        )
    if config.survey.reference.kind == "none":
        raise ConfigError(
            "a model learns from labels, and the survey has none",
            where=f"{config.path}: survey.reference",
            expected="kind: source, cloud, polygons, echoes or corrections",
            got="none",
            do="name labelled files in survey.reference",
        )


def _check_tested(config: Config) -> None:
    if config.areas.trains_everywhere:
        raise ConfigError(
            "nothing is left to test on: all of the survey trains",
            where=f"{config.path}: areas.train",
            expected="training areas beside which something is left, to judge the model there",
            got="all",
            do="--no-assess; --leave-out, which judges it on each of survey.sources; or boxes in areas.train",
        )


def tested_layout(layout: Layout) -> Layout:
    """`layout` with only the tiles where something may be tested; `InputError` where there are none."""
    areas = layout.config.areas
    hidden, test = [b.grown(areas.gap) for b in areas.boxes("train")], areas.boxes("test")
    tiles = []
    for tile in layout.tiles:
        own = tile.box
        within = any(
            b.xmin <= own.xmin and b.ymin <= own.ymin and own.xmax <= b.xmax and own.ymax <= b.ymax for b in hidden
        )
        if not within and (not test or any(own.touches(b) for b in test)):
            tiles.append(tile)
    if not tiles:
        raise InputError(
            "no tile lies in a test area, or further than areas.gap from every training area",
            where="areas.test, areas.train",
            expected="areas beside which something is left to judge the model on",
            do="give others, or --no-assess",
        )
    return replace(layout, tiles=tuple(tiles))
