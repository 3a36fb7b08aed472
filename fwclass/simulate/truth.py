"""What stands in the simulated town: the outlines of its buildings' parts, and its trees."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray
from pyproj import CRS

from fwclass.formats.gdal import write_shapes
from fwclass.formats.wkb import point_wkb, polygon_wkb
from fwclass.pieces import linked_groups
from fwclass.simulate.city import build_scene
from fwclass.simulate.params import SimulateParams
from fwclass.simulate.scene import BUILDING, CONE, HIGH, Scene, terrain

TRUTH = "truth.gpkg"


def parts_of_buildings(scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """Plans of all solids that buildings are made of (roofs with their overhang, walls, chimneys): corners
    (parts, 4, 2) [m], counterclockwise; the building of each, parts that overlap being one; tops [m]."""
    solids = np.flatnonzero(scene.solid_class == BUILDING)
    sides = scene.planes[scene.plane_start[solids][:, None] + np.arange(4)][:, (0, 2, 1, 3)]  # around, not in pairs
    ahead = np.roll(sides, -1, axis=1)
    across = sides[..., 0] * ahead[..., 1] - sides[..., 1] * ahead[..., 0]
    x = (sides[..., 3] * ahead[..., 1] - ahead[..., 3] * sides[..., 1]) / across
    y = (sides[..., 0] * ahead[..., 3] - ahead[..., 0] * sides[..., 3]) / across
    corners = np.stack([x, y], axis=-1)
    box = scene.box[solids]
    reach = np.hypot(box[:, 3] - box[:, 0], box[:, 4] - box[:, 1]).max(initial=0.0)  # boxes that meet are no further
    centres = scipy.spatial.cKDTree(0.5 * (box[:, :2] + box[:, 3:5]))
    one, other = centres.query_pairs(reach, output_type="ndarray").T
    for low, high in ((0, 3), (1, 4)):
        near = (box[one, low] <= box[other, high]) & (box[other, low] <= box[one, high])
        one, other = one[near], other[near]
    meet = [_overlap(corners[a], corners[b]) for a, b in zip(one.tolist(), other.tolist(), strict=True)]
    one, other = one[np.array(meet, bool)], other[np.array(meet, bool)]
    return corners, linked_groups(len(solids), one, other), box[:, 5]


def _overlap(first: NDArray[np.float64], second: NDArray[np.float64]) -> bool:
    """Whether two convex polygons share area: no side of either separates them."""
    for polygon in (first, second):
        along = np.roll(polygon, -1, axis=0) - polygon
        normals = np.stack([along[:, 1], -along[:, 0]], axis=1)
        mine, theirs = normals @ first.T, normals @ second.T
        if ((mine.max(axis=1) <= theirs.min(axis=1)) | (theirs.max(axis=1) <= mine.min(axis=1))).any():
            return False
    return True


def trees_of(scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Every tree, (trees, 5): x, y of the stem, height of its top, its height above the terrain, diameter of the crown
    [m]; and whether another crown rises over its top."""
    stems = scene.box[: len(scene.solid_class)][scene.solid_class == HIGH]
    place = 0.5 * (stems[:, :2] + stems[:, 3:5])
    at = scipy.spatial.cKDTree(scene.crown[:, 1:3]).query_ball_point(place, 1e-6)
    crown = scene.crown[[min(rows) for rows in at]] if len(place) else scene.crown[:0]
    ground = [terrain(scene.height, scene.margin, scene.step, x, y) for x, y in place]
    trees = np.column_stack([place, crown[:, 4], crown[:, 4] - np.array(ground), 2.0 * crown[:, 5]])
    near = scipy.spatial.cKDTree(crown[:, 1:3]).query_ball_point(crown[:, 1:3], crown[:, 5].max(initial=0.0))
    return trees, np.array([_is_overtopped(one, crown[rows]) for one, rows in zip(crown, near, strict=True)], bool)


def _is_overtopped(crown: NDArray[np.float64], crowns: NDArray[np.float64]) -> bool:
    """Whether one of `crowns` (rows of `Scene.crown`) is higher above the top of `crown` than that."""
    shape, x, y, bottom, top, reach = crowns.T[:6]
    share = np.hypot(x - crown[1], y - crown[2]) / reach
    ellipsoid = 0.5 * (bottom + top) + 0.5 * (top - bottom) * np.sqrt(np.clip(1.0 - share**2, 0.0, None))
    height = np.where(shape == CONE, top - share * (top - bottom), ellipsoid)
    return bool(((share < 1.0) & (height > crown[4] + 1e-9)).any())


def write_truth(params: SimulateParams, out: Path) -> Path:
    """Write ``truth.gpkg``; returns its path.

    Layer `buildings`: the plan of every part (`building`: the number of what it belongs to, `top` [m], `whole`: no part
    of that building lies outside the survey area or in its gap). Layer `trees`: stems (`height` above the terrain,
    `crown` diameter [m], `whole`, `overtopped`: another crown rises over its top).
    """
    scene = build_scene(params)
    move, path = np.array([params.origin_x, params.origin_y]), out / TRUTH
    corners, building, top = parts_of_buildings(scene)
    out.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.stem}.part.gpkg")
    beside.unlink(missing_ok=True)
    crs = CRS.from_user_input(params.crs).to_wkt("WKT1_GDAL")
    inside = np.array([_is_inside(scene, part) for part in corners], bool)
    whole = np.bincount(building, ~inside)[building] == 0 if len(inside) else inside
    fields: dict[str, Any] = {"building": building, "top": top + params.base_height, "whole": whole}
    write_shapes(beside, "buildings", [polygon_wkb([part + move]) for part in corners], fields, crs)
    trees, overtopped = trees_of(scene)
    inside = np.array([_is_inside(scene, one[None, :2]) for one in trees], bool)
    fields = {"top": trees[:, 2] + params.base_height, "height": trees[:, 3], "crown": trees[:, 4], "whole": inside}
    fields["overtopped"] = overtopped
    write_shapes(beside, "trees", point_wkb(trees[:, 0] + move[0], trees[:, 1] + move[1]), fields, crs, "Point")
    return beside.replace(path)


def _is_inside(scene: Scene, points: NDArray[np.float64]) -> bool:
    """Whether all points (n, 2) [m] lie in the survey area and none in its gap."""
    x, y, cos, sin, half_length, half_width = scene.gap
    dx, dy = (points - (x, y)).T
    gap = (np.abs(dx * cos + dy * sin) < half_length) & (np.abs(dy * cos - dx * sin) < half_width)
    return bool(((points > 0.0) & (points < scene.size)).all() and not gap.any())
