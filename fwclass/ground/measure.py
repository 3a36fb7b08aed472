"""What a cloud is like, measured without labels before a filter is chosen: density, relief, buildings, cover."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from fwclass.grid import Window, whole_millimetres
from fwclass.ground.raster.fill import fill_gaps
from fwclass.ground.raster.lattice import cells_of, lowest, window_over
from fwclass.ground.raster.opening import disk_opening
from fwclass.ground.raster.surface import gradient, low_limit
from fwclass.kernel import kernel
from fwclass.units import QUANTUM

FINEST = 1.0
"""Edge of the finest cell that is measured in [m]; in sparse clouds a cell is as wide as the points are apart."""

LEVEL = 0.1
"""Slope, rise over run, of the openings of the first surface: they cut everything but nearly level ground."""

FIRST_WINDOW = 18.0
"""Radius of the first surface's largest opening [m], Pingel's."""

WIDEST = 60.0
"""Radius of the largest opening that buildings are measured with [m]."""

OPEN_SLOPE = 0.3
"""Slope of the openings that buildings are measured with: hills up to it are no buildings."""

LOW, HIGH = 1.5, 2.5
"""Heights above the first surface [m]: what was cut but is lower may well be terrain; what is higher is an object."""

NEAR = 0.5
"""An echo at most so high [m] above the first surface counts as ground in its share."""

DEEP = 5.0
"""An echo so far [m] under the closed surface of its surroundings is a low outlier."""

STEEP_BORDER = 1.0
"""Least median step [m] along the border of a building on level ground; hills that stand out have less."""

STEEP_SHARE = 0.85
"""Of the border of a hall so much is steep, 0.94 to 1 of those on ISPRS and IGN tiles; terraces reach 0.75."""

SMOOTH = 0.3
"""Greatest median distance [m] of a roof's cells from the mean of their neighbours; closed crowns have more."""

AROUND, PIT = 8, 0.5
"""Ground points that are held against one, and m that it lies below them at least to be a pit."""

MOST_CELLS = 1 << 23
"""Cells of the raster that is measured on; a larger survey gets larger cells."""


@dataclass(frozen=True)
class Measured:
    """What was measured; lengths [m], slopes as rise over run, shares as fractions.

    Attributes
    ----------
    points : points of the cloud.
    last : share of last and single echoes; the figures below are about these.
    width, height : extent in x and y.
    area : surveyed area [m²].
    density : echoes per m² of it, the median over its cells; 0 where nothing is known.
    spacing : mean distance of neighbours.
    cell : edge of the raster's cells.
    slope_median, slope_steep : 50 % and 90 % quantile of the terrain's slope.
    broken : how much of the terrain stands out as low objects do: share of the cells that openings for level
        ground cut though they are low, each weighted with the slope around it.
    standing : share of the measured cells that such openings cut.
    building : width of the widest object with steep borders; 0 where there is none.
    ground : share of echoes near the first surface.
    vegetation : share of the pulses' echoes that are not last.
    roughness : median distance of the terrain's cells to the mean of the 3 × 3 around them.
    outliers : echoes far below their surroundings.
    """

    points: int
    last: float
    width: float
    height: float
    area: float
    density: float
    spacing: float
    cell: float
    slope_median: float
    slope_steep: float
    broken: float
    standing: float
    building: float
    ground: float
    vegetation: float
    roughness: float
    outliers: int

    def plain(self) -> dict[str, Any]:
        """As plain data for JSON."""
        return asdict(self)


_TOLD = (
    ("points", "points", "{:,.0f}", 1),
    ("last or single echoes", "last", "{:.1f} %", 100),
    ("surveyed area", "area", "{:,.0f} m2", 1),
    ("density", "density", "{:.2f} /m2", 1),
    ("spacing", "spacing", "{:.2f} m", 1),
    ("slope, half of the terrain is below", "slope_median", "{:.3f}", 1),
    ("slope, 90 % of the terrain are below", "slope_steep", "{:.3f}", 1),
    ("cells lower than 1.5 m that stand out, by slope", "broken", "{:.2f} %", 100),
    ("cells that stand out of level ground", "standing", "{:.1f} %", 100),
    ("widest building", "building", "{:.0f} m", 1),
    ("echoes within 0.5 m of a first terrain", "ground", "{:.1f} %", 100),
    ("roughness of that terrain", "roughness", "{:.3f} m", 1),
    ("echoes 5 m below their neighbours", "outliers", "{:,.0f}", 1),
)


