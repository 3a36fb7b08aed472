"""A map of the forecast: echoes of every tile, the training and test areas, and the fullest tile with what it reads."""

from __future__ import annotations

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from fwclass.grid import Box
from fwclass.operate.estimate.forecast import Forecast
from fwclass.operate.estimate.spread import Spread
from fwclass.publish.drawing import INK, View, draw, frame, legend, outline, png

STEPS = ((226, 238, 229), (168, 209, 186), (105, 172, 153), (56, 124, 122), (27, 75, 90))
"""Colours from few echoes to many."""

HALO = "#c2410c"
MOST_PIXELS = 500
"""Tiles along an edge that are drawn singly; of more, squares of several: a square of the map is two pixels wide."""


def plan_picture(forecast: Forecast) -> bytes:
    """PNG."""
    tiles = forecast.tiles
    col, row = int(tiles.cols[0]), int(tiles.rows[0])
    shape = int(tiles.cols[-1]) - col + 1, int(tiles.rows[-1]) - row + 1
    step = max(1, -(-max(shape) // MOST_PIXELS))
    drawn = _coarser(tiles, shape, step)
    size = tiles.size * step
    view = View(col * tiles.size, row * tiles.size, size, *drawn.shape)
    edges = _edges(drawn)
    image = np.full((*drawn.T.shape, 3), 255, np.uint8)
    there = drawn.T >= 0.5
    image[there] = np.array(STEPS, np.uint8)[np.searchsorted(edges, drawn.T[there], side="right")]
    figure, axes = frame(view)
    draw(axes, image, view)
    west, south = col * tiles.size, row * tiles.size
    areas = forecast.config.areas.shown(Box(west, south, west + shape[0] * tiles.size, south + shape[1] * tiles.size))
    handles: list[Patch | Line2D] = [
        Patch(facecolor=tuple(c / 255 for c in STEPS[k]), edgecolor=INK, linewidth=0.4, label=_range(edges, k))
        for k in range(len(edges) + 1)
    ]
    handles += outline(axes, areas, view)
    handles += _fullest(forecast, axes)
    name = f"echoes per tile\nof {forecast.tiles.size:g} m" if step == 1 else f"echoes per {size:g} m"
    legend(axes, handles, name)
    return png(figure)


def _coarser(tiles: Spread, shape: tuple[int, int], step: int) -> NDArray[np.float64]:
    """Sums of `step` x `step` squares of the `shape` (columns, rows) that the tiles span."""
    whole = np.zeros((-(-shape[0] // step), -(-shape[1] // step)))
    at = np.ix_((tiles.cols - tiles.cols[0]) // step, (tiles.rows - tiles.rows[0]) // step)
    np.add.at(whole, at, tiles.counts)
    return whole


def _edges(counts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rounded bounds between the colours; fewer colours where tiles are much the same."""
    bounds = np.quantile(counts[counts > 0], np.linspace(0, 1, len(STEPS) + 1)[1:-1])
    digits = 10.0 ** np.floor(np.log10(np.maximum(bounds, 1.0)) - 1)
    return np.unique(np.rint(bounds / digits) * digits)


def _range(edges: NDArray[np.float64], k: int) -> str:
    if len(edges) == 0:
        return "all"
    if k == 0:
        return f"below {edges[0]:,.0f}"
    return f"{edges[k - 1]:,.0f} and more" if k == len(edges) else f"{edges[k - 1]:,.0f} to {edges[k]:,.0f}"


def _fullest(forecast: Forecast, axes: object) -> list[Line2D]:
    """The fullest tile and its halo, outlined; legend entries."""
    tile = forecast.tiles.heaviest(1)[0]
    handles = []
    for box, style, label in (
        (tile.box, "solid", "fullest tile"),
        (tile.box.grown(forecast.halo), "dotted", f"and what it reads\n({forecast.halo:g} m around it)"),
    ):
        axes.add_patch(  # type: ignore[attr-defined]
            Rectangle(
                (box.xmin, box.ymin),
                box.xmax - box.xmin,
                box.ymax - box.ymin,
                fill=False,
                edgecolor=HALO,
                linestyle=style,
                linewidth=1.2,
                zorder=6,
            )
        )
        handles.append(Line2D([], [], color=HALO, linestyle=style, linewidth=1.2, label=label))
    return handles
