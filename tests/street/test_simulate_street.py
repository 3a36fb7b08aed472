"""The simulated street: the same for the same seed, with everything that is confused with crowns."""

import numpy as np
import pytest
from streetmaker import config, drive

from fwclass.conf.street import scanner
from fwclass.street.scene import (
    BUILDING,
    CROWN,
    FURNITURE,
    GROUND,
    KERB_HEIGHT,
    PERSON,
    ROAD,
    SHINE,
    SHRUB,
    TRUNK,
    VEHICLE,
    build,
)
from fwclass.street.simulate import simulate_frames
from fwclass.street.trace_kernels import BOX, CAPSULE, CLUMP, GRAIN, LEAF, PART, PILLAR, ROAD_SHINE, trace


def frames(*settings, most=30):
    made = config(*settings)
    coming = simulate_frames(made.street_scene, scanner(made.street.scanner), made.street.mounting)
    return [next(coming) for _ in range(most)]


def test_the_same_seed_gives_the_same_street():
    for a, b in zip(frames(), drive(), strict=False):
        assert np.array_equal(a.ranges, b.ranges, equal_nan=True)
        assert np.array_equal(a.labels, b.labels)
        assert a.speed == b.speed


def test_returns_have_labels_and_others_none():
    for f in drive():
        assert np.array_equal(f.labels > 0, ~np.isnan(f.ranges))


def test_everything_stands_in_the_street():
    solids = build(config("street_scene.length=200").street_scene).solids
    kinds = set(solids[:, 1].astype(int))
    assert kinds >= {CROWN, BUILDING, SHRUB, TRUNK, FURNITURE, VEHICLE, PERSON}
    assert (np.diff(solids[:, 2]) >= 0).all()
    seen = set(np.unique(np.concatenate([f.labels for f in drive()])))
    assert seen >= {0, CROWN, ROAD, GROUND, BUILDING}


def test_the_road_lies_under_the_scanner_and_the_pavement_a_kerb_higher():
    f = drive()[10]
    angle = f.scan.first + f.scan.step * np.arange(f.scan.beams)
    z = f.ranges * np.sin(angle)
    assert np.median(z[f.labels == ROAD]) == np.clip(np.median(z[f.labels == ROAD]), -1.85, -1.7)
    assert np.median(z[f.labels == GROUND]) - np.median(z[f.labels == ROAD]) > 0.5 * KERB_HEIGHT


def test_bare_trees_send_back_less():
    crowns = [
        sum((f.labels == CROWN).sum() for f in frames(f"street_scene.leaves={v}", most=60)) for v in (True, False)
    ]
    assert crowns[1] < 0.9 * crowns[0]


def test_the_vehicle_stands_as_often_as_asked():
    stops = sum(f.speed == 0 for f in drive())
    assert stops == round(config().street_scene.stop_seconds / 0.025)


LIT = "street_scene.intensity=200"


def test_intensities_change_neither_ranges_nor_labels_and_stand_where_returns_do():
    for a, b in zip(frames(LIT), drive(), strict=False):
        assert np.array_equal(a.ranges, b.ranges, equal_nan=True) and np.array_equal(a.labels, b.labels)
        assert np.array_equal(np.isnan(a.intensities), np.isnan(a.ranges)) and b.intensities is None
        assert np.nanmin(a.intensities) >= 0 and np.nanmax(a.intensities) <= 200


def lit(solids, angles, height=1.8, **changed):
    """Ranges and intensities of a scan that looks to the left, of `solids` and the road alone."""
    beams = len(angles)
    asked = {"lean": 0.0, "kerb": 1e6, "rise": 0.0} | changed
    ranges, labels, light = np.empty(beams, np.float32), np.empty(beams, np.uint8), np.empty(beams, np.float32)
    seeds = np.random.default_rng(1).integers(1, 2**63, beams, dtype=np.uint64)
    trace(
        *(solids, np.arange(len(solids)), 0.0, height, angles, 1.0, 0.0, 0.0, *asked.values(), 0.0, 0.0, 0.0, 30.0),
        *(seeds, ranges, labels, light),
    )
    return ranges, light


def solid(*values, shine):
    row = np.zeros((1, PART))
    row[0, : len(values)], row[0, -1] = values, shine
    return row


@pytest.mark.parametrize("depth", [3.0, 12.0])
def test_a_wall_shines_by_its_reflectance_and_the_cosine_whatever_the_range(depth):
    angles = np.linspace(-0.1, 1.1, 50)
    wall = solid(BOX, BUILDING, -1, 1, depth, depth + 1, 0, 50, 1, shine=0.5)
    ranges, light = lit(wall, angles)
    np.testing.assert_allclose(ranges, depth / np.cos(angles), rtol=1e-5)
    np.testing.assert_allclose(light, 0.5 * np.cos(angles), rtol=GRAIN)
    assert np.ptp(light / np.cos(angles)) > 0.5 * GRAIN


def test_the_road_shines_by_the_cosine_of_its_own_lean():
    angles = np.linspace(-1.5, -0.2, 50)
    lean = 0.1
    _, light = lit(np.zeros((0, PART)), angles, lean=lean)
    cosine = np.cos(angles + np.pi / 2 - np.arctan(lean))
    np.testing.assert_allclose(light, ROAD_SHINE * np.abs(cosine), rtol=GRAIN)


@pytest.mark.parametrize(
    "round_thing",
    [
        solid(PILLAR, TRUNK, -1, 1, 0.0, 5.0, 0.3, 0, 9, shine=0.4),
        solid(CAPSULE, TRUNK, -1, 1, 0.0, 5.0, 0.0, 0.0, 5.0, 9.0, 0.3, shine=0.4),
    ],
    ids=["pillar", "capsule"],
)
def test_a_trunk_met_in_its_middle_shines_as_a_wall(round_thing):
    angles = np.linspace(0.0, 0.6, 20)
    _, light = lit(round_thing, angles)
    np.testing.assert_allclose(light, 0.4 * np.cos(angles), rtol=GRAIN + 0.01)


def test_leaves_shine_by_two_thirds_of_the_cosine_and_the_part_of_the_spot_that_they_fill():
    angles = np.linspace(-0.05, 0.05, 4000)
    leaves = solid(CLUMP, CROWN, -2, 2, 0.0, 5.0, 1.8, 1.5, 0.1, shine=0.5)
    _, light = lit(leaves, angles)
    here = light[~np.isnan(light)]
    # the mean of the square root of a share is 2/3, its variance 1/18; that of the filled part (1 + LEAF) / 2
    assert np.mean(here) == pytest.approx(0.5 * 2 / 3 * (1 + LEAF) / 2, rel=5 * 0.5 / np.sqrt(len(here)))
    assert here.max() <= 0.5 * (1 + GRAIN) and here.std() > 0.3 * here.mean()


def test_bark_of_a_crown_is_darker_than_its_leaves():
    solids = build(config("street_scene.length=100").street_scene).solids
    crown = solids[:, 1] == CROWN
    limbs, leaves = solids[crown & (solids[:, 0] == CAPSULE), -1], solids[crown & (solids[:, 0] == CLUMP), -1]
    assert limbs.max() < leaves.min()
    for k, (low, high) in SHINE.items():
        mine = solids[(solids[:, 1] == k) & (solids[:, 0] != CAPSULE), -1]
        assert low <= mine.min() and mine.max() <= high
