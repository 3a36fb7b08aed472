"""The frame of a map: axes in metres, scale bar, north arrow, outlined areas, legend."""

from __future__ import annotations

import io
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import patheffects
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.text import Text
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from fwclass.grid import Window

DPI = 150
"""Of the pictures [dots per inch]."""
INK, PAPER, GRID, FRAME = "#22303c", "#ffffff", "#dde3e8", "#8795a1"
SIZE = 8.5
"""Of the labels of axes [points]."""
AREA_STYLE = {"train": ("training area", (0, (4, 2))), "test": ("test area", "solid")}
LABEL_INCHES = 1.1
"""Room that a coordinate takes along an axis."""

COORDINATE, LENGTH, NORTH = 9, 11, 12
"""Points of the letters of axes, scale bar and arrow: a page shows a map at two thirds, a telephone at a quarter."""

HALO = [patheffects.withStroke(linewidth=3, foreground="white")]

Areas = Mapping[str, Iterable[Sequence[float]]]


@dataclass(frozen=True)
class View:
    """Cells of a drawing: south-west corner, edge of a cell [m], columns and rows."""

    xmin: float
    ymin: float
    cell: float
    ncols: int
    nrows: int

    @classmethod
    def of(cls, place: Window | View, step: int = 1) -> View:
        """Every `step`-th cell of a raster, from the south-west."""
        if isinstance(place, Window):
            place = cls(place.box.xmin, place.box.ymin, place.cell, place.ncols, place.nrows)
        ncols, nrows = (math.ceil(n / step) for n in (place.ncols, place.nrows))
        return cls(place.xmin, place.ymin, place.cell * step, ncols, nrows)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows, columns."""
        return self.nrows, self.ncols

    @property
    def width(self) -> float:
        """From west to east [m]."""
        return self.ncols * self.cell

    @property
    def height(self) -> float:
        """From south to north [m]."""
        return self.nrows * self.cell


def sheet(width: float, height: float) -> Figure:
    """An empty figure of this size [inches]."""
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor=PAPER, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def dress(axes: Any, x: str = "", y: str = "", grid: str = "both") -> None:
    """Give axes their labels, grid and colours."""
    axes.set_xlabel(x, fontsize=SIZE, color=INK)
    axes.set_ylabel(y, fontsize=SIZE, color=INK)
    axes.tick_params(labelsize=7, colors=INK, length=3, width=0.6)
    axes.grid(color=GRID, linewidth=0.6, axis=grid)
    axes.set_axisbelow(True)
    for spine in axes.spines.values():
        spine.set_color(FRAME)


def frame(view: View, aside: bool = True) -> tuple[Figure, Any]:
    """A figure whose map keeps the ground's proportions; `aside`: with a column for a legend at the right."""
    wide, legend, margin = (7.2, 1.75, 0.75) if aside else (8.2, 0.1, 0.45)
    tall = min(max(wide * view.height / view.width, 1.6), 9.5)
    drawn = min(wide, tall * view.width / view.height)
    size = (margin + drawn + legend, tall + 0.55)
    figure = Figure(figsize=size, dpi=DPI, facecolor=PAPER)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((margin / size[0], 0.4 / size[1], drawn / size[0], tall / size[1]))
    return figure, axes


def draw(axes: Any, image: NDArray, view: View) -> None:
    """Lay `image` (rows, columns, 3), 0 to 255, row 0 in the south, on a map with coordinates, scale bar and north."""
    edges = (view.xmin, view.xmin + view.width, view.ymin, view.ymin + view.height)
    axes.imshow(np.clip(image, 0, 255).astype(np.uint8), origin="lower", extent=edges, interpolation="nearest")
    axes.set_xlim(edges[0], edges[1])
    axes.set_ylim(edges[2], edges[3])
    inches = _inches(axes)
    for axis, long in zip((axes.xaxis, axes.yaxis), inches, strict=True):
        low, high = sorted(axis.get_view_interval())
        axis.set_major_locator(FixedLocator(_ticks(low, high, int(long / LABEL_INCHES))))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}".replace(",", " ")))
    axes.tick_params(labelsize=COORDINATE, colors=INK, length=3, width=0.6)
    axes.tick_params(axis="y", labelrotation=90)
    for label in axes.get_yticklabels():
        label.set_verticalalignment("center")
    for spine in axes.spines.values():
        spine.set_color(FRAME)
        spine.set_linewidth(0.7)
    _scale_bar(axes, view, inches)
    _north(axes)


def _inches(axes: Any) -> tuple[float, float]:
    """Width and height of the axes on paper."""
    box, size = axes.get_position(original=True), axes.figure.get_size_inches()
    return float(box.width * size[0]), float(box.height * size[1])


def _ticks(low: float, high: float, most: int) -> list[float]:
    """Round coordinates, none so near to a corner that its label would touch another."""
    margin = 0.07 * (high - low)
    bins = min(max(most, 1), 5)
    places = MaxNLocator(bins, steps=[1, 2, 5, 10], integer=True).tick_values(low, high)
    return [float(v) for v in places if low + margin <= v <= high - margin][:bins]


