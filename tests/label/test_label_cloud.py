"""Labels from another cloud: the same pulse first, then the nearest point, then none."""

import numpy as np
from scipy.spatial import cKDTree

from fwclass.grid import Tile
from fwclass.label.params import LabelParams
from fwclass.label.stage import from_cloud, from_source
from fwclass.schema import Table
from fwclass.stage import Chunk

PARAMS = LabelParams(max_distance=1.0, max_move=0.075)


def chunk(**columns):
    table = Table(columns)
    return Chunk(table, np.arange(table.rows), Tile(0, 0, 100.0))


def cloud(xyz, time, classes):
    xyz = np.asarray(xyz, float)
    return Table({"x": xyz[:, 0], "y": xyz[:, 1], "z": xyz[:, 2], "gps_time": time, "source_class": classes})


def test_the_same_pulse_wins_over_a_nearer_point_of_another():
    c = chunk(x=[0.0], y=[0.0], z=[0.0], gps_time=[5.0])
    points = cloud([[0.1, 0, 0], [0.6, 0, 0]], [4.0, 5.0], [2, 6])
    assert from_cloud(c, points, PARAMS.max_distance)[0]["reference"].tolist() == [6]


def test_beyond_reach_there_is_no_label():
    c = chunk(x=[0.0, 0.0], y=[0.0, 0.0], z=[0.0, 10.0], gps_time=[5.0, np.nan])
    points = cloud([[1.2, 0, 0], [0, 0.999, 10.0]], [5.0, np.nan], [2, 6])
    assert from_cloud(c, points, PARAMS.max_distance)[0]["reference"].tolist() == [0, 6]
    assert from_cloud(c, points.take([]), PARAMS.max_distance)[0]["reference"].tolist() == [0, 0]


def test_without_times_it_is_the_nearest_point_as_a_kd_tree_finds_it():
    r = np.random.default_rng(3)
    at = np.round(r.uniform(0, 20, (800, 3)), 3)
    to = np.round(r.uniform(0, 20, (3000, 3)), 3)
    codes = r.integers(1, 7, 3000)
    c = chunk(x=at[:, 0], y=at[:, 1], z=at[:, 2], gps_time=np.full(800, np.nan))
    found = from_cloud(c, cloud(to, np.full(3000, np.nan), codes), PARAMS.max_distance)[0]["reference"]
    distance, row = cKDTree(to).query(at)
    np.testing.assert_array_equal(found, np.where(distance <= 1.0, codes[row], 0))


def test_heights_above_the_reference_are_counted():
    c = chunk(x=[0.0, 5.0, 9.0], y=[0.0] * 3, z=[0.304, -0.2, 50.0], gps_time=[np.nan] * 3)
    points = cloud([[0, 0, 0], [5, 0, 0]], [np.nan] * 2, [2, 6])
    above = from_cloud(c, points, PARAMS.max_distance)[1]
    assert above.sum() == 2 and above[100 + 30] == 1 and above[100 - 20] == 1


def test_the_source_s_own_class():
    c = chunk(source_class=[2, 6, 0])
    assert from_source(c)["reference"].tolist() == [2, 6, 0]
