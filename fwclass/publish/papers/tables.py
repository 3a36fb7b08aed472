"""Tables that all papers' pages have: confusion matrices beside the paper's, accuracies with their intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fwclass.publish.sections import accuracy as matrix_of
from fwclass.publish.sections import number, percent

VERDICTS = {"holds": "badge", "does not hold": "badge bad", "undecided": "badge open", "not comparable": "badge open"}
"""Style of every verdict."""

MINUS = "\u2212"


def seconds_of(value: float | None) -> str:
    """Seconds as text, with as many decimals as count."""
    if value is None:
        return "–"
    digits = sum(value < edge for edge in (100, 1, 0.1))
    return f"{value:.{digits}f} s"


def ours(result: Mapping[str, Any]) -> dict[str, str]:
    """Overall accuracy, kappa and mean IoU, with their intervals where known."""
    spans = result.get("intervals") or {}
    texts = {}
    for key, digits in (("overall_accuracy", 1), ("mean_iou", 1), ("kappa", 3)):
        value, span = result.get(key), spans.get(key)
        scale = 1 if key == "kappa" else 100
        texts[key] = "–" if value is None else f"{scale * value:.{digits}f}"
        texts[f"{key}_span"] = f"{scale * span[0]:.{digits}f}–{scale * span[1]:.{digits}f}" if span else ""
    return texts


def matrices(
    result: Mapping[str, Any], classes: Sequence[Mapping[str, Any]], printed: Sequence[Sequence[int]] | None
) -> dict[str, Any]:
    """Our confusion matrix, and the paper's in the same form; the paper's classes are in the order of ours."""
    names = [str(n) for n in result["classes"]]
    return {
        "ours": matrix_of(result, classes),
        "paper": matrix_of(_printed_figures(printed, names), classes)
        if printed and len(printed) == len(names)
        else None,
    }


def _printed_figures(confusion: Sequence[Sequence[int]], names: Sequence[str]) -> dict[str, Any]:
    """Figures of a printed matrix, rows reference."""
    n = len(names)
    right = [confusion[k][k] for k in range(n)]
    rows, columns = [sum(r) for r in confusion], [sum(confusion[i][j] for i in range(n)) for j in range(n)]
    total = sum(rows)
    chance = sum(r * c for r, c in zip(rows, columns, strict=True)) / total**2
    agreed = sum(right) / total
    return {
        "classes": list(names),
        "confusion": [list(r) for r in confusion],
        "overall_accuracy": agreed,
        "kappa": (agreed - chance) / (1 - chance),
        "producers_accuracy": [a / b for a, b in zip(right, rows, strict=True)],
        "users_accuracy": [a / b for a, b in zip(right, columns, strict=True)],
        "iou": [a / (b + c - a) for a, b, c in zip(right, rows, columns, strict=True)],
    }


def difference(comparison: Mapping[str, Any], digits: int = 2) -> dict[str, str]:
    """Gain and interval of a comparison by figure, in points (kappa: of 100 too)."""
    texts = {}
    for key in ("overall_accuracy", "kappa", "mean_iou"):
        part = comparison[key]
        texts[key] = signed_points(part["value"], digits)
        texts[f"{key}_span"] = (
            f"[{signed_points(part['low'], digits)}, {signed_points(part['high'], digits)}]"
            if part["low"] is not None
            else "–"
        )
    return texts


def signed_points(value: float, digits: int = 2) -> str:
    """A fraction in points with its sign."""
    return f"{100 * value:+.{digits}f}".replace("-", MINUS)


def rows_table(rows: Mapping[str, Sequence[int]]) -> list[tuple[str, str, str]]:
    """Rows of the table of samples: (class, training rows, test echoes)."""
    return [(name, number(a), number(b)) for name, (a, b) in rows.items()]


def share(value: float | None) -> str:
    """A share of 0 to 1 as text in percent; a dash where there is none."""
    return percent(value) or "–"