def round_length(longest: float) -> float:
    """The largest of 1, 2, 5 × 10^k that is not above `longest`."""
    power = 10.0 ** math.floor(math.log10(longest))
    return max(f * power for f in (1, 2, 5) if f * power <= longest * (1 + 1e-12))


def _scale_bar(axes: Any, view: View, inches: tuple[float, float]) -> None:
    """Two-coloured bar at the lower left, with its length."""
    length = round_length(max(view.width / 4, min(view.width, 0.9 * view.width / inches[0])))
    point_x, point_y = view.width / inches[0] / 72, view.height / inches[1] / 72
    x, y, thick = view.xmin + 14 * point_x, view.ymin + 12 * point_y, 6 * point_y
    for part, colour in ((length, "white"), (length / 2, INK)):
        bar = Rectangle((x, y), part, thick, facecolor=colour, edgecolor=INK, linewidth=0.8, zorder=5)
        axes.add_patch(bar)
    text = f"{length / 1000:g} km" if length >= 1000 else f"{length:g} m"
    axes.annotate(
        text,
        (x + length / 2, y + thick),
        (0, 3),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=LENGTH,
        color=INK,
        path_effects=HALO,
        zorder=7,
    )


def _north(axes: Any) -> None:
    """An arrow at the upper right: north is up."""
    corner = {"xycoords": "axes fraction", "textcoords": "offset points", "zorder": 7}
    axes.annotate(
        "N",
        (1, 1),
        (-16, -20),
        ha="center",
        va="bottom",
        fontsize=NORTH,
        color=INK,
        weight="bold",
        path_effects=HALO,
        **corner,
    )
    axes.annotate(
        "▲", (1, 1), (-16, -21), ha="center", va="top", fontsize=NORTH, color=INK, path_effects=HALO, **corner
    )


def outline(axes: Any, areas: Areas, view: View) -> list[Line2D]:
    """Outlines of training and test areas, dark on a white casing; their legend entries."""
    handles = []
    inset = 0.004 * max(view.width, view.height)
    for kind, (label, dashes) in AREA_STYLE.items():
        lines = area_edges([tuple(map(float, b)) for b in areas.get(kind) or ()], inset)
        for colour, width, style, order in (("white", 3.0, "solid", 3), (INK, 1.5, dashes, 4)):
            axes.add_collection(
                LineCollection(lines, colors=colour, linewidths=width, linestyles=[style], zorder=order), autolim=False
            )
        if lines:
            handles.append(Line2D([], [], color=INK, linewidth=1.5, linestyle=dashes, label=label))
    return handles


def area_edges(boxes: Sequence[tuple[float, ...]], inset: float) -> list[list[tuple[float, float]]]:
    """Outline of an area made of boxes: shared edges are left out, the others move in by `inset`."""
    sides = [_sides(box) for box in boxes]
    times = Counter(edge for four in sides for edge in four)
    lines = []
    for four in sides:
        outer = [times[edge] == 1 for edge in four]
        for k, ((x0, y0), (x1, y1)) in enumerate(four):
            if outer[k]:
                i, j = INWARD[k]
                ends = (inset * outer[SIDES_AT[k][0]], inset * outer[SIDES_AT[k][1]])
                along = (1, 0) if y0 == y1 else (0, 1)
                start = (x0 + i * inset + along[0] * ends[0], y0 + j * inset + along[1] * ends[0])
                stop = (x1 + i * inset - along[0] * ends[1], y1 + j * inset - along[1] * ends[1])
                lines.append([start, stop])
    return lines


def _sides(box: tuple[float, ...]) -> list[tuple[tuple[float, float], tuple[float, float]]]:
    """South, north, west and east side of a box, each from its lower end."""
    a, b, c, d = box
    return [((a, b), (c, b)), ((a, d), (c, d)), ((a, b), (a, d)), ((c, b), (c, d))]


INWARD = ((0, 1), (0, -1), (1, 0), (-1, 0))
SIDES_AT = ((2, 3), (2, 3), (0, 1), (0, 1))
"""Per side of a box: the direction to its middle, and the sides that meet its two ends."""


def legend(axes: Any, handles: list[Any], title: str) -> None:
    """Put a legend at the right of a map."""
    axes.legend(
        handles=handles,
        title=title,
        title_fontsize=8.5,
        alignment="left",
        loc="upper left",
        frameon=False,
        bbox_to_anchor=(1.02, 1.0),
        borderaxespad=0,
        fontsize=8,
        handlelength=1.6,
        handleheight=1.1,
        labelspacing=0.65,
        labelcolor=INK,
    )


def png(figure: Figure) -> bytes:
    """The figure as PNG, without the software's name and date, which would change the bytes."""
    for text in figure.findobj(Text):
        text.set_parse_math(False)  # a $ in the name of a class is a $
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=DPI, metadata={"Software": None})
    return out.getvalue()
