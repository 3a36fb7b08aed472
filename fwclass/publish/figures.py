"""Maps of the report as PNG; the same rasters give the same bytes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.patches import Patch
from numpy.typing import NDArray

from fwclass.grid import Window
from fwclass.publish.drawing import PAPER, Areas, View, draw, frame, legend, outline, png
from fwclass.publish.palette import BLANK, colours, css
from fwclass.publish.params import PublishParams
from fwclass.publish.shade import flat_light, hillshade

TINTS = ((0.0, (112, 144, 122)), (0.35, (186, 196, 150)), (0.65, (222, 205, 160)), (1.0, (243, 238, 226)))
"""Height tints of the terrain: low green, high pale."""


def class_map(
    classes: NDArray[np.uint8],
    window: Window | View,
    names: Sequence[Mapping[str, Any]],
    params: PublishParams,
    dtm: tuple[NDArray[np.float32], Window | View] | None = None,
    areas: Areas | None = None,
    aside: bool = True,
) -> bytes:
    """Class raster, shaded by the terrain's relief, with legend, scale bar and the outlined areas.

    Parameters
    ----------
    classes : uint8 ``window.shape``, row 0 in the south, 0 where there is no data (stays blank).
    names : ``[{"name", "code"}]``, order of the legend; a code that occurs but is not named is drawn grey.
    dtm : heights [m] and their window, of any cell and extent; None draws without shading.
    areas : ``{"train": [[xmin, ymin, xmax, ymax]], "test": [...]}``, or None.
    aside : with a legend inside the picture; without one it stands beside it as text.
    """
    part, view = downsample(classes, window, params.figure_pixels)
    table = np.full((256, 3), 165, np.float32)
    table[0] = BLANK
    palette = colours(names)
    for code, colour in palette.items():
        table[code] = colour
    part = fill_gaps(part)
    image = table[part]
    if dtm is not None:
        light = _sample(hillshade(dtm[0], dtm[1].cell, params), View.of(dtm[1]), view, flat_light(params))
        image = np.where((part > 0)[..., None], image * (0.62 + 0.48 * light[..., None]), image)
    figure, axes = frame(view, aside)
    draw(axes, image, view)
    handles: list[Any] = [
        Patch(facecolor=css(palette[int(c["code"])]), edgecolor="#00000030", label=str(c["name"])) for c in names
    ]
    if (part == 0).any():
        handles.append(Patch(facecolor=PAPER, edgecolor="#00000060", label="no data"))
    handles += outline(axes, areas or {}, view)
    if aside:
        legend(axes, handles, "Class")
    return png(figure)


def relief(
    dtm: NDArray[np.float32],
    window: Window | View,
    params: PublishParams,
    heights: tuple[float, float] | None = None,
    aside: bool = True,
) -> bytes:
    """Shaded relief of the terrain model, tinted by height; cells without height stay blank.

    `dtm`: float32 ``window.shape`` [m], row 0 in the south, NaN where there is none. `heights`: lowest and highest tint
    [m]; None takes them from `dtm`. `aside`: as for `class_map`.
    """
    part, view = downsample(dtm, window, params.figure_pixels)
    low, high = heights if heights is not None else tint_range(part)
    share = np.clip((np.nan_to_num(part, nan=low) - low) / max(high - low, 1e-9), 0, 1)
    tint = _tint(share)
    light = hillshade(part, view.cell, params)
    image = np.where(np.isfinite(part)[..., None], tint * (0.35 + 0.78 * light[..., None]), 255.0)
    figure, axes = frame(view, aside)
    draw(axes, image, view)
    if not aside:
        return png(figure)
    steps = np.linspace(low, high, 5)
    shades = _tint(np.linspace(0, 1, 5)) / 255
    handles = [
        Patch(facecolor=tuple(shade), edgecolor="#00000030", label=f"{step:.1f} m")
        for step, shade in zip(steps[::-1], shades[::-1], strict=True)
    ]
    legend(axes, handles, "Height")
    return png(figure)


SURE = ((0.0, (178, 24, 43)), (0.5, (253, 219, 199)), (1.0, (33, 102, 172)))
"""Red is unsure, blue sure; as in the QGIS project."""

WRONG = ((0.0, (245, 247, 249)), (0.2, (252, 174, 110)), (0.6, (215, 48, 31)), (1.0, (90, 0, 20)))


def share_map(
    shares: NDArray[np.float32],
    window: Window | View,
    params: PublishParams,
    ramp: Sequence[tuple[float, tuple[int, int, int]]],
    areas: Areas | None = None,
) -> bytes:
    """Shares of 0 to 1 in colours of `ramp`, without a legend; NaN stays blank."""
    part, view = downsample(shares, window, params.figure_pixels)
    stops = [stop for stop, _ in ramp]
    known = np.nan_to_num(part)
    image = np.stack([np.interp(known, stops, [c[i] for _, c in ramp]) for i in range(3)], axis=-1)
    figure, axes = frame(view, aside=False)
    draw(axes, np.where(np.isfinite(part)[..., None], image, 255.0), view)
    outline(axes, areas or {}, view)
    return png(figure)


def tint_range(dtm: NDArray[np.float32]) -> tuple[float, float]:
    """Heights [m] of the lowest and the highest tint: all but the outermost hundredths of the cells."""
    finite = dtm[np.isfinite(dtm)]
    low, high = np.percentile(finite, (1, 99)) if finite.size else (0.0, 1.0)
    return float(low), float(high)


def _tint(share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Colour of heights that lie at `share` of the range, 0 to 255, shape (…, 3)."""
    stops = [stop for stop, _ in TINTS]
    return np.stack([np.interp(share, stops, [c[i] for _, c in TINTS]) for i in range(3)], axis=-1)


