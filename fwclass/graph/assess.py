"""Stages that judge: confusion counts and distributions of every tile's echoes in the test areas, and of all."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.assess.blocks import BlockCounts
from fwclass.assess.confusion import confusion, count_unclassified, figures
from fwclass.assess.distribution import Histograms, pack, summary
from fwclass.assess.intervals import intervals
from fwclass.assess.remarks import pure_share
from fwclass.assess.stage import ASSESS_VERSION, CONFUSION_VERSION
from fwclass.classes import GROUND, counts_of
from fwclass.classify.kept import Kept
from fwclass.classify.unsure import PERCENT, percent_of
from fwclass.conf.sections import AreasSection
from fwclass.graph.areas import IDENTITY_AND_PLACE, has_reference, rows_to_test
from fwclass.graph.corrections import CORRECTIONS, corrections_around, corrections_of, reach_around, untaught_rows
from fwclass.graph.kept import deciding_column, kept_argument
from fwclass.graph.label_places import by_place, draw_tested, merge_tested, offset_of_tested
from fwclass.graph.objects import judged_objects, objects_of_tiles, write_cells
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.model import ClassDef, class_index, code_index
from fwclass.schema import Table
from fwclass.store.arrays import write_arrays

COUNTS = "counts"
BLOCKS = "assess.parquet"
"""A delivery's copy of the counts by block, by which later ones are held against it."""

FAN_2013 = ("echo_number", "amplitude", "backscatter", "width")
"""Of the seven features of Fan 2013 those that no neighbourhood is needed for; the report sets their distribution
beside the paper's, used by the forest or not."""


def feature_columns(plan: Plan) -> tuple[str, ...]:
    """The classifier's features, those that are computed besides, and what else Fan 2013 has."""
    also = (n for n in FAN_2013 if n in plan.providers)
    return tuple(dict.fromkeys((*plan.names, *plan.config.features.also, *also)))


def count_tile(
    here: StageInputs,
    names: tuple[str, ...],
    areas: AreasSection,
    block: float,
    classes: tuple[ClassDef, ...],
    objects: tuple[int, ...],
    cell: float,
    reach: float | None = None,
    kept: Kept | None = None,
    by_place: bool = False,
) -> Result:
    """Confusion counts (whole, and by blocks of edge `block` [m]) and feature histograms of a tile's echoes in the test
    areas, and cells of edge `cell` [m] of the classes whose `objects` are judged; the ground filter's counts of all its
    labelled echoes, for it learns from none.

    `reach`: corrections lie within it of their echo [m]; None where no model of this run learned from any.
    Echoes that are `kept` as the source has them are no answers: they are left out, and counted where they have a
    reference. `by_place`: some of the labels are kept, to be held against the answers.
    """
    table = here.rows()
    filtered = ground_counts(table, classes)
    if reach is None or not here.parts(CORRECTIONS):
        table = table.take(rows_to_test(table, areas.boxes("train"), areas.boxes("test"), areas.gap))
    else:
        table = table.take(untaught_rows(table, corrections_of(here), areas, reach))
    stay = kept.rows(table["source_class"]) if kept else np.zeros(table.rows, bool)
    left_out = int((class_index(table["reference"], classes) >= 0)[stay].sum())
    table = table.take(~stay)
    matrix = confusion(table["reference"], table["classification"], classes)
    lost = count_unclassified(table["reference"], table["classification"], classes)
    places, counts = pack(table.select(names), table["reference"], classes)
    blocks = BlockCounts.of(table["x"], table["y"], table["reference"], table["classification"], classes, block)
    arrays = {"places": places, "counts": counts, "place": blocks.place, "blocks": blocks.counts}
    write_arrays(here.directory / COUNTS, arrays | (draw_tested(table, classes) if by_place else {}))
    if objects:
        write_cells(here, table, classes, objects, cell)
    sure = by_confidence(table, classes).tolist()
    facts = {"matrix": matrix.tolist(), "lost": lost.tolist(), "ground": filtered.tolist(), "sure": sure}
    return {**facts, **({"kept": left_out} if kept else {})}


