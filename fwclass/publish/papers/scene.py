"""A square of a survey from above as Shi 2019 draws it, and its F-scores; PNG."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from fwclass.publish.drawing import FRAME, INK, PAPER, SIZE, dress, png, sheet
from fwclass.publish.palette import colours
from fwclass.publish.papers.plots import OURS, PALE

WIDE, TALL = 9.6, 6.9
MOST_CELLS = 250
"""Across a panel, as many pixels as it has on a screen."""
FULL = 0.8
"""Cells across over those that would hold one echo each: few stay empty."""
FADED = 0.22
"""Of a colour, where an echo is not at the boundary."""
UNKNOWN, OTHER = np.array((0.85, 0.87, 0.89)), np.array((0.35, 0.4, 0.45))
"""Of a label that is no class; of what is no ground."""


def draw_scene(
    echoes: Mapping[str, NDArray], place: tuple[float, float, float], classes: Sequence[Mapping[str, Any]]
) -> bytes:
    """Six panels: ground filter, heights as measured and above the ground; reference, first layer and both layers.

    `echoes` has x, y, z, ``ground``, ``height_above_ground``, ``reference``, ``coarse_class``, ``classification`` and
    ``boundary`` (each (echoes,)); `place` is (xmin, ymin, edge) [m]. A cell shows its highest echo, below its highest
    one at the boundary first.
    """
    xmin, ymin, edge = place
    x, y, z = (np.asarray(echoes[n], np.float64) for n in "xyz")
    cells = max(1, min(MOST_CELLS, int(FULL * np.sqrt(len(x)))))
    across, up = (np.minimum((v * cells / edge).astype(np.int64), cells - 1) for v in (x - xmin, y - ymin))
    highest = np.argsort(z, kind="stable")
    at = np.lexsort((z, echoes["boundary"]))
    figure = sheet(WIDE, TALL)
    panels = figure.subplots(2, 3, sharex=True, sharey=True).ravel()
    rgb = {int(c["code"]): np.array(v) / 255 for c, v in zip(classes, _of(classes), strict=True)}

    def show(axes: Any, order: NDArray, values: NDArray, **more: Any) -> Any:
        """In every cell the last echo of `order`; where there is none, nothing."""
        image = np.full((cells, cells, *values.shape[1:]), np.nan)
        image[up[order], across[order]] = values[order]
        if image.ndim == 3:
            image = np.where(np.isnan(image), 1.0, image)
        edges = (0.0, edge, 0.0, edge)
        return axes.imshow(image, origin="lower", extent=edges, interpolation="nearest", **more)

    show(panels[0], highest, np.where(np.asarray(echoes["ground"])[:, None], rgb.get(2, UNKNOWN), OTHER))
    for axes, name in ((panels[1], "z"), (panels[2], "height_above_ground")):
        values = np.asarray(echoes[name], np.float64)
        low, high = np.nanpercentile(values, [1, 99]) if np.isfinite(values).any() else (0.0, 1.0)
        bar = figure.colorbar(
            show(axes, highest, values, cmap="viridis", vmin=low, vmax=high), ax=axes, shrink=0.8, pad=0.02
        )
        bar.ax.tick_params(labelsize=7, colors=INK)
        bar.outline.set_edgecolor(FRAME)
    table = np.tile(UNKNOWN, (256, 1))
    for c in classes:
        table[[int(k) for k in c.get("codes", (c["code"],))]] = rgb[int(c["code"])]
        table[int(c["code"])] = rgb[int(c["code"])]
    strong = np.where(np.asarray(echoes["boundary"], bool)[:, None], 1.0, FADED)
    for axes, name in zip(panels[3:], ("reference", "coarse_class", "classification"), strict=True):
        show(axes, at, 1 - strong * (1 - table[np.asarray(echoes[name])]))
    titles = ("ground filter", "height as measured, m", "height above the ground, m")
    for axes, title in zip(panels, (*titles, "reference", "first layer", "both layers"), strict=True):
        dress(axes)
        axes.grid(visible=False)
        axes.set_title(title, fontsize=SIZE, color=INK)
    dots = [_dot(rgb[int(c["code"])], str(c["name"])) for c in classes]
    figure.legend(handles=dots, loc="outside lower center", ncols=len(dots), fontsize=8, frameon=False, labelcolor=INK)
    return png(figure)


def _of(classes: Sequence[Mapping[str, Any]]) -> list[tuple[int, int, int]]:
    palette = colours(classes)
    return [palette[int(c["code"])] for c in classes]


def _dot(colour: NDArray, name: str) -> Line2D:
    return Line2D([], [], marker="o", linestyle="none", markersize=5, color=tuple(colour), label=name)


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
