"""Oriented normals: walls point outward, undersides down; support is bounded."""

from __future__ import annotations

import numpy as np
import pytest

from fwclass import conf
from fwclass.features.orientation import sides
from fwclass.features.params import NORMAL
from fwclass.features.spheres import spheres
from fwclass.features.stage import oriented_inclination
from fwclass.grid import Tile, TileGrid
from fwclass.schema import Scale, Table
from fwclass.stage import Chunk

PARAMS = conf.section("features")
RADIUS = 0.6
SCALE = Scale("r", 60)


def sheet(rng, u, v, density=60.0):
    """Random points of the rectangle between two corners; one coordinate is the same in both."""
    low, high = np.minimum(u, v), np.maximum(u, v)
    size = high - low
    area = np.prod(size[size > 0])
    return rng.uniform(low, high, (int(area * density), 3))


def chunk_of(points):
    x, y, z = (points + np.array([500_000.0, 5_400_000.0, 100.0])).round(3).T
    return Chunk(Table({"x": x, "y": y, "z": z}), np.arange(len(x)), Tile(0, 0, 1e7))


def oriented(points, rounds=20, radius=RADIUS):
    """Signed unit normals."""
    chunk = chunk_of(points)
    params = PARAMS.model_copy(update={"normal_radius": radius, "orientation_rounds": rounds})
    found = spheres(chunk, {}, params)
    normals = np.stack([found[n] for n in NORMAL], axis=1).astype(float)
    side = sides(chunk, normals, radius, rounds)
    return normals * np.where(side == 0, 1, side)[:, None], side


def house(rng, size=6.0, height=4.0):
    """A closed box on open ground, and the rows of its parts."""
    ground = sheet(rng, [-6, -6, 0], [12, 12, 0])
    inside = (np.abs(ground[:, :2] - size / 2) < size / 2).all(1)
    parts = {
        "ground": ground[~inside],
        "roof": sheet(rng, [0, 0, height], [size, size, height]),
        "west": sheet(rng, [0, 0, 0], [0, size, height]),
        "east": sheet(rng, [size, 0, 0], [size, size, height]),
        "south": sheet(rng, [0, 0, 0], [size, 0, height]),
        "north": sheet(rng, [0, size, 0], [size, size, height]),
    }
    label = np.concatenate([np.full(len(p), k) for k, p in parts.items()])
    return np.concatenate(list(parts.values())), label


OUTWARD = {"west": (-1, 0, 0), "east": (1, 0, 0), "south": (0, -1, 0), "north": (0, 1, 0), "roof": (0, 0, 1)}


def test_walls_of_a_closed_box_point_outward():
    points, label = house(np.random.default_rng(5))
    normals, _ = oriented(points)
    for part, out in OUTWARD.items():
        agreement = normals[label == part] @ np.array(out)
        assert (agreement > 0).mean() > 0.99, part


def test_without_rounds_the_walls_side_is_a_toss():
    """The test above can fail."""
    points, label = house(np.random.default_rng(5))
    normals, side = oriented(points, rounds=0)
    walls = np.isin(label, ["west", "east", "south", "north"])
    right = np.concatenate([normals[label == w] @ np.array(OUTWARD[w]) > 0 for w in ("west", "east", "south", "north")])
    assert 0.2 < right.mean() < 0.9
    assert (side[walls] == 0).mean() > 0.7
    assert (side[label == "ground"] == 1).mean() > 0.8


def test_the_underside_of_a_balcony_points_down():
    """A slab 2 m thick that juts out of a wall 4 m above the ground: its underside is not open to the sky."""
    rng = np.random.default_rng(7)
    ground = sheet(rng, [0, 0, 0], [14, 8, 0])
    wall = sheet(rng, [0, 0, 0], [0, 8, 4])
    under = sheet(rng, [0, 0, 4], [4, 8, 4])
    front = sheet(rng, [4, 0, 4], [4, 8, 6])
    top = sheet(rng, [-4, 0, 6], [4, 8, 6])
    points = np.concatenate([under, ground, wall, front, top])
    chunk = chunk_of(points)
    got = oriented_inclination(chunk, SCALE, PARAMS.model_copy(update={"orientation_rounds": 12}))[: len(under)]
    middle = (np.abs(under[:, 1] - 4) < 3) & (np.abs(under[:, 0] - 2) < 1.2)
    assert (got[middle] > 170).mean() > 0.99
    top_angle = oriented_inclination(chunk, SCALE, PARAMS)[-len(top) :]
    assert np.nanmedian(top_angle) < 1.0


def test_a_side_goes_no_further_than_a_radius_per_round():
    rng = np.random.default_rng(11)
    ground = sheet(rng, [0, 0, 0], [8, 6, 0])
    wall = sheet(rng, [0, 0, 0], [0, 6, 12])
    points = np.concatenate([ground, wall])
    for rounds in (2, 5, 9):
        _, side = oriented(points, rounds)
        reached = points[len(ground) :][side[len(ground) :] != 0, 2]
        assert reached.max() <= (rounds + 2) * RADIUS
        assert reached.max() > (rounds - 1) * RADIUS * 0.7  # the foot of the wall is not open itself


def test_order_of_rows_and_tiles_do_not_matter():
    points, _ = house(np.random.default_rng(13))
    table = chunk_of(points).table
    params = PARAMS.model_copy(update={"orientation_rounds": 4})
    whole = oriented_inclination(Chunk(table, np.arange(table.rows), Tile(0, 0, 1e7)), SCALE, params)
    mixed = np.random.default_rng(1).permutation(table.rows)
    other = oriented_inclination(Chunk(table.take(mixed), np.arange(table.rows), Tile(0, 0, 1e7)), SCALE, params)
    np.testing.assert_array_equal(other, whole[mixed])
    reach = RADIUS * (1 + params.orientation_rounds)
    for tile in TileGrid(5.0).touching(box_of(table)):
        near = np.flatnonzero(tile.box.grown(reach).contains(table["x"], table["y"]))
        core = np.flatnonzero(tile.box.contains(table["x"][near], table["y"][near]))
        got = oriented_inclination(Chunk(table.take(near), core, tile), SCALE, params)
        np.testing.assert_array_equal(got, whole[near[core]])


def box_of(table):
    from fwclass.grid import Box

    return Box(table["x"].min(), table["y"].min(), table["x"].max() + 1, table["y"].max() + 1)


def test_no_normal_no_angle_and_no_rows():
    empty = chunk_of(np.empty((0, 3)))
    assert len(oriented_inclination(empty, SCALE, PARAMS)) == 0
    lone = chunk_of(np.array([[0.0, 0, 0], [50, 0, 0]]))
    assert np.isnan(oriented_inclination(lone, SCALE, PARAMS)).all()


@pytest.mark.parametrize("slope", [0.0, 20.0, 50.0])
def test_open_slopes_point_up(slope):
    rng = np.random.default_rng(17)
    xy = rng.uniform(0, 8, (3000, 2))
    points = np.column_stack([xy, np.tan(np.radians(slope)) * xy[:, 0]])
    points = np.concatenate([points, sheet(rng, [-6, 0, 0], [0, 8, 0])])  # level ground at its foot
    got = oriented_inclination(chunk_of(points), SCALE, PARAMS)[:3000]
    inner = (xy > 1).all(1) & (xy[:, 0] < 4) & (xy[:, 1] < 7)
    assert np.nanmedian(got[inner]) == pytest.approx(slope, abs=0.3)
    assert np.nanmax(got[inner]) < 90
