"""A square of a survey from above as Shi 2019 draws it, and its F-scores; PNG."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from fwclass.publish.drawing import INK, PAPER, png
from fwclass.publish.palette import colours
from fwclass.publish.papers.plots import FRAME, OURS, PALE, SIZE, dress, sheet

WIDE, TALL = 9.6, 6.9
PANEL = 190.0
"""Points of an inch's 72 that a panel is wide, about."""
FADED = 0.22
"""Of a colour, where an echo is not at the boundary."""
UNKNOWN = (0.85, 0.87, 0.89)


def draw_scene(
    echoes: Mapping[str, NDArray], place: tuple[float, float, float], classes: Sequence[Mapping[str, Any]]
) -> bytes:
    """Six panels: ground filter, heights as measured and above the ground; reference, first layer and both layers.

    `echoes` has x, y, z, ``ground``, ``height_above_ground``, ``reference``, ``coarse_class``, ``classification`` and
    ``boundary`` (each (echoes,)); `place` is (xmin, ymin, edge) [m].
    """
    order = np.argsort(echoes["z"], kind="stable")
    e = {name: np.asarray(echoes[name])[order] for name in echoes}
    xmin, ymin, edge = place
    x, y = e["x"] - xmin, e["y"] - ymin
    size = (PANEL * np.sqrt(1.0 / max(1, len(x)))) ** 2 * 1.4
    figure = sheet(WIDE, TALL)
    panels = figure.subplots(2, 3, sharex=True, sharey=True).ravel()
    rgb = {int(c["code"]): np.array(v) / 255 for c, v in zip(classes, _of(classes), strict=True)}
    ground = np.where(e["ground"][:, None], rgb.get(2, np.array(UNKNOWN)), np.array((0.35, 0.4, 0.45)))
    panels[0].scatter(x, y, s=size, c=ground, linewidths=0)
    for axes, name in ((panels[1], "z"), (panels[2], "height_above_ground")):
        values = e[name].astype(np.float64)
        low, high = np.nanpercentile(values, [1, 99]) if np.isfinite(values).any() else (0.0, 1.0)
        drawn = axes.scatter(x, y, s=size, c=values, cmap="viridis", vmin=low, vmax=high, linewidths=0)
        bar = figure.colorbar(drawn, ax=axes, shrink=0.8, pad=0.02)
        bar.ax.tick_params(labelsize=7, colors=INK)
        bar.outline.set_edgecolor(FRAME)
    table = np.full((256, 3), UNKNOWN)
    for c in classes:
        table[[int(k) for k in c.get("codes", (c["code"],))]] = rgb[int(c["code"])]
    for axes, name in zip(panels[3:], ("reference", "coarse_class", "classification"), strict=True):
        _classes(axes, x, y, size, table[e[name]], e["boundary"].astype(bool))
    titles = ("ground filter", "height as measured, m", "height above the ground, m")
    for axes, title in zip(panels, (*titles, "reference", "first layer", "both layers"), strict=True):
        axes.set_aspect("equal")
        axes.set_xlim(0, edge)
        axes.set_ylim(0, edge)
        dress(axes)
        axes.grid(visible=False)
        axes.set_title(title, fontsize=SIZE, color=INK)
    dots = [_dot(rgb[int(c["code"])], str(c["name"])) for c in classes]
    figure.legend(handles=dots, loc="outside lower center", ncols=len(dots), fontsize=8, frameon=False, labelcolor=INK)
    return png(figure)


def _of(classes: Sequence[Mapping[str, Any]]) -> list[tuple[int, int, int]]:
    known = colours(classes)
    return [known[int(c["code"])] for c in classes]


def _dot(colour: NDArray, name: str) -> Line2D:
    return Line2D([], [], marker="o", linestyle="none", markersize=5, color=tuple(colour), label=name)


def _classes(axes: Any, x: NDArray, y: NDArray, size: float, rgb: NDArray, at: NDArray[np.bool_]) -> None:
    """Echoes at the boundary over pale others."""
    axes.scatter(x[~at], y[~at], s=size, c=1 - FADED * (1 - rgb[~at]), linewidths=0)
    axes.scatter(x[at], y[at], s=size, c=rgb[at], linewidths=0)


def draw_fscores(scores: Sequence[tuple[str, float]], kept: Collection[str]) -> bytes:
    """Bars of (feature, F-score), the highest at the top; pale what the paper drops (figure 7)."""
    figure = sheet(9.6, 0.8 + 0.3 * len(scores))
    axes = figure.add_subplot()
    place = range(len(scores))
    axes.barh(place, [v for _, v in scores], 0.6, color=[OURS if n in kept else PALE for n, _ in scores])
    axes.set_yticks(place, [n for n, _ in scores])
    axes.set_ylim(len(scores) - 0.4, -0.6)
    for colour, label in ((OURS, "kept by Shi 2019"), (PALE, "dropped by Shi 2019")):
        axes.bar(0, 0, color=colour, label=label)
    axes.set_xlim(left=0.0)
    axes.legend(fontsize=7.5, frameon=False, labelcolor=INK, loc="lower right")
    figure.set_facecolor(PAPER)
    dress(axes, "F-score on the training rows", grid="x")
    return png(figure)