def step_of(window: Window | View, pixels: int) -> int:
    """Of how many cells of a row one is drawn, so that the longer edge has at most `pixels`."""
    return max(1, math.ceil(max(window.shape) / pixels))


def downsample(array: NDArray, window: Window | View, pixels: int) -> tuple[NDArray, View]:
    """Every k-th cell from the south-west, so that the longer edge has at most `pixels`."""
    step = step_of(window, pixels)
    return array[::step, ::step], View.of(window, step)


def fill_gaps(codes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """For display: an empty cell takes the commonest class around it where three neighbours of four have one.

    The smallest code wins a tie. Larger gaps in the data stay blank.
    """
    shifts = [(i, j) for i in range(3) for j in range(3) if (i, j) != (1, 1)]
    padded, there = np.pad(codes, 1), np.pad(np.ones(codes.shape, np.uint8), 1)
    known, neighbours = (_around(a, codes.shape, shifts) for a in ((padded > 0).astype(np.uint8), there))
    rows, cols = np.nonzero((codes == 0) & (known > 0) & (4 * known >= 3 * neighbours))
    out = codes.copy()
    if len(rows):
        near = np.stack([padded[rows + i, cols + j] for i, j in shifts], axis=1)
        votes = np.stack([(near == near[:, [k]]).sum(axis=1) * (near[:, k] > 0) for k in range(8)], axis=1)
        most = (votes == votes.max(axis=1, keepdims=True)) & (near > 0)
        out[rows, cols] = np.where(most, near, 255).min(axis=1)
    return out


def _around(padded: NDArray[np.uint8], shape: tuple[int, ...], shifts: list[tuple[int, int]]) -> NDArray[np.uint8]:
    """Sum over the eight neighbours of every cell; `padded` has one cell more on each side."""
    rows, cols = shape
    return np.sum([padded[i : i + rows, j : j + cols] for i, j in shifts], axis=0, dtype=np.uint8)


def _sample(light: NDArray[np.float32], own: View, view: View, flat: float) -> NDArray[np.float32]:
    """`light` of the cells of `own` at the middles of the view's cells; `flat` outside."""
    x = view.xmin + (np.arange(view.ncols) + 0.5) * view.cell
    y = view.ymin + (np.arange(view.nrows) + 0.5) * view.cell
    col = np.floor((x - own.xmin) / own.cell).astype(int)
    row = np.floor((y - own.ymin) / own.cell).astype(int)
    inside = ((row >= 0) & (row < own.nrows))[:, None] & ((col >= 0) & (col < own.ncols))[None, :]
    nearest = light[np.clip(row, 0, own.nrows - 1)[:, None], np.clip(col, 0, own.ncols - 1)[None, :]]
    return np.where(inside, nearest, np.float32(flat))
