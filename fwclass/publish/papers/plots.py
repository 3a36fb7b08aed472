"""Plots of the papers' pages as PNG; the same figures give the same bytes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.ticker import MaxNLocator

from fwclass.publish.drawing import INK, SIZE, dress, png, sheet
from fwclass.publish.palette import BY_NAME, css
from fwclass.publish.sections import unit_of
from fwclass.schema import split_name

OURS, THEIRS, PALE = "#17697a", "#d0742e", "#e6c3a6"
WITH_ERRORS: dict[str, Any] = {"color": OURS, "ecolor": "#9fb8bf", "fmt": "o-"}
BOX = ("p5", "p25", "p50", "p75", "p95")


def draw_distribution(quantiles: Mapping[str, Mapping[str, Any]], printed: Mapping[str, Mapping[str, Any]]) -> bytes:
    """A panel per feature: a box per class from quantiles (5, 25, 50, 75, 95 %), the paper's range behind it.

    `quantiles`: quantiles by feature and class; `printed`: ``low`` and ``high`` by base and class, None for open.
    """
    across = min(4, max(1, len(quantiles)))
    rows = -(-len(quantiles) // across)
    figure = sheet(9.6, 2.3 * rows)
    for place, (feature, by_class) in enumerate(quantiles.items()):
        axes = figure.add_subplot(rows, across, place + 1)
        base = split_name(feature)[0]
        known = [v[p] for v in by_class.values() for p in BOX if v.get(p) is not None]
        low, high = (min(known), max(known)) if known else (0.0, 1.0)
        room = 0.06 * (high - low) or 1.0
        for k, (name, row) in enumerate(by_class.items()):
            _range(axes, k, printed.get(base, {}).get(name, {}), low - room, high + room)
            _box(axes, k, row, css(BY_NAME.get(name, BY_NAME["other"])))
        axes.set_ylim(low - room, high + room)
        axes.set_xlim(-0.6, len(by_class) - 0.4)
        axes.set_xticks(range(len(by_class)), list(by_class))
        unit = unit_of(feature)
        dress(axes, grid="y")
        axes.set_title(f"{base.replace('_', ' ')}{f' [{unit}]' if unit else ''}", fontsize=SIZE, color=INK)
    return png(figure)


def _range(axes: Any, x: float, printed: Mapping[str, Any], low: float, high: float) -> None:
    """What the paper's words say, as a pale band."""
    if printed.get("low") is None and printed.get("high") is None:
        return
    ends = (
        printed["low"] if printed.get("low") is not None else low,
        printed["high"] if printed.get("high") is not None else high,
    )
    axes.fill_between([x - 0.42, x + 0.42], max(ends[0], low), min(ends[1], high), color=PALE, linewidth=0, zorder=0)


def _box(axes: Any, x: float, row: Mapping[str, Any], colour: str) -> None:
    if any(row.get(p) is None for p in BOX):
        return
    p5, p25, p50, p75, p95 = (row[p] for p in BOX)
    axes.plot([x, x], [p5, p95], color=INK, linewidth=0.9, zorder=2)
    axes.bar([x], [p75 - p25], 0.5, bottom=[p25], color=colour, edgecolor=INK, linewidth=0.6, zorder=3)
    axes.plot([x - 0.25, x + 0.25], [p50, p50], color=INK, linewidth=1.6, zorder=4)


def draw_curves(
    paper: Sequence[tuple[str, float]],
    paper_order: Sequence[tuple[str, float, float, bool]],
    best: Sequence[tuple[str, float, float, bool]],
) -> bytes:
    """Two panels: accuracy [%] as features are added in the paper's order beside the paper's; in our best order.

    Steps are (feature, accuracy, standard deviation over folds, kept).
    """
    figure = sheet(9.6, 3.7)
    left, right = figure.subplots(1, 2, sharey=True)
    at = {name: k for k, (name, _) in enumerate(paper)}
    left.plot(
        range(len(paper)), [v for _, v in paper], "o--", color=THEIRS, linewidth=1.3, markersize=4, label="Fan 2013"
    )
    _steps(left, [at[s[0]] for s in paper_order], paper_order, "ours, spatial folds")
    left.set_xticks(range(len(paper)), [n for n, _ in paper], rotation=35, ha="right", rotation_mode="anchor")
    left.legend(fontsize=7.5, frameon=False, labelcolor=INK, loc="lower right")
    _steps(right, list(range(len(best))), best, "ours")
    right.set_xticks(range(len(best)), [s[0] for s in best], rotation=35, ha="right", rotation_mode="anchor")
    dress(left, "added in the paper's order (×: no gain, dropped again)", "overall accuracy, %")
    dress(right, "added in our best order")
    return png(figure)