def table(measured: Measured) -> str:
    """The figures as a small table for a terminal."""
    wide = max(len(label) for label, *_ in _TOLD)
    return "\n".join(f"{label:<{wide}}  {form.format(getattr(measured, name) * k)}" for label, name, form, k in _TOLD)


def measure(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], last: NDArray[np.bool_]
) -> Measured:
    """Density, relief, buildings and cover of a cloud, measured from its points alone.

    Parameters
    ----------
    x, y, z : (n,) finite coordinates [m], at least one, in any order, which does not matter.
    last : (n,) the point is the last, or only, echo of its pulse; if none is, all are looked at.
    """
    points, last_share = len(x), float(np.mean(last))
    if 0 < last_share < 1:
        x, y, z = x[last], y[last], z[last]
    spacing, area, density = _density(x, y)
    cell = _cell(spacing, area)
    window = window_over(x, y, cell, "the measuring raster", margin=1)
    flat = _cells(x, y, QUANTUM, whole_millimetres(cell, "cell"), window.col, window.row, window.ncols)
    low, outliers = _lowest(flat, z, window)
    known = np.isfinite(low)
    surface = fill_gaps(low)
    cut = known & _standing(surface, cell, LEVEL, FIRST_WINDOW)
    first = fill_gaps(np.where(known & ~cut, low, np.nan)) if (known & ~cut).any() else surface
    slope = _slope(first, cell)
    bare, n = slope[known & ~cut], int(known.sum())
    height = surface - first
    return Measured(
        points=points,
        last=last_share,
        width=float(np.ptp(x)),
        height=float(np.ptp(y)),
        area=area,
        density=density,
        spacing=spacing,
        cell=cell,
        slope_median=_quantile(bare, 0.5),
        slope_steep=_quantile(bare, 0.9),
        broken=float(np.sum(slope, where=cut & (height < LOW))) / n,
        standing=float(cut.sum()) / n,
        building=_widest(low, cell, _quantile(bare, 0.9)),
        ground=_near(flat, z, (first + NEAR + 0.5 * cell * slope).reshape(-1)) / len(x),
        vegetation=1.0 - last_share,
        roughness=_quantile(np.abs(first - scipy.ndimage.uniform_filter(first, 3, mode="nearest"))[known & ~cut], 0.5),
        outliers=outliers,
    )


def _quantile(values: NDArray[np.float64], share: float) -> float:
    return float(np.quantile(values, share)) if values.size else 0.0


def _density(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, float, float]:
    """Spacing, surveyed area and density, from counts in cells that hold about 25 echoes each."""
    box = max(float(np.ptp(x)), 0.001) * max(float(np.ptp(y)), 0.001)
    edge = max(5.0 * math.sqrt(box / len(x)), 0.01)
    for _ in range(2):
        cols = int(np.ptp(x) / edge) + 1
        index = ((y - y.min()) / edge).astype(np.int64) * cols + ((x - x.min()) / edge).astype(np.int64)
        counts = np.bincount(index)
        counts = counts[counts > 0]
        typical = float(np.median(counts))
        area, density = len(counts) * edge * edge, typical / (edge * edge)
        if typical <= 50.0:
            break
        edge *= math.sqrt(25.0 / typical)
    return 1.0 / math.sqrt(density), area, density


def _cell(spacing: float, area: float) -> float:
    """Edge of the cells: the spacing in whole half metres, at least `FINEST`."""
    least = max(FINEST, spacing, math.sqrt(area / MOST_CELLS))
    return math.floor(least * 2.0) / 2.0


@kernel
def _cells(x, y, quantum, cell, col, row, ncols):  # type: ignore[no-untyped-def]
    """Flat index of every point's cell; as `lattice.cells_of`, in one pass."""
    out = np.empty(len(x), np.int64)
    for i in range(len(x)):
        c = np.int64(np.rint(x[i] / quantum)) // cell - col
        r = np.int64(np.rint(y[i] / quantum)) // cell - row
        out[i] = r * ncols + c
    return out


@kernel
def _lowest_over(flat, z, limit, low):  # type: ignore[no-untyped-def]
    """Lowest z not under its cell's `limit` into `low`; the number of those under it."""
    under = 0
    for i in range(len(flat)):
        cell = flat[i]
        if z[i] < limit[cell]:
            under += 1
        elif z[i] < low[cell]:
            low[cell] = z[i]
    return under


