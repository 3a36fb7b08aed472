"""Several kinds of classifier side by side: one sample, the same test echoes, accuracy and time."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.assess.blocks import BlockCounts
from fwclass.assess.confusion import confusion, figures
from fwclass.assess.remarks import pure_share
from fwclass.classify.shares import answer
from fwclass.conf import Config
from fwclass.graph.corrections import corrections_in
from fwclass.graph.corrections import untaught_rows as judged_rows
from fwclass.graph.machine_search import folds_of_squares
from fwclass.graph.training_rows import survey_sample
from fwclass.model import Model, class_index, sample_matrix
from fwclass.report.accuracy_remarks import accuracy_remarks
from fwclass.run.inputs import PartInputs
from fwclass.schema import IDENTITY
from fwclass.store.run_store import Store
from fwclass.survey.layout import Layout
from fwclass.train.baselines.prepare import fewer
from fwclass.train.baselines.stage import fit_classifier

WARM_ROWS = 200
"""Rows that every classifier is trained on once before the clock runs, so that it measures no compilation."""

_PLACE = dict.fromkeys((*IDENTITY, "x", "y", "z"), "tile")


def cpu_time(work: Callable[[], Any]) -> tuple[float, Any]:
    """CPU seconds of this process, and what `work` gave."""
    began = time.process_time()
    result = work()
    return time.process_time() - began, result


def compare_methods(
    config: Config, store: Store, layout: Layout, methods: Sequence[str], say: Callable[[str], None]
) -> dict[str, Any]:
    """Every one of `methods` trained on the survey's sample and judged on the echoes tested in `layout`'s tiles.

    Times are CPU seconds of one thread: of training, and of classifying from ready features. Plain data.
    """
    inputs, names, classes = PartInputs(store), config.features_asked, config.classes
    sample, places = survey_sample(inputs, names), folds_of_squares(config.select.block, config.select.gap)
    models: dict[str, Model] = {}
    spent: dict[str, list[float]] = {}
    for method in methods:
        say(f"training     {method}")
        params = config.train.model_copy(update={"method": method})
        warm = fit_classifier(fewer(sample, WARM_ROWS), params, config.compare, classes, judged=False)
        answer(sample.X[:64], warm)
        work = partial(fit_classifier, sample, params, config.compare, classes, places, judged=False)
        seconds, models[method] = cpu_time(work)
        spent[method] = [seconds, 0.0]
    matrices = {m: np.zeros((len(classes), len(classes)), np.int64) for m in methods}
    columns, blocks = {**layout.columns(names), **_PLACE, "reference": "label"}, []
    for number, tile in enumerate(layout.tiles, 1):
        table, corrections = inputs.rows(tile.key, columns), corrections_in(inputs, layout, tile.key)
        rows = judged_rows(table, corrections, config.areas, config.label.max_move)
        rows &= class_index(table["reference"], classes) >= 0
        if not rows.any():
            continue
        table = table.take(rows)
        X = sample_matrix(table, names, tile.key)
        for method, model in models.items():
            seconds, (winner, _) = cpu_time(partial(answer, X, model))
            spent[method][1] += seconds
            matrices[method] += confusion(table["reference"], model.codes[winner], classes)
            if method == methods[0]:
                place = (table["x"], table["y"], table["reference"], model.codes[winner])
                blocks.append(BlockCounts.of(*place, classes, config.assess.block))
        say(f"classified   {number} of {len(layout.tiles)} tiles")
    judged = int(next(iter(matrices.values())).sum())
    return {
        "survey": config.survey.name,
        "features": list(names),
        "echoes": judged,
        "remarks": _remarks(config, names, layout, blocks, matrices[methods[0]]) if judged else [],
        "samples": dict(zip((c.name for c in classes), sample.counts.tolist(), strict=True)),
        "classifiers": [
            _summary(m, models[m], matrices[m], spent[m], judged, [c.name for c in classes]) for m in methods
        ],
    }


def _remarks(
    config: Config, names: tuple[str, ...], layout: Layout, blocks: list[BlockCounts], matrix: NDArray[np.int64]
) -> list[str]:
    """What stands beside the accuracy of a run, and so beside every one of the table."""
    counts = BlockCounts.merged(blocks, len(config.classes)).counts
    tested = {"confusion": matrix, "blocks": len(counts), "pure_share": pure_share(counts)}
    alone = ["the classifiers are compared without the second layer that the settings name (classify.refine)"]
    return [*alone[: bool(config.classify.refine.between)], *accuracy_remarks(tested, config, names, layout.echoes)]


def _summary(
    method: str, model: Model, matrix: Any, spent: list[float], judged: int, names: list[str]
) -> dict[str, Any]:
    return {
        "method": method,
        "kind": model.kind,
        "params": model.card["params"],
        "samples": model.card["samples"],
        "notes": list(model.card.get("notes", ())),
        "figures": figures(matrix, names) if judged else None,
        "train_seconds": round(spent[0], 3),
        "classify_seconds": round(spent[1], 3),
        "classify_us_per_echo": round(1e6 * spent[1] / judged, 3) if judged else None,
        "bytes": int(sum(getattr(model, n).nbytes for n in model.layout)),
    }


def describe(result: dict[str, Any]) -> str:
    """The table for a terminal."""
    rows = [["", "overall %", "kappa", "mean IoU %", "training s", "classifying s", "us/echo", "MB"]]
    for one in result["classifiers"]:
        figures_of_one = one["figures"]
        shown = ["-"] * 3
        if figures_of_one:
            kappa = figures_of_one["kappa"]
            shown = [
                f"{100 * figures_of_one['overall_accuracy']:.2f}",
                "-" if kappa is None else f"{kappa:.4f}",
                f"{100 * figures_of_one['mean_iou']:.2f}",
            ]
        per = one["classify_us_per_echo"]
        rows.append(
            [
                one["method"],
                *shown,
                f"{one['train_seconds']:.2f}",
                f"{one['classify_seconds']:.2f}",
                "-" if per is None else f"{per:.2f}",
                f"{one['bytes'] / 1e6:.1f}",
            ]
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        "  ".join(c.ljust(w) if k == 0 else c.rjust(w) for k, (c, w) in enumerate(zip(row, widths, strict=True)))
        for row in rows
    ]
    total = ", ".join(f"{name} {n:,}" for name, n in result["samples"].items())
    of: dict[str, list[str]] = {}
    for one in result["classifiers"]:
        for note in one["notes"]:
            of.setdefault(note, []).append(one["method"])
    every = len(result["classifiers"])
    notes = [note if len(who) == every else f"{', '.join(who)}: {note}" for note, who in of.items()]
    head = f"{result['echoes']:,} test echoes, {len(result['features'])} features; trained on {total}"
    remarks = [f"remark: {text}" for text in result["remarks"]]
    return "\n".join([head, "CPU seconds of one thread", *lines, *notes, *remarks])
