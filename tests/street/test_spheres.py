"""The spheres of the variable-scale grid are those of a k-d tree over the same frames, and so are their features."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from streetmaker import with_features

from fwclass import conf
from fwclass.street.frames import Frame, Geometry, Scan, levels_of
from fwclass.street.sphere_kernels import UNIT
from fwclass.street.track import Track


def street_params(**changed):
    base = conf.section("street")
    mounting = base.mounting.model_copy(update=changed.pop("mounting", {}))
    return base.model_copy(update={"speed": 1.0, "mounting": mounting, **changed})


def random_frames(seed, count, beams, steps, wide=270.0, far=6.0, full=None):
    """Ranges between the scanner itself and `far`, a tenth missing in every way; `steps` along the road [m];
    intensities from below 0 to beyond `full`."""
    rng = np.random.default_rng(seed)
    step = np.radians(wide) / (beams - 1)
    scan = Scan(beams, -np.radians(wide) / 2, step, 0.05, far)
    place = 0.0
    for k in range(count):
        knots = np.arange(0, beams + 40, 40)
        smooth = np.interp(np.arange(beams), knots, rng.uniform(0.06, far, len(knots)))
        ranges = (smooth + rng.normal(0, 0.03, beams)).astype(np.float32)
        ranges[rng.random(beams) < 0.1] = rng.choice([np.nan, np.inf, 0.0, 99.0])
        place += steps[k]
        light = None if full is None else rng.uniform(-0.1 * full, 1.1 * full, beams).astype(np.float32)
        yield Frame(k, 0.025 * k, scan, ranges, place=place, intensities=light)


def by_tree(frames, seen_frame, radius, most):
    """Members of every return of a frame: a k-d tree over the frames that are held, in whole units."""
    at = next(k for k, f in enumerate(frames) if f.number == seen_frame.frame.number)
    reach = radius / UNIT
    first = last = at
    while first > 0 and at - first < most and abs(frames[first - 1].place - frames[at].place) <= reach * seen_reach:
        first -= 1
    while (
        last + 1 < len(frames)
        and last - at < most
        and abs(frames[last + 1].place - frames[at].place) <= reach * seen_reach
    ):
        last += 1
    held = [points(f, frames[at].place) for f in frames[first : last + 1]]
    cloud = np.concatenate(held)
    cloud = np.column_stack([cloud, np.concatenate([levels(f) for f in frames[first : last + 1]])])
    own = points(frames[at], frames[at].place)
    lists = cKDTree(cloud[:, :3]).query_ball_point(own, np.sqrt(np.floor(reach**2)) + 1e-7) if len(own) else []
    return own, [cloud[i] for i in lists]


seen_reach = 1.0


def points(frame, origin):
    here = ~np.isnan(frame.r)
    x = frame.x[here] if len(frame.x) else np.zeros(here.sum())
    return np.stack([x + float(frame.place - origin), frame.y[here], frame.z[here]], axis=1).astype(float)


def levels(frame):
    return frame.light[~np.isnan(frame.r)] if len(frame.light) else np.zeros((~np.isnan(frame.r)).sum())


def check(frames, params):
    global seen_reach
    track = Track(params)
    placed = [p for f in frames if (p := track.take(f)) is not None]
    seen_reach = track.geometry.reach
    checked = 0
    for one in with_features(placed, track.geometry, params):
        if one.frame.number % 3:
            continue
        for k, radius in enumerate(params.radii):
            biggest = max(params.radii)
            own, members = by_tree(placed, one, biggest, params.most_frames)
            members = [
                m[((m[:, :3] - p) ** 2).sum(1) <= np.floor((radius / UNIT) ** 2)]
                for m, p in zip(members, own, strict=True)
            ]
            each = one.features.shape[1] // len(params.radii)
            got = one.features[~np.isnan(one.frame.r), each * k : each * (k + 1)]
            assert np.array_equal(got[:, 6], [len(m) for m in members])
            if len(got):
                expect(got[:, :11], [m[:, :3] * UNIT for m in members], own * UNIT)
                if each == 13:
                    near(got[:, 11:] * 1023, [(m[:, 3].mean(), m[:, 3].std()) for m in members], 1e-6, 1023e-6)
            checked += len(got)
    return checked


def expect(rows, members, centres):
    """Formulas of Li 2018, evaluated on the members of every row by themselves."""
    side = np.where(centres[:, 1] >= 0, 1.0, -1.0)
    mean = np.array([m.mean(axis=0) for m in members])
    spread = np.array([np.ptp(m, axis=0) for m in members])
    cov = np.array([(m - c).T @ (m - c) / len(m) for m, c in zip(members, mean, strict=True)])
    vertical = [mean[:, 2], cov[:, 2, 2], spread[:, 2]]
    near(rows[:, :6], np.column_stack([*vertical, side * mean[:, 1], cov[:, 1, 1], spread[:, 1]]), 1e-5, 1e-6)
    l3, l2, l1 = np.maximum(np.linalg.eigvalsh(cov), 0.0).T
    near(rows[:, 7], np.cbrt(l1 * l2 * l3), 1e-3, 2e-6)
    some = l1 > 1e-9
    g1, g2, g3 = np.sqrt([l1[some], l2[some], l3[some]])
    loose = np.where(l2 > 1e-4 * l1, 2e-3, 2e-2)[some, None]
    near(rows[some, 8:], np.column_stack([(g1 - g2) / g1, (g2 - g3) / g1, g3 / g1]), 0.0, loose)
    near(rows[some, 8:].sum(axis=1), 1.0, 0.0, 1e-5)


def near(got, wanted, relative, absolute):
    """As `pytest.approx`, which takes most of the time of ten thousand rows."""
    assert (np.abs(got - np.asarray(wanted)) <= np.maximum(relative * np.abs(wanted), absolute)).all(), (got, wanted)


@pytest.mark.statistics
@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.1, 0.3, 0.8]),
    st.sampled_from([0.0, 0.01, 0.025, 0.2, 1.0]),
    st.booleans(),
)
def test_spheres_hold_what_a_tree_finds(seed, radius, step, stops):
    rng = np.random.default_rng(seed)
    steps = step * rng.uniform(0.2, 1.8, 24)
    if stops:
        steps[8:14] = 0.0
    params = street_params(radii=(radius,), most_frames=7)
    assert check(list(random_frames(seed, 24, 80, steps)), params) > 100


@pytest.mark.parametrize("mounting", [{}, {"pitch": 10.0, "yaw": 15.0}])
def test_intensities_are_those_of_the_sphere(mounting):
    params = street_params(radii=(0.3, 0.6), most_frames=9, mounting=mounting, intensity=4095.0)
    assert check(list(random_frames(5, 20, 80, np.full(20, 0.06), full=4095.0)), params) > 100


def test_levels_of_intensities():
    light = np.array([np.nan, -5.0, 0.0, 127.5, 255.0, 300.0, np.inf], np.float32)
    assert levels_of(light, 255.0).tolist() == [0, 0, 0, 512, 1023, 1023, 1023]


@pytest.mark.parametrize(
    "mounting", [{"pitch": 20.0}, {"yaw": -35.0}, {"pitch": 10, "yaw": 15, "roll": 30, "side": "left"}]
)
def test_spheres_of_a_leaning_scanner(mounting):
    params = street_params(radii=(0.3, 0.6), most_frames=9, mounting=mounting)
    assert check(list(random_frames(5, 20, 80, np.full(20, 0.06))), params) > 100


@pytest.mark.parametrize("beams", [90, 300])  # of 300, more returns are within a window than 32 bits add up
def test_spheres_of_a_scanner_that_goes_full_circle(beams):
    params = street_params(radii=(0.5,), most_frames=9)
    frames = list(random_frames(6, 20, beams, np.full(20, 0.06), wide=360.0 * (beams - 1) / beams))
    assert frames[0].scan.wraps
    assert check(frames, params) > 100


def test_spheres_where_the_vehicle_goes_back():
    params = street_params(radii=(0.3,), most_frames=9)
    steps = np.r_[np.full(12, 0.07), np.full(12, -0.05)]
    assert check(list(random_frames(7, 24, 80, steps)), params) > 100


def test_the_window_of_the_paper_loses_members_near_the_scanner():
    frames = list(random_frames(8, 30, 540, np.full(30, 0.025), far=2.0))
    counts = []
    for window in ("exact", "paper"):
        params = street_params(radii=(0.8,), window=window)
        track = Track(params)
        placed = [track.take(f) for f in frames]
        rows = [s.features[:, 6].copy() for s in with_features(placed, track.geometry, params)]
        counts.append(np.concatenate(rows))
    exact, paper = (c[~np.isnan(c)] for c in counts)
    assert (paper <= exact).all()
    assert 0.02 < (paper < exact).mean() < 0.9


def test_the_tilted_kernel_gives_what_the_flat_one_gives():
    params = street_params(radii=(0.4,))
    track = Track(params)
    placed = [track.take(f) for f in random_frames(9, 30, 200, np.full(30, 0.03))]
    flat = [s.features.copy() for s in with_features(placed, track.geometry, params)]
    tilted = dataclasses.replace(track.geometry, tilted=True)
    with_x = [dataclasses.replace(p, x=np.zeros_like(p.y)) for p in placed]
    general = [s.features.copy() for s in with_features(with_x, tilted, params)]
    assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(flat, general, strict=True))


def test_a_radius_beyond_the_kernel_is_refused():
    from fwclass.errors import ConfigError

    with pytest.raises(ConfigError, match="radii"):
        conf.section("street", ("street.radii=[1.3]",))


def test_geometry_faces_the_side_it_is_told():
    scan = Scan(3, -np.pi / 2, np.pi / 2, 0.0, 10.0)
    right = Geometry.of(scan, street_params().mounting)
    left = Geometry.of(scan, street_params(mounting={"side": "left"}).mounting)
    assert right.direction[1] == pytest.approx([0, -1, 0])
    assert left.direction[1] == pytest.approx([0, 1, 0])
    assert right.direction[2] == pytest.approx([0, 0, 1])
