"""Files that come, go or change: what they touch is made again, nothing else, and all is as from scratch."""

from __future__ import annotations

import shutil

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
from runmaker import delivered, looked, walk

from fwclass import conf
from fwclass.features.names import FeatureRequest, is_feature
from fwclass.grid import Box, TileGrid
from fwclass.store.row_digests import CELL
from fwclass.survey.numbering import NUMBERS, assign_numbers

pytestmark = pytest.mark.slow

TILE = 40.0
NAMES = ("height_range_c200", "height_above_ground")
REACH = FeatureRequest.of(n for n in NAMES if is_feature(n)).reach(conf.load("demo").features) + CELL
"""m: how far features read, and how finely a tile's pieces are told apart."""
SETTINGS = (f"tile.size={TILE:g}", f"survey.features=[{', '.join(NAMES)}]")


def cut(source, target, box, moved=0.0):
    """The points of `source` inside `box`, without waveforms, as a strip of its own."""
    cloud = laspy.read(source)
    inside = box.contains(np.asarray(cloud.x), np.asarray(cloud.y))
    assert inside.any()
    header = laspy.LasHeader(point_format=1, version="1.2")
    header.offsets, header.scales = cloud.header.offsets, cloud.header.scales
    made = laspy.LasData(header)
    for name in ("x", "y", "z", "intensity", "return_number", "number_of_returns", "gps_time", "classification"):
        made[name] = np.asarray(cloud[name])[inside]
    made.z = made.z + moved
    made.write(target)


@pytest.fixture(scope="module")
def first(survey, tmp_path_factory):
    """A survey of two strips and a corner of a third, in small tiles: (its directory, its run)."""
    place = tmp_path_factory.mktemp("changing")
    files = place / "survey"
    shutil.copytree(survey, files)
    cut(files / "strips" / "strip_01.las", files / "strips" / "strip_09.las", Box(512082, 5403082, 512090, 5403090))
    road, _ = walk(files, place / "run", *SETTINGS, "survey.crs=EPSG:25832")
    assert not road.failures, road.failures
    return files, place / "run"


def again(first, tmp_path, change):
    """The survey changed by `change(strips)`, run on top of the old run and from scratch: (computed parts, road, how
    the run stood before)."""
    files, root = tmp_path / "survey", tmp_path / "run"
    shutil.copytree(first[0], files)
    shutil.copytree(first[1], root, symlinks=True)
    change(files / "strips")
    settings = (*SETTINGS, "survey.crs=EPSG:25832")
    before = looked(files, root, *settings)
    road, _ = walk(files, root, *settings)
    assert not road.failures, road.failures
    made = {n for n, o in road.outcomes.items() if o.status == "computed"}
    assert made & before.states.keys() <= {n for n, s in before.states.items() if s.standing != "done"}
    fresh, _ = walk(files, tmp_path / "fresh", *settings)
    assert not fresh.failures
    assert delivered(root) == delivered(tmp_path / "fresh")
    computed: dict[str, set[str]] = {}
    for (stage, part), outcome in road.outcomes.items():
        if outcome.status == "computed":
            computed.setdefault(stage, set()).add(part)
    return computed, road, before


def touching(box):
    return {t.key for t in TileGrid(TILE).touching(box)}


INNER = Box(512017, 5403010, 512023, 5403016)
"""In the middle of its tile, out of reach of the others."""

EDGE = Box(512041, 5403010, 512047, 5403017)
"""Just east of a tile's edge, in reach of its western neighbour alone."""


@pytest.mark.parametrize("box", [pytest.param(INNER, marks=pytest.mark.slow), EDGE], ids=["inside", "at an edge"])
def test_an_added_strip_touches_its_tiles_and_their_halos_only(first, tmp_path, box):
    computed, road, before = again(first, tmp_path, lambda d: cut(d / "strip_02.las", d / "strip_05.las", box, 12.0))
    own = touching(box)
    assert len(own) == 1 and computed["tile"] == own
    assert before.ends == "nothing was made yet of strip_05.las"
    assert own == {part for (stage, part), s in before.states.items() if stage == "tile" and s.standing == "stale"}
    assert own <= computed["features"] <= touching(box.grown(REACH))
    near = touching(box.grown(2.0))
    assert near <= computed["features"], "a neighbour within the radius is made anew"
    assert computed["index"] == {"00005"} and all(p.startswith("00005-") for p in computed["decompose"])
    blocks = computed["ground-filter"]
    there = {part for stage, part in road.outcomes if stage == "ground-filter"}
    halo = 64.0
    assert blocks <= {t.key for t in TileGrid(64.0).touching(box.grown(halo + CELL))} & there
    if box is INNER:
        assert computed["features"] == own


@pytest.mark.slow
def test_a_changed_strip_changes_where_it_changed(first, tmp_path):
    """A redelivered file of the same name: only tiles in which its points differ."""

    def redeliver(strips):
        cloud = laspy.read(strips / "strip_09.las")
        cloud.intensity[0] += 1
        cloud.write(strips / "strip_09.las")

    computed, _, _ = again(first, tmp_path, redeliver)
    assert computed["tile"] == touching(Box(512082, 5403082, 512090, 5403090))
    assert computed["ground"] == computed["height"] == computed["tile"], "blocks are made anew, their flags are not"
    assert set(computed["publish-strip"]) >= {"strip_09"}


def test_a_removed_strip_leaves_nothing(first, tmp_path):
    computed, road, before = again(first, tmp_path, lambda d: (d / "strip_09.las").unlink())
    own = touching(Box(512082, 5403082, 512090, 5403090))
    assert computed["tile"] == own and "decompose" not in computed and "index" not in computed
    for tile in own:
        told = " ".join(r.text for r in before.states["tile", tile].reasons)
        assert "is no longer read (strip_09.las)" in told, told
    assert not (road.root / "laz" / "strips" / "strip_09.laz").exists()
    assert not (road.root / "store" / "decompose" / "00009-00000").exists()
    strips = {s for p in (road.root / "parquet").glob("*.parquet") for s in pq.read_table(p)["strip"].to_pylist()}
    assert strips == {1, 2}


def test_numbers_follow_names():
    assert assign_numbers(["strip_01", "strip_02", "strip_10"]) == {"strip_01": 1, "strip_02": 2, "strip_10": 10}
    some = [f"flight {d}_{n:03d}" for d in ("A", "B") for n in range(40)]
    found = assign_numbers(some)
    assert len(set(found.values())) == len(some) and all(0 <= n < NUMBERS for n in found.values())
    assert found["flight A_007"] + 1 == found["flight A_008"]
    assert assign_numbers(reversed(some)) == found


def test_numbers_stay_when_names_come_and_go():
    some = [f"line_{n}" for n in range(0, 300, 3)] + ["ferry", "calibration"]
    before = assign_numbers(some)
    for added in ("line_1", "aaa", "zzz", "line_298"):
        assert {n: k for n, k in assign_numbers([*some, added]).items() if n != added} == before
    assert assign_numbers(some[1:]).items() <= before.items()


def test_names_that_want_one_number_get_two():
    """The digits wrap around, so that these two want the same."""
    a, b = "strip_1", f"strip_{1 + NUMBERS}"
    found = assign_numbers([a, b])
    assert len(set(found.values())) == 2 and 1 in found.values()
    assert assign_numbers([b, a]) == found