MILLIONTHS = 1_000_000
"""Of a confidence of 1: sums of whole numbers do not depend on the order of what is added."""

STEPS = 10
"""Steps of the confidence that reliability is told by (Guo et al. 2017)."""


def by_confidence(table: Table, classes: tuple[ClassDef, ...]) -> NDArray[np.int64]:
    """(3, 101) labelled echoes by the confidence of their class [%]: wrong ones, right ones, and the sum of their
    confidences [1/MILLIONTHS]. Echoes left without a class are none of them."""
    reference, answer = class_index(table["reference"], classes), code_index(table["classification"], classes)
    known = (reference >= 0) & (answer >= 0) & np.isfinite(table["confidence"])
    confidence, percent = table["confidence"][known], percent_of(table["confidence"][known])
    cells = PERCENT * (reference[known] == answer[known]) + percent
    counts = np.bincount(cells, minlength=2 * PERCENT).reshape(2, PERCENT).astype(np.int64)
    total = np.zeros(PERCENT, np.int64)
    np.add.at(total, percent, np.rint(confidence.astype(np.float64) * MILLIONTHS).astype(np.int64))
    return np.concatenate([counts, total[None]])


def automation(counts: NDArray[np.int64]) -> list[list[float]]:
    """(confidence, share of the echoes that are as sure or surer, share of these that are right), by ascending
    confidence; empty without an echo. `counts` as `by_confidence` gives them."""
    total = int(counts[:2].sum())
    left = counts[:2, ::-1].cumsum(axis=1)[:, ::-1]
    rows = [(k, int(left[:, k].sum()), int(left[1, k])) for k in range(PERCENT)]
    return [[k / 100, some / total, right / some] for k, some, right in rows if some] if total else []


