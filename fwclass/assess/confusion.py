"""The confusion matrix and the figures that follow from it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.model import ClassDef, class_index, code_index


def confusion(
    reference: NDArray[np.uint8], predicted: NDArray[np.uint8], classes: Sequence[ClassDef]
) -> NDArray[np.int64]:
    """Counts (classes, classes), rows reference, columns predicted; matrices of tiles add up to the survey's.

    Rows without a reference class, and rows whose prediction is none of the classes, are left out;
    `count_unclassified` counts the latter.
    """
    index, answer = class_index(reference, classes), code_index(predicted, classes)
    both = (index >= 0) & (answer >= 0)
    n = len(classes)
    return np.bincount(index[both].astype(np.int64) * n + answer[both], minlength=n * n).reshape(n, n)


def confusion_by_square(
    square: NDArray[np.int64], truth: NDArray, answer: NDArray, classes: int, counted: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The squares that occur among those of all rows, int64 (squares, 2), sorted; and in each the counts, int64
    (squares, classes, classes), of the rows' classes `truth` and `answer`, by index; of the rows `counted` alone."""
    squares, at = np.unique(square, axis=0, return_inverse=True)
    cell = (at.reshape(-1) * classes + truth.astype(np.int64)) * classes + answer
    cell = cell if counted is None else cell[counted]
    return squares, np.bincount(cell, minlength=len(squares) * classes**2).reshape(len(squares), classes, classes)


def count_unclassified(
    reference: NDArray[np.uint8], predicted: NDArray[np.uint8], classes: Sequence[ClassDef]
) -> NDArray[np.int64]:
    """Per reference class, rows whose prediction is none of the classes; int64 (classes,), additive."""
    index, answer = class_index(reference, classes), code_index(predicted, classes)
    return np.bincount(index[(index >= 0) & (answer < 0)], minlength=len(classes)).astype(np.int64)


def figures(
    matrix: NDArray[np.int64], names: Sequence[str], unclassified: NDArray[np.int64] | None = None
) -> dict[str, Any]:
    """Figures of a confusion matrix int64 (reference classes, classes) of the classes `names`: fractions, plain data
    for JSON; None where a figure is 0 / 0.

    With N counts, r_i rows, c_i columns and d_i the diagonal: overall accuracy sum d / N, producer's d_i /
    r_i, user's d_i / c_i, IoU d_i / (r_i + c_i - d_i), mean IoU over the classes that the reference has, and kappa (P_a
    - P_c) / (1 - P_c) with P_a = sum d / N and P_c = sum r_i c_i / N^2. For two classes, the first being
    ground, also the errors of He 2023: type I = ground lost, type II = other taken for ground, total.

    Rows that got none of the classes (`count_unclassified`, int64 (reference classes,)) belong to r_i and N: they are
    wrong in every figure but the user's accuracy. They are listed under ``unclassified`` where there are
    any.
    """
    matrix = np.asarray(matrix, np.int64)
    if matrix.shape != (len(names), len(names)):
        raise ValueError(f"a matrix of shape {matrix.shape} does not belong to {len(names)} classes")
    lost = np.zeros(len(names), np.int64) if unclassified is None else np.asarray(unclassified, np.int64)
    right, columns = np.diag(matrix), matrix.sum(axis=0)
    rows = matrix.sum(axis=1) + lost
    total = int(rows.sum())
    union = _shares(right, rows + columns - right)
    known = [v for v, n in zip(union, rows, strict=True) if v is not None and n]
    plain: dict[str, Any] = {
        "classes": list(names),
        "confusion": matrix.tolist(),
        "overall_accuracy": _share(int(right.sum()), total),
        "kappa": _kappa(right, rows, columns, total),
        "producers_accuracy": _shares(right, rows),
        "users_accuracy": _shares(right, columns),
        "iou": union,
        "mean_iou": sum(known) / len(known) if known else None,
    }
    if len(names) == 2:
        plain["type_i"] = _share(int(rows[0] - right[0]), int(rows[0]))
        plain["type_ii"] = _share(int(rows[1] - right[1]), int(rows[1]))
        plain["total_error"] = _share(total - int(right.sum()), total)
    if lost.any():
        plain["unclassified"] = lost.tolist()
    return plain


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _shares(parts: NDArray[np.int64], wholes: NDArray[np.int64]) -> list[float | None]:
    return [_share(int(p), int(w)) for p, w in zip(parts, wholes, strict=True)]


def _kappa(right: NDArray[np.int64], rows: NDArray[np.int64], columns: NDArray[np.int64], total: int) -> float | None:
    chance = sum(int(r) * int(c) for r, c in zip(rows, columns, strict=True))  # Python's integers do not overflow
    everything = total * total
    return _share(total * int(right.sum()) - chance, everything - chance)


def describe(figures: dict[str, Any]) -> str:
    """The figures as a table for a terminal: counts with the reference in rows, then percentages."""
    names = [str(n) for n in figures["classes"]]
    lost = figures.get("unclassified")
    columns = [*names, *(["none"] if lost else []), "producer's %"]
    body = [
        [name, *(f"{v:,}".replace(",", " ") for v in (*row, *([lost[i]] if lost else []))), percent(p)]
        for i, (name, row, p) in enumerate(zip(names, figures["confusion"], figures["producers_accuracy"], strict=True))
    ]
    gap = [""] * (1 + bool(lost))
    body.append(["user's %", *map(percent, figures["users_accuracy"]), *gap])
    body.append(["IoU %", *map(percent, figures["iou"]), *gap])
    lines = align([["reference \\ predicted", *columns], *body])
    width = max(map(len, lines))
    lines.insert(1, "-" * width)
    lines.insert(len(names) + 2, "-" * width)
    summary = [("overall accuracy", "overall_accuracy"), ("mean IoU", "mean_iou")]
    if "type_i" in figures:
        summary += [("type I", "type_i"), ("type II", "type_ii"), ("total error", "total_error")]
    totals = [f"{label} {percent(figures[key])} %".replace("- %", "-") for label, key in summary]
    kappa = figures["kappa"]
    totals.append(f"kappa {kappa:.3f}" if kappa is not None else "kappa -")
    return "\n".join([*lines, "", ", ".join(totals)])


def percent(value: float | None) -> str:
    """`value`, 0 to 1, as text in percent; a dash where there is none."""
    return "-" if value is None else f"{100 * value:.1f}"


def align(rows: list[list[str]]) -> list[str]:
    """Lines of a table of `rows`, the first column to the left and all others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.ljust(w) if k == 0 else cell.rjust(w) for k, (cell, w) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
