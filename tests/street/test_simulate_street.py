"""The simulated street: the same for the same seed, with everything that is confused with crowns."""

import numpy as np
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
    SHRUB,
    TRUNK,
    VEHICLE,
    build,
)
from fwclass.street.simulate import simulate_frames


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
