"""Footprints and tree tops against what the simulator built: shares, intersection over union, doubles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyogrio.raw
import shapely
from scipy.spatial import cKDTree

LEAST = 30.0
"""m2, of the buildings that are counted."""

TALL = 5.0
"""m, of the trees that are counted."""


def true_buildings(truth: Path) -> tuple[np.ndarray, np.ndarray]:
    """The buildings' outlines, and whether each was surveyed whole."""
    _, _, geometry, fields = pyogrio.raw.read(truth, layer="buildings", columns=["building", "whole"])
    parts, (building, whole) = shapely.from_wkb(geometry), fields
    numbers = np.unique(building)
    outlines = np.array([shapely.union_all(parts[building == n]) for n in numbers])
    return outlines, np.array([bool(whole[building == n].all()) for n in numbers])


def scored(found: np.ndarray, truth: Path) -> dict[str, float]:
    """Polygons against all buildings of `LEAST` and more that were surveyed whole.

    A building is `found` where polygons cover half of it, `split` where two cover a tenth of it each; `iou` is the mean
    over the buildings, of the polygon that covers most of each; `joint_iou` of all area. A polygon is `false` where
    less than half of it is built over, and `doubled` counts pairs that share a hundredth.
    """
    outlines, whole = true_buildings(truth)
    tree, sizes = shapely.STRtree(found), shapely.area(outlines)
    counted = np.flatnonzero(whole & (sizes >= LEAST))
    seen, split, ious = 0, 0, []
    for k in counted:
        near = found[tree.query(outlines[k], predicate="intersects")]
        shares = shapely.area(shapely.intersection(near, outlines[k]))
        seen += bool(shares.sum() >= 0.5 * sizes[k])
        split += int((shares >= 0.1 * sizes[k]).sum() > 1)
        best = int(np.argmax(shares)) if len(near) else 0
        ious.append(shares[best] / (shapely.area(near[best]) + sizes[k] - shares[best]) if len(near) else 0.0)
    one, other = tree.query(found, predicate="overlaps")
    shared = shapely.area(shapely.intersection(found[one], found[other]))
    twice = (shared > 0.01 * np.minimum(shapely.area(found[one]), shapely.area(found[other]))) & (one < other)
    inside = shapely.union_all(found[~shapely.intersects(found, shapely.union_all(outlines[~whole]))])
    true = shapely.union_all(outlines[whole])
    built = shapely.area(shapely.intersection(found, shapely.union_all(outlines)))
    return {
        "buildings": len(counted),
        "found": seen / len(counted),
        "iou": float(np.mean(ious)),
        "joint_iou": float(shapely.area(inside & true) / shapely.area(inside | true)),
        "false": int((built < 0.5 * shapely.area(found)).sum()),
        "split": split,
        "doubled": int(twice.sum()),
        "invalid": int((~shapely.is_valid(found)).sum()),
    }


def scored_trees(x: np.ndarray, y: np.ndarray, height: np.ndarray, truth: Path) -> dict[str, float]:
    """Tops against all stems of `TALL` and more that were surveyed, each taken once, nearest pairs first.

    A top is a stem's as near as half the width of its crown, and 2 m at least. Others are `false`, of those as tall and
    half a metre more; `open` stems are those that no other crown rises over; `spread` and `bias` are of heights [m].
    """
    _, _, geometry, (tall, crown, whole, overtopped) = pyogrio.raw.read(
        truth, layer="trees", columns=["height", "crown", "whole", "overtopped"]
    )
    stems = shapely.get_coordinates(shapely.from_wkb(geometry))
    near = np.maximum(0.5 * crown, 2.0)
    pairs = cKDTree(np.c_[x, y]).query_ball_point(stems, near)
    ends = [(np.hypot(*(stems[n] - (x[k], y[k]))), n, k) for n, some in enumerate(pairs) for k in some]
    top_of, stem_of = {}, {}
    for _, n, k in sorted(ends):
        if n not in top_of and k not in stem_of:
            top_of[n], stem_of[k] = k, n
    counted = np.flatnonzero((tall >= TALL) & whole.astype(bool))
    off = np.array([height[top_of[n]] - tall[n] for n in counted if n in top_of])
    clear = [n for n in counted if not overtopped[n]]
    free = [k for k in range(len(x)) if k not in stem_of and height[k] >= TALL + 0.5]
    return {
        "stems": len(counted),
        "found": len(off) / len(counted),
        "open": len(clear) / len(counted),
        "found_open": sum(n in top_of for n in clear) / len(clear),
        "false": len(free) / max(1, len(free) + len(off)),
        "bias": float(np.median(off)),
        "spread": float(np.std(off)),
    }


def scored_run(run: Path, truth: Path) -> tuple[dict[str, float], dict[str, float]]:
    """Buildings and trees that a run delivered."""
    buildings = shapely.from_wkb(pyogrio.raw.read(run / "vectors.gpkg", layer="buildings")[2])
    _, _, places, (height,) = pyogrio.raw.read(run / "vectors.gpkg", layer="trees", columns=["height"])
    x, y = shapely.get_coordinates(shapely.from_wkb(places)).T
    return scored(buildings, truth), scored_trees(x, y, height, truth)
