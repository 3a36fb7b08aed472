"""Where labels are: counts of a tile's echoes by class, training box and test area, and what is to be said of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.classes import counts_of
from fwclass.grid import Box, millimetres
from fwclass.model import ClassDef, class_index
from fwclass.schema import Table

FEW = 100
"""Training rows of a class below which its accuracy is a matter of luck."""

LOPSIDED = 100
"""Times that the largest class may have more training rows than the smallest."""

Counts = Mapping[str, Any]


def count_labelled(
    table: Table,
    tested: NDArray[np.bool_],
    train: Sequence[Box],
    classes: Sequence[ClassDef],
    corrected: NDArray[np.bool_] | None = None,
) -> Counts:
    """Counts of one tile.

    Parameters
    ----------
    table : x, y [m] and reference of the tile's echoes.
    tested : bool (rows,), the echo lies in a test area.
    train : the training boxes.
    corrected : bool (rows,), the echo trains wherever it lies.

    Returns
    -------
    ``echoes``; ``unlabelled`` (code 0); ``other`` {code: n} of codes that no class counts; ``labelled`` and ``test``
    [class]; ``train`` [class], an echo in two boxes once; ``boxes`` [box][class]; ``nearest``, distance of the nearest
    labelled tested echo to a training box [m], None without one.
    """
    index = class_index(table["reference"], classes)
    n = len(classes)
    inside = [box.contains(table["x"], table["y"]) for box in train]
    anywhere = np.any(inside, axis=0) if inside else np.zeros(table.rows, bool)
    if corrected is not None:
        anywhere |= corrected
    codes, counts = np.unique(table["reference"][index < 0], return_counts=True)
    other = {str(c): int(k) for c, k in zip(codes.tolist(), counts.tolist(), strict=True)}
    judged = tested & (index >= 0)
    return {
        "echoes": table.rows,
        "unlabelled": other.pop("0", 0),
        "other": other,
        "labelled": by_class(index, n),
        "train": by_class(index[anywhere], n),
        "boxes": [by_class(index[mask], n) for mask in inside],
        "test": by_class(index[judged], n),
        "nearest": nearest_box(table["x"][judged], table["y"][judged], train),
    }


def count_training(
    table: Table, chosen: NDArray[np.bool_], train: Sequence[Box], classes: Sequence[ClassDef]
) -> Counts:
    """Counts of the rows of one tile that train: ``train`` [class] and ``boxes`` [box][class], as `count_labelled` has
    them."""
    some = table.take(chosen)
    index = class_index(some["reference"], classes)
    boxes = [by_class(index[box.contains(some["x"], some["y"])], len(classes)) for box in train]
    return {"train": by_class(index, len(classes)), "boxes": boxes}


def by_class(index: NDArray[np.int16], n: int) -> list[int]:
    """Rows [count] of each of `n` classes; `index` int16 (rows,), negative for none."""
    return [int(v) for v in np.bincount(index[index >= 0], minlength=n)]


def nearest_box(x: NDArray[np.float64], y: NDArray[np.float64], boxes: Sequence[Box]) -> float | None:
    """Least distance [m] of a point to a box, 0 inside; None without points or boxes."""
    if not len(x) or not boxes:
        return None
    mx, my = millimetres(x), millimetres(y)
    least = math.inf
    for box in boxes:
        x0, y0, x1, y1 = (int(v) for v in millimetres(np.array(box.bounds)))
        across = np.maximum(np.maximum(x0 - mx, mx - x1), 0).astype(np.float64)
        along = np.maximum(np.maximum(y0 - my, my - y1), 0).astype(np.float64)
        least = min(least, float(np.hypot(across, along).min()))
    return least / 1000


def total(tiles: Iterable[Counts], boxes: int, classes: int) -> Counts:
    """The sum of all tiles, with the same keys; ``nearest`` is the least."""
    counts = list(tiles)
    nearest = [c["nearest"] for c in counts if c["nearest"] is not None]
    other: dict[str, int] = {}
    for one in counts:
        for code, n in one["other"].items():
            other[code] = other.get(code, 0) + n
    sums = {k: _sum((c[k] for c in counts), (classes,)) for k in ("labelled", "train", "test")}
    return {
        "echoes": sum(c["echoes"] for c in counts),
        "unlabelled": sum(c["unlabelled"] for c in counts),
        "other": dict(sorted(other.items(), key=lambda item: int(item[0]))),
        **sums,
        "boxes": _sum((c["boxes"] for c in counts), (boxes, classes)),
        "nearest": min(nearest, default=None),
    }


def total_training(tiles: Iterable[Counts], boxes: int, classes: int) -> Counts:
    """The sum of what `count_training` gave."""
    counts = list(tiles)
    return {
        "train": _sum((c["train"] for c in counts), (classes,)),
        "boxes": _sum((c["boxes"] for c in counts), (boxes, classes)),
    }


def _sum(arrays: Iterable[Any], shape: tuple[int, ...]) -> Any:
    sums = np.zeros(shape, np.int64)
    for array in arrays:
        sums += counts_of(array, shape, "counts of labels")
    return sums.tolist()


def label_remarks(
    whole: Counts,
    rows: Counts | None,
    tiles: Mapping[str, Counts],
    classes: Sequence[ClassDef],
    train: Sequence[Box],
    test: Sequence[Box],
    gap: float,
) -> list[str]:
    """What the user should know of the labels, as sentences.

    Parameters
    ----------
    whole : `total` of the survey.
    rows : `total_training`, None where nothing was trained.
    tiles : what `count_training` gave, by tile.
    """
    names = [c.name for c in classes]
    return [
        *_about_codes(whole, classes),
        *_about_classes(whole, rows, names),
        *_about_tiles(tiles, names),
        *_about_boxes(whole, train),
        *_about_areas(whole, train, test, gap),
    ]


def _about_codes(whole: Counts, classes: Sequence[ClassDef], others: frozenset[int] = frozenset()) -> list[str]:
    """Classes that no echo of the survey has, but for `others`, with the codes that are there instead."""
    lacking = [c for c, n in zip(classes, whole["labelled"], strict=True) if n == 0 and c.code not in others]
    if not lacking:
        return []
    wanted = ", ".join(f"{c.name!r} (codes {', '.join(map(str, c.codes))})" for c in lacking)
    there = ", ".join(f"{code} ({n} echoes)" for code, n in whole["other"].items())
    instead = f"; the reference also has the codes {there}, which no class counts" if there else ""
    flagged = ""
    if len(lacking) == len(classes):
        flagged = (
            " Echoes that their file flags as withheld or synthetic count for none (`fwclass info` counts them, "
            "--set read.use_flagged=true takes them)."
        )
    return [f"No echo is labelled {wanted}{instead}: check survey.classes and survey.reference.{flagged}"]


def lacking(
    whole: Counts, classes: Sequence[ClassDef], train: Sequence[Box], others: frozenset[int] = frozenset()
) -> list[str]:
    """Why nothing can be learned from the labels, as sentences: classes and training areas without a labelled echo.

    Parameters
    ----------
    whole : `total` of the survey.
    others : codes of classes that other rows teach. Where there are any, training areas may be without labels.
    """
    without = [c for c, n in zip(classes, whole["train"], strict=True) if n == 0 and c.code not in others]
    sentences = _about_codes(whole, classes, others) + ([] if others else _about_boxes(whole, train))
    if without:
        has = ", ".join(f"{c.name} {n:,}" for c, n in zip(classes, whole["train"], strict=True) if n) or "none"
        named = ", ".join(f"{c.name!r}" for c in without)
        sentences.insert(0, f"No labelled echo of {named} lies in a training area (there are: {has}).")
    return sentences


def _about_classes(whole: Counts, rows: Counts | None, names: Sequence[str]) -> list[str]:
    train = rows["train"] if rows else whole["train"]
    sentences = []
    for name, n, tests in zip(names, train, whole["test"], strict=True):
        if n == 0 and tests:
            sentences.append(f"Class {name!r} occurs in the test areas ({tests}) and has no training row.")
        elif 0 < n < FEW:
            sentences.append(
                f"Class {name!r} has {n} training row{'s' * (n > 1)}: fewer than {FEW} tell little of a class."
            )
        if n and not tests:
            sentences.append(f"Class {name!r} does not occur in the test areas: nothing is known of its accuracy.")
    some = {name: n for name, n in zip(names, train, strict=True) if n}
    if some and max(some.values()) > LOPSIDED * min(some.values()):
        most, least = max(some, key=lambda k: some[k]), min(some, key=lambda k: some[k])
        sentences.append(
            f"Class {most!r} has {some[most]} training rows and {least!r} {some[least]}, more than {LOPSIDED} to 1: "
            f"label more of {least!r}, or lower train.samples_per_class."
        )
    return sentences


def _about_tiles(tiles: Mapping[str, Counts], names: Sequence[str]) -> list[str]:
    trained = {key: c["train"] for key, c in tiles.items() if any(c["train"])}
    sentences = []
    for k, name in enumerate(names):
        where = [key for key, train in trained.items() if train[k]]
        if len(where) == 1 and len(trained) > 1:
            sentences.append(f"All training rows of class {name!r} come from one tile, {where[0]}.")
    return sentences


def _about_boxes(whole: Counts, train: Sequence[Box]) -> list[str]:
    return [
        f"Training area {_text(box)} has no labelled echo."
        for box, counts in zip(train, whole["boxes"], strict=True)
        if not any(counts)
    ]


def _about_areas(whole: Counts, train: Sequence[Box], test: Sequence[Box], gap: float) -> list[str]:
    sentences = [
        f"Test area {_text(t)} overlaps training area {_text(b)}: what lies in it or within {gap:g} m is not tested."
        for t in test
        for b in train
        if t.touches(b)
    ]
    nearest = whole["nearest"]
    if not any(whole["test"]):
        sentences.append("No labelled echo lies in a test area: the accuracy is unknown.")
    elif nearest is not None and nearest < gap:
        sentences.append(f"A tested echo lies {nearest:.3f} m from a training area, nearer than areas.gap = {gap:g} m.")
    return sentences


def _text(box: Box) -> str:
    return "[" + ", ".join(f"{v:g}" if abs(v) < 1e5 else f"{v:.1f}" for v in box.bounds) + "]"