def reliability(counts: NDArray[np.int64]) -> dict[str, Any] | None:
    """Whether the confidence is the share that is right; None without an echo. `counts` as `by_confidence` gives them.

    Mean ``confidence`` and ``right`` share; ``steps`` of a tenth each: (mean confidence, share of the echoes, share of
    these that are right); ``error``, the mean distance of the last and the first over all echoes: the expected
    calibration error of Guo et al. 2017.
    """
    total = int(counts[:2].sum())
    if not total:
        return None
    summed = np.add.reduceat(counts, np.arange(0, 100, 100 // STEPS), axis=1)  # the last step holds 100 % too
    rows = [(w + r, r, s) for w, r, s in summed.T.tolist() if w + r]
    steps = [(s / MILLIONTHS / n, n / total, r / n) for n, r, s in rows]
    return {
        "confidence": int(counts[2].sum()) / MILLIONTHS / total,
        "right": int(counts[1].sum()) / total,
        "error": sum(share * abs(mean - right) for mean, share, right in steps),
        "steps": steps,
    }


def ground_counts(table: Table, classes: tuple[ClassDef, ...]) -> NDArray[np.int64]:
    """(2, 2) labelled echoes: the reference says ground or not (rows), the filter says so or not; 0 where no class is
    ground."""
    index = class_index(table["reference"], classes)
    ours = [k for k, one in enumerate(classes) if one.code == GROUND]
    if not ours:
        return np.zeros((2, 2), np.int64)
    known = index >= 0
    cells = 2 * ~np.isin(index[known], ours) + ~table["ground"][known]
    return np.bincount(cells, minlength=4).reshape(2, 2).astype(np.int64)


def assess_survey(
    here: StageInputs,
    names: tuple[str, ...],
    classes: tuple[ClassDef, ...],
    quantiles: tuple[float, ...],
    block: float,
    objects: Mapping[str, Any],
    by_place: bool = False,
) -> Result:
    """Figures over all test areas with their intervals, those of objects, and the distribution of the features by
    class.

    What it keeps of the blocks, of edge `block` [m], serves to compare two runs. `objects` is nothing where no class
    has any, and else what `objects_of_tiles` judges by. `by_place`: labels are held against the answers.
    """
    n = len(classes)
    matrix, lost, filtered = np.zeros((n, n), np.int64), np.zeros(n, np.int64), np.zeros((2, 2), np.int64)
    parts, histograms, sure, left_out = [], Histograms(names, n), np.zeros((3, PERCENT), np.int64), 0
    tested: dict[str, NDArray] = {}
    for tile in here.parts("confusion"):
        meta = here.inputs.meta("confusion", tile)
        matrix += counts_of(meta["matrix"], (n, n), "confusion matrices")
        lost += counts_of(meta["lost"], (n,), "confusion matrices")
        filtered += np.array(meta["ground"], np.int64)
        sure += np.array(meta["sure"], np.int64)
        left_out += meta.get("kept", 0)
        arrays, _ = here.inputs.arrays("confusion", tile, COUNTS)
        histograms.add(arrays["places"], arrays["counts"])
        tested = merge_tested(tested, arrays) if by_place else {}
        # a survey has many tiles: copies, as what is read of one lies in one piece of memory
        parts.append(BlockCounts(arrays["place"].copy(), arrays["blocks"].copy()))
    blocks = BlockCounts.merged(parts, n)
    write_arrays(here.directory / COUNTS, {"place": blocks.place, "blocks": blocks.counts})
    called = [c.name for c in classes]
    accuracy = figures(matrix, called, lost) | {
        "intervals": intervals(blocks.counts),
        "blocks": int(blocks.counts.any(axis=(1, 2)).sum()),
        "pure_share": pure_share(blocks.counts),
        **({"kept": left_out} if left_out else {}),
        **({"objects": objects_of_tiles(here, "confusion", blocks.counts, block, called, objects)} if objects else {}),
    }
    return {
        "accuracy": accuracy if matrix.any() or lost.any() else None,
        "distribution": summary(histograms.by_column(), called, quantiles),
        "ground": figures(filtered, ("ground", "other")) if filtered.any() else None,
        "automation": automation(sure),
        "reliability": steps | {"without_class": int(lost.sum())} if (steps := reliability(sure)) else None,
        **({"offset": offset_of_tested(tested, n)} if by_place else {}),
    }


def _learned_around(plan: Plan, tile: Any) -> Mapping[str, Any]:
    """As `reach_around`; nothing where a given model is judged, which has not learned from corrections."""
    return reach_around(plan, tile) if plan.config.survey.model is None else {}


_ANSWERS = ("reference", "classification", "confidence", "ground")

COUNT_CONFUSION = Stage(
    "confusion",
    CONFUSION_VERSION,
    "tile",
    "echo",
    count_tile,
    when=has_reference,
    arguments=lambda plan: {
        "names": feature_columns(plan),
        "areas": plan.config.areas,
        "block": plan.config.assess.block,
        "classes": plan.config.classes,
        "objects": judged_objects(plan),
        "cell": plan.config.assess.objects.step,
        **kept_argument(plan),
        **by_place(plan),
    },
    each=_learned_around,
    own=lambda plan: (*IDENTITY_AND_PLACE, "z", *feature_columns(plan), *_ANSWERS, *deciding_column(plan)),
    after=(CORRECTIONS,),
    needs=lambda plan, tile: corrections_around(plan, tile) if plan.config.survey.model is None else (),
    named=True,
    check=True,
)
ASSESS = Stage(
    "assess",
    ASSESS_VERSION,
    "survey",
    "echo",
    assess_survey,
    when=has_reference,
    arguments=lambda plan: {
        "names": feature_columns(plan),
        "classes": plan.config.classes,
        "quantiles": plan.config.assess.quantiles,
        "block": plan.config.assess.block,
        "objects": {"params": plan.config.assess.objects, "tile": plan.config.tile.size}
        if judged_objects(plan)
        else {},
        **by_place(plan),
    },
    keyed=lambda plan: {"areas": plan.config.areas},
    after=("confusion",),
    needs=lambda plan, part: [("confusion", t.key) for t in plan.layout.tiles],
    check=True,
)