def _steps(axes: Any, x: Sequence[int], steps: Sequence[tuple[str, float, float, bool]], label: str) -> None:
    style: dict[str, Any] = {"markersize": 4, "linewidth": 1.4, "elinewidth": 1}
    axes.errorbar(x, [s[1] for s in steps], yerr=[s[2] for s in steps], label=label, **WITH_ERRORS, **style)
    for a, step in zip(x, steps, strict=True):
        if not step[3]:
            axes.plot([a], [step[1]], "x", color=INK, markersize=8, zorder=4)


def draw_thesis(gains: Sequence[tuple[str, Mapping[str, Any]]]) -> bytes:
    """Gain by waveform features with its interval, per seed and figure [points]."""
    figure = sheet(9.6, 0.75 + 0.36 * len(gains))
    titles = {"overall_accuracy": "overall accuracy", "kappa": "kappa × 100", "mean_iou": "mean IoU"}
    panels = figure.subplots(1, len(titles), sharey=True)
    for axes, (key, title) in zip(panels, titles.items(), strict=True):
        for k, (_, one) in enumerate(gains):
            part = one[key]
            if part["low"] is not None:
                axes.plot([100 * part["low"], 100 * part["high"]], [k, k], color=OURS, linewidth=2)
            axes.plot([100 * part["value"]], [k], "o", color=OURS, markersize=5)
        axes.axvline(0, color=INK, linewidth=0.8)
        axes.set_yticks(range(len(gains)), [f"seed {s}" for s, _ in gains])
        axes.set_ylim(len(gains) - 0.5, -0.5)
        dress(axes, f"{title}, points", grid="x")
    return png(figure)


def draw_importance(bars: Sequence[tuple[str, float, float, str]], colours: Mapping[str, str]) -> bytes:
    """Horizontal bars (feature, score, standard deviation, group), the most important at the top; 100 is the first."""
    figure = sheet(9.6, 0.9 + 0.185 * len(bars))
    axes = figure.add_subplot()
    place = range(len(bars))
    axes.barh(
        place,
        [b[1] for b in bars],
        xerr=[b[2] for b in bars],
        color=[colours[b[3]] for b in bars],
        height=0.72,
        error_kw={"ecolor": INK, "elinewidth": 0.7},
    )
    axes.set_yticks(place, [b[0] for b in bars])
    axes.set_ylim(len(bars) - 0.4, -0.6)
    axes.set_xlim(left=min(0.0, *(b[1] - b[2] for b in bars)))
    for group in dict.fromkeys(b[3] for b in bars):
        axes.bar(0, 0, color=colours[group], label=group)
    axes.legend(fontsize=7.5, frameon=False, labelcolor=INK, loc="lower right")
    dress(axes, "drop of out-of-bag accuracy, the first feature is 100", grid="x")
    return png(figure)


def draw_elimination(steps: Sequence[tuple[int, float, float]], chosen: int, printed: tuple[int, float]) -> bytes:
    """Accuracy [%] in cross-validation against the number of features, and the paper's best."""
    figure = sheet(9.6, 3.2)
    axes = figure.add_subplot()
    x, y, spread = zip(*steps, strict=True)
    style: dict[str, Any] = {"markersize": 3, "linewidth": 1.3, "elinewidth": 0.9}
    axes.errorbar(x, y, yerr=spread, label="ours", **WITH_ERRORS, **style)
    at = x.index(chosen)
    axes.plot([chosen], [y[at]], "o", color=OURS, markersize=9, markerfacecolor="none", label=f"chosen: {chosen}")
    axes.plot([printed[0]], [printed[1]], "D", color=THEIRS, markersize=6, label=f"Xiong 2018: {printed[0]} features")
    axes.legend(fontsize=7.5, frameon=False, labelcolor=INK, loc="lower right")
    dress(axes, "features", "accuracy in spatial folds, %")
    return png(figure)


def draw_radii(radii: Sequence[float], ours: Sequence[int], paper: Sequence[int]) -> bytes:
    """How many features survive at every radius, ours and the paper's."""
    figure = sheet(9.6, 2.6)
    axes = figure.add_subplot()
    place = range(len(radii))
    axes.bar([p - 0.2 for p in place], ours, 0.38, color=OURS, label="ours")
    axes.bar([p + 0.2 for p in place], paper, 0.38, color=THEIRS, label="Xiong 2018")
    axes.set_xticks(place, [f"{r:g} m" for r in radii])
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend(fontsize=7.5, frameon=False, labelcolor=INK, loc="upper left")
    dress(axes, "radius", "features that survive", grid="y")
    return png(figure)
