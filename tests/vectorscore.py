"""Footprints and tree tops against what the simulator built: shares, intersection over union, doubles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyogrio.raw
import shapely

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

    A building is found where polygons cover half of it. Its `iou` is with all polygons that lie in it for half of their
    area or cover half of it; `joint_iou` is of the whole area. A polygon is `false` where it covers less than half of
    itself in buildings, and a building is `doubled` where two polygons share area, or cover a tenth of it each.
    """
    outlines, whole = true_buildings(truth)
    tree = shapely.STRtree(found)
    counted = np.flatnonzero(whole & (shapely.area(outlines) >= LEAST))
    seen, ious, doubled = 0, [], 0
    for k in counted:
        near = found[tree.query(outlines[k], predicate="intersects")]
        shares = shapely.area(shapely.intersection(near, outlines[k]))
        seen += bool(shares.sum() >= 0.5 * shapely.area(outlines[k]))
        doubled += int((shares >= 0.1 * shapely.area(outlines[k])).sum() > 1)
        best = near[np.argmax(shares)] if len(near) else shapely.Polygon()
        both = shapely.area(shapely.intersection(best, outlines[k]))
        ious.append(both / (shapely.area(best) + shapely.area(outlines[k]) - both))
    built = shapely.union_all(outlines)
    pairs = tree.query(found, predicate="overlaps")
    edge = shapely.union_all(outlines[~whole]) if (~whole).any() else shapely.Polygon()
    inside = found[~shapely.intersects(found, edge)]
    true = shapely.union_all(outlines[whole])
    joint = shapely.union_all(inside)
    return {
        "buildings": len(counted),
        "found": seen / len(counted),
        "iou": float(np.mean(ious)),
        "joint_iou": shapely.area(shapely.intersection(joint, true)) / shapely.area(shapely.union(joint, true)),
        "area": shapely.area(joint) / shapely.area(true),
        "false": int((shapely.area(shapely.intersection(found, built)) < 0.5 * shapely.area(found)).sum()),
        "doubled": doubled,
        "overlapping": int((pairs[0] < pairs[1]).sum()),
        "invalid": int((~shapely.is_valid(found)).sum()),
    }
