"""The curve of a selection of features, and accuracy against cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fwclass.publish.drawing import INK, dress, png, sheet

LINE, CHOSEN, PALE = "#17697a", "#d0742e", "#9fb8bf"
LABELLED = 12
"""Steps up to which the axis names the features."""


def draw_selection(
    steps: Sequence[Mapping[str, Any]], front: Sequence[int], chosen: Sequence[str], title: str
) -> bytes:
    """PNG with two panels: accuracy with its spread over the folds against the number of features; accuracy against the
    time per echo, the sets that nothing beats joined.

    `steps` have ``size, accuracy, accuracy_std, microseconds, features, tried, kept``; `front` are indices into them.
    """
    figure = sheet(9.6, 3.9)
    left, right = figure.subplots(1, 2)
    _curve(left, steps, chosen)
    _costs(right, steps, front, chosen)
    figure.suptitle(title, fontsize=9, color=INK)
    return png(figure)


def _curve(axes: Any, steps: Sequence[Mapping[str, Any]], chosen: Sequence[str]) -> None:
    named = len(steps) <= LABELLED and all(len(s["tried"]) == 1 for s in steps)
    x = list(range(1, len(steps) + 1)) if named else [s["size"] for s in steps]
    y, spread = ([100 * (s[n] or 0.0) for s in steps] for n in ("accuracy", "accuracy_std"))
    axes.errorbar(x, y, yerr=spread, color=LINE, ecolor=PALE, linewidth=1.4, elinewidth=1.0, marker="o", markersize=3)
    for a, b, step in zip(x, y, steps, strict=True):
        if list(step["features"]) == list(chosen):
            axes.plot([a], [b], "o", color=CHOSEN, markersize=7, zorder=3)
        if not step["kept"]:
            axes.plot([a], [b], "x", color=INK, markersize=7, zorder=3)
    if named:
        words = [("+ " if k else "") + s["tried"][0] for k, s in enumerate(steps)]
        axes.set_xticks(x, words, rotation=35, ha="right", rotation_mode="anchor")
        added = "added" if all(s["kept"] for s in steps) else "added (x: no gain, dropped again)"
    dress(axes, added if named else "features", "accuracy, % (bars: spread over folds)")


def _costs(axes: Any, steps: Sequence[Mapping[str, Any]], front: Sequence[int], chosen: Sequence[str]) -> None:
    x, y = [s["microseconds"] for s in steps], [100 * (s["accuracy"] or 0.0) for s in steps]
    axes.plot(x, y, "o", color=PALE, markersize=4)
    axes.plot([x[k] for k in front], [y[k] for k in front], color=LINE, linewidth=1.2, marker="o", markersize=4)
    for a, b, step in zip(x, y, steps, strict=True):
        if list(step["features"]) == list(chosen):
            axes.plot([a], [b], "o", color=CHOSEN, markersize=7, zorder=3)
    names = set()
    for k in front:
        size = steps[k]["size"]
        if size not in names:
            axes.annotate(str(size), (x[k], y[k]), textcoords="offset points", xytext=(4, -9), fontsize=7, color=INK)
            names.add(size)
    axes.set_xlim(0.0, 1.08 * max(x))
    dress(axes, "processor time, µs per echo (numbers: features)", "accuracy, %")


def draw_rates(steps: Sequence[Mapping[str, Any]], chosen: float, title: str) -> bytes:
    """PNG with two panels: accuracy with its spread over the folds, and the time per echo by what it goes to, against
    the share of the echoes that is classified."""
    figure = sheet(9.6, 3.7)
    left, right = figure.subplots(1, 2)
    rates = [s["rate"] for s in steps]
    y, spread = ([100 * s[n] for s in steps] for n in ("accuracy", "accuracy_std"))
    left.errorbar(
        rates, y, yerr=spread, color=LINE, ecolor=PALE, linewidth=1.4, elinewidth=1.0, marker="o", markersize=4
    )
    left.plot([chosen], [y[rates.index(chosen)]], "o", color=CHOSEN, markersize=7, zorder=3)
    for name, colour in (("total", INK), ("features", LINE), ("vote", CHOSEN), ("follow", PALE)):
        right.plot(
            rates,
            [s["microseconds"][name] for s in steps],
            color=colour,
            linewidth=1.3,
            marker="o",
            markersize=3.5,
            label=name,
        )
    right.set_yscale("log")
    right.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    right.legend(frameon=False, fontsize=7.5, labelcolor=INK)
    for axes, what in ((left, "accuracy of all echoes, %"), (right, "processor time, µs per echo of the survey")):
        axes.set_xscale("log")
        axes.set_xticks(rates, [f"{100 * r:g} %" for r in rates])
        axes.minorticks_off()
        dress(axes, "share of the echoes that is classified", what)
    figure.suptitle(title, fontsize=9, color=INK)
    return png(figure)