@kernel
def _near(flat, z, limit):  # type: ignore[no-untyped-def]
    """Number of points at most as high as their cell's `limit`."""
    n = 0
    for i in range(len(flat)):
        if z[i] <= limit[flat[i]]:
            n += 1
    return n


def _lowest(flat: NDArray[np.int64], z: NDArray[np.float64], window: Window) -> tuple[NDArray[np.float64], int]:
    """Lowest heights by cell of all echoes but those far below their surroundings, and the number of these."""
    low, outliers = np.full(window.shape, np.inf), 0
    _lowest_over(flat, z, np.full(low.size, -np.inf), low.reshape(-1))
    low[np.isinf(low)] = np.nan
    limit = low_limit(fill_gaps(low), 1.0, DEEP)
    if (low < limit).any():
        low = np.full(window.shape, np.inf)
        outliers = _lowest_over(flat, z, limit.reshape(-1), low.reshape(-1))
        low[np.isinf(low)] = np.nan
    return low, outliers


def _radii(largest: int) -> list[int]:
    """1, 2, 3, 4, 6, 9, 13, … and the largest: by half as much again."""
    radii = [1]
    while radii[-1] < largest:
        radii.append(min(largest, max(radii[-1] + 1, radii[-1] * 3 // 2)))
    return radii


def _standing(surface: NDArray[np.float64], cell: float, slope: float, window: float) -> NDArray[np.bool_]:
    """Cells that openings up to `window` [m] lower by more than `slope` allows."""
    standing = np.zeros(surface.shape, bool)
    last = surface
    for radius in _radii(max(1, math.ceil(window / cell))):
        this = disk_opening(last, radius)
        standing |= last - this > slope * cell * radius
        last = this
    return standing


def _slope(surface: NDArray[np.float64], cell: float) -> NDArray[np.float64]:
    """Slope, rise over run, of the surface averaged over five cells."""
    return gradient(scipy.ndimage.uniform_filter(surface, 5, mode="nearest"), cell)


def _widest(low: NDArray[np.float64], cell: float, slope: float) -> float:
    """Width [m] of the widest region that stands out of a wide opening and has steep borders.

    Measured on cells twice as wide. A width is that of the largest circle within the region. Steep is what no terrain
    of `slope` explains.
    """
    surface, edge = fill_gaps(_halve(low)), 2.0 * cell
    terrain = fill_gaps(np.where(_standing(surface, edge, OPEN_SLOPE, WIDEST), np.nan, surface))
    if not np.isfinite(terrain).all():
        return 0.0
    high = surface - terrain > HIGH
    inside = scipy.ndimage.distance_transform_edt(np.pad(high, 1, constant_values=False))[1:-1, 1:-1]
    names, count = scipy.ndimage.label(high)
    if count == 0:
        return 0.0
    widths = 2.0 * edge * scipy.ndimage.maximum(inside, names, np.arange(1, count + 1)) - edge
    steep = _border_steps(surface, high, names, count) >= STEEP_BORDER + math.sqrt(2.0) * edge * slope
    return _widest_hall(surface, edge, slope, float(np.max(widths, where=steep, initial=0.0)))


def _widest_hall(surface: NDArray[np.float64], edge: float, slope: float, widest: float) -> float:
    """Width [m] of the widest hall (`_halls`), or `widest`."""
    return max([widest, *(width for width, _, _ in _halls(surface, edge, slope, widest, WIDEST))])


def _halls(
    surface: NDArray[np.float64], edge: float, slope: float, wider: float, reach: float
) -> Iterator[tuple[float, tuple[slice, ...], NDArray[np.bool_]]]:
    """Smooth regions with steep borders all around, `wider` than that [m], which openings of up to `reach` [m] take
    off: width [m], and the box of cells that holds each, and which of these it is.

    A hall of 8 m that is 60 m wide rises less over the opening than a hill of `OPEN_SLOPE`; its border and its roof
    tell it from one.
    """
    rough = np.abs(surface - scipy.ndimage.uniform_filter(surface, 3, mode="nearest"))
    least = STEEP_BORDER + math.sqrt(2.0) * edge * slope
    last = surface
    for radius in _radii(max(1, math.ceil(reach / edge))):
        this = disk_opening(last, radius)
        taken, step = last - this > HIGH, last - scipy.ndimage.minimum_filter(last, 3, mode="nearest")
        last = this
        inside = scipy.ndimage.distance_transform_edt(np.pad(taken, 1, constant_values=False))[1:-1, 1:-1]
        names, count = scipy.ndimage.label(taken)
        rim = taken & ~scipy.ndimage.binary_erosion(taken)
        widths = 2.0 * edge * scipy.ndimage.maximum(inside, names, np.arange(1, count + 1)) - edge
        for name, box in enumerate(scipy.ndimage.find_objects(names), 1):
            if widths[name - 1] <= wider:
                continue
            own = names[box] == name
            steep = np.mean(step[box][own & rim[box]] >= least)
            if steep >= STEEP_SHARE and np.median(rough[box][own]) <= SMOOTH:
                yield float(widths[name - 1]), box, own


def ground_on_halls(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], wider: float
) -> tuple[float, NDArray[np.bool_]]:
    """Width [m] of the widest flat thing with steps down all around that stands in a ground, 0 for none; and bool (n,):
    a point of that ground lies on one. Filters take roofs that are wider than they were told for ground.

    Parameters
    ----------
    x, y, z : (n,) places of what a filter calls ground [m], in any order.
    wider : width [m] from which on they are looked for.
    """
    on, widest = np.zeros(len(x), bool), 0.0
    if len(x) == 0:
        return widest, on
    spacing, area, _ = _density(x, y)
    edge, reach = 2.0 * _cell(spacing, area), WIDEST
    for _ in range(2):  # the widest in cells twice as wide
        window = window_over(x, y, edge, "the measuring raster")
        surface = fill_gaps(lowest(x, y, z, window))
        slope = _quantile(_slope(surface, edge), 0.9)
        step = surface - scipy.ndimage.minimum_filter(surface, 3, mode="nearest")
        if (step >= STEEP_BORDER).sum() * edge >= 2.0 * wider:  # else there is no such border
            marked = np.zeros(window.shape, bool)
            for width, box, own in _halls(surface, edge, slope, wider - 2.0 * edge, reach):  # its rim is not seen
                widest = max(widest, width)
                marked[box] |= own
            on |= marked.reshape(-1)[cells_of(x, y, window)[0]]
        edge, reach = 2.0 * edge, 2.0 * reach
    return widest, on


def ground_in_pits(x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.bool_]:
    """bool (n,): a point of a ground lies deeper below all of its `AROUND` nearest ones in plan than the last of these
    is away, and than `PIT`: no surface goes down so to a point, and a filter takes out what stands on the real ground
    around it.

    Parameters
    ----------
    x, y, z : (n,) places of what a filter calls ground [m], in any order.
    """
    pits = np.zeros(len(x), bool)
    if len(x) <= AROUND:
        return pits
    order = np.lexsort((z, y, x))  # of equally near ones the same count, whatever the order
    place, height = np.stack([x[order], y[order]], axis=1), z[order]
    away, near = map(np.asarray, scipy.spatial.cKDTree(place).query(place, AROUND + 1))
    others = np.where(near == np.arange(len(x))[:, None], np.inf, height[near])
    pits[order] = others.min(axis=1) - height > np.maximum(PIT, away[:, -1])
    return pits


def _border_steps(
    surface: NDArray[np.float64], high: NDArray[np.bool_], names: NDArray[np.signedinteger], count: int
) -> NDArray[np.float64]:
    """Median height [m] of every region's border cells over the lowest of their neighbours; 0 for none."""
    rim = high & ~scipy.ndimage.binary_erosion(high)
    step = surface - scipy.ndimage.minimum_filter(surface, 3, mode="nearest")
    known = np.asarray(scipy.ndimage.median(step[rim], names[rim], np.arange(1, count + 1)))
    return np.nan_to_num(known)


def _halve(low: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lowest of every 2 × 2 cells, NaN where none is known."""
    rows, cols = (-(-n // 2) * 2 for n in low.shape)
    whole = np.full((rows, cols), np.inf)
    whole[: low.shape[0], : low.shape[1]] = np.where(np.isnan(low), np.inf, low)
    least = whole.reshape(rows // 2, 2, cols // 2, 2).min(axis=(1, 3))
    return np.where(np.isinf(least), np.nan, least)
