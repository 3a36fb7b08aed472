"""Pictures of a street: the prescription along the road, frames as a grid, labels of a slice."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

SIDES = {"left": "#17697a", "right": "#2f8f4e"}
LONGEST = 200.0
"""m of road in the picture of a prescription; of a longer one the first."""


def draw_prescription(segments: Sequence[Any]) -> bytes:
    """Height band and depth of every segment along the road, its density as shade; PNG."""
    from matplotlib.colors import to_rgba
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 6), dpi=100, layout="constrained")
    axes = figure.subplots(2, 1, sharex=True)
    drawn = [s for s in segments if s.begin - segments[0].begin < LONGEST]
    dense = max((s.density for s in drawn), default=1.0)
    for s in drawn:
        colour = to_rgba(SIDES[s.side], 0.25 + 0.75 * s.density / dense)
        turn = 1.0 if s.side == "left" else -1.0
        axes[0].add_patch(_patch(s.begin, s.low, s.end - s.begin, s.high - s.low, colour))
        axes[1].add_patch(_patch(s.begin, turn * s.near, s.end - s.begin, turn * (s.far - s.near), colour))
    for axis, label in zip(axes, ("m above the road", "m from the track, left is up"), strict=True):
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    if drawn:
        axes[0].set_xlim(drawn[0].begin, drawn[-1].end)
        axes[0].set_ylim(0, 1.05 * max(s.high for s in drawn))
        far = 1.05 * max(s.far for s in drawn)
        axes[1].set_ylim(-far, far)
    axes[1].axhline(0, color="#555555", lw=1)
    axes[1].set_xlabel("m along the road")
    axes[0].set_title("crown beside the road, left in blue, right in green; darker is denser", fontsize=10)
    return _png(figure)


def _patch(x: float, y: float, wide: float, tall: float, colour: Any) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((x, y), wide, tall, facecolor=colour, edgecolor="none")


def draw_grid(values: NDArray[np.uint8], names: Sequence[str], colours: Sequence[str]) -> bytes:
    """A variable-scale grid, beams upwards over frames (Li 2018, figure 10); PNG.

    values : (frames, beams) index into `names` and `colours`, 255 without a return.
    """
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    figure = Figure(figsize=(8, 4), dpi=100, layout="constrained")
    axis = figure.subplots()
    shown = np.where(values == 255, len(names), values)
    axis.imshow(
        shown.T,
        cmap=ListedColormap([*colours, "#ffffff"]),
        vmin=-0.5,
        vmax=len(names) + 0.5,
        origin="lower",
        aspect="auto",
        interpolation="nearest",
    )
    axis.set_xlabel("frame")
    axis.set_ylabel("beam")
    handles = [Patch(color=c, label=n) for n, c in zip(names, colours, strict=True)]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(names), fontsize=8, frameon=False)
    return _png(figure)


def draw_slice(
    y: NDArray[np.float64], z: NDArray[np.float64], codes: NDArray[np.uint8], boxes: Sequence[Any], title: str
) -> bytes:
    """Returns of a stretch of road in the y–z plane with the rectangles that label them; PNG."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    figure = Figure(figsize=(8, 6), dpi=100, layout="constrained")
    axis = figure.subplots()
    for code in np.unique(codes):
        of = codes == code
        colour = "#bbbbbb" if code == 0 else None
        axis.scatter(y[of], z[of], s=1, color=colour, label=f"class {code}" if code else "no label")
    for box in boxes:
        style = "-" if box.include else ":"
        axis.add_patch(Rectangle((box.y0, box.z0), box.y1 - box.y0, box.z1 - box.z0, fill=False, linestyle=style, lw=1))
    axis.set_aspect("equal")
    axis.set_xlabel("m to the left of the track")
    axis.set_ylabel("m above the scanner")
    axis.plot(0, 0, "+", color="#22303c", ms=9)
    axis.minorticks_on()
    axis.grid(alpha=0.35)
    axis.grid(which="minor", alpha=0.15)
    axis.set_title(f"{title} (+ is the scanner)", fontsize=10)
    figure.legend(markerscale=6, fontsize=8, loc="outside right upper", frameon=False)
    return _png(figure)


def _png(figure: Any) -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()
