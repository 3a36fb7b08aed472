"""Heights and tilts of strips: those that were put in come out, within what their errors say; none out of nothing."""

from __future__ import annotations

import numpy as np
import pytest

from fwclass.quality.adjust import Pairs, adjust
from fwclass.quality.pieces import PlacedStrip

NOISE = 0.02


def strip(x: float, y: float, along: tuple[float, float], half: tuple[float, float]) -> PlacedStrip:
    return PlacedStrip((0,), 1000, None, (x, y), along, True, half)


def network(cross: bool) -> list[PlacedStrip]:
    """Three lines side by side, 800 m wide and 4 km long, every second one flown back, and perhaps one across."""
    lines = [strip(560.0 * k, 2000.0, (0.0, 1.0 - 2 * (k % 2)), (400.0, 2000.0)) for k in range(3)]
    return [*lines, strip(560.0, 2000.0, (1.0, 0.0), (400.0, 960.0))] if cross else lines


def pairs_of(strips: list[PlacedStrip], truth: np.ndarray, noise: float, rng: np.random.Generator) -> Pairs:
    """Pairs wherever two strips overlap, lifted by `truth` (strips, 3)."""
    rows = []
    for a in range(len(strips)):
        for b in range(a + 1, len(strips)):
            x, y = rng.uniform(-400, 1520, 2000), rng.uniform(0, 4000, 2000)
            ua, va = strips[a].within(x, y)
            ub, vb = strips[b].within(x, y)
            both = np.maximum.reduce(np.abs([ua, va, ub, vb])) <= 1
            lift = [h + r * u + p * v for (h, r, p), u, v in ((truth[a], ua, va), (truth[b], ub, vb))]
            n = int(both.sum())
            dz = (lift[0] - lift[1])[both] + rng.normal(0, noise, n)
            rows.append((np.full(n, a), np.full(n, b), x[both], y[both], dz, np.ones(n)))
    return Pairs(*(np.concatenate(column) for column in zip(*rows, strict=True)))


def seen_part(strips: list[PlacedStrip], pairs: Pairs, truth: np.ndarray) -> np.ndarray:
    """What the pairs say of `truth`: of all that explain them as well that of the least tilts, then of the least lifts,
    by numpy's pseudo-inverse."""
    design = np.zeros((len(pairs.dz), 3 * len(strips)))
    for k, (a, b, x, y) in enumerate(zip(pairs.first, pairs.second, pairs.x, pairs.y, strict=True)):
        for n, sign in ((a, 1), (b, -1)):
            design[k, 3 * n : 3 * n + 3] = sign * np.array([1.0, *(float(w) for w in strips[n].within(x, y))])
    cheap = np.tile([1e3, 1.0, 1.0], len(strips))  # an unknown of this unit is cheaper: lifts take what tilts need not
    return cheap.reshape(-1, 3) * (np.linalg.pinv(design * cheap, rcond=1e-8) @ (design @ truth.ravel())).reshape(-1, 3)


@pytest.mark.parametrize("cross", [False, True])
def test_heights_and_tilts_come_out_as_exactly_as_their_errors_say(cross: bool) -> None:
    off = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        strips = network(cross)
        truth = rng.normal(0, 0.05, (len(strips), 3))
        pairs = pairs_of(strips, truth, NOISE, rng)
        made = adjust(strips, pairs, 1.0)
        assert np.isfinite(made.values).all() and made.sigma == pytest.approx(NOISE, rel=0.05)
        off.append((made.values - seen_part(strips, pairs, truth)) / made.errors)
    share = (np.abs(off) < 3).mean()
    assert share > 0.98 and np.abs(off).max() < 4 and 0.7 < np.sqrt(np.square(off).mean()) < 1.3


@pytest.mark.parametrize("lines", [2, 3])
def test_a_lift_of_an_outer_line_tilts_nothing(lines: int) -> None:
    """Without a line across a tilt of all would explain it as well."""
    strips, truth = network(False)[:lines], np.zeros((lines, 3))
    truth[0] = 0.1, 0.0, 0.0
    made = adjust(strips, pairs_of(strips, truth, NOISE, np.random.default_rng(7)), 0.05)
    assert made.values[0, 0] - made.values[1:, 0].mean() == pytest.approx(0.1, abs=0.006)
    assert np.nanmax(np.abs(made.values[:, 1:])) < 0.006 and np.abs(made.values[:, 0].mean()) < 1e-6


def test_a_lift_of_one_line_is_told_to_the_millimetre() -> None:
    strips, truth = network(True), np.zeros((4, 3))
    truth[1] = 0.12, 0.0, 0.0
    made = adjust(strips, pairs_of(strips, truth, NOISE, np.random.default_rng(1)), 0.05)
    lifts = made.values[:, 0] - made.values[[0, 2, 3], 0].mean()
    assert lifts[1] == pytest.approx(0.12, abs=0.006) and np.abs(lifts[[0, 2, 3]]).max() < 0.006
    assert np.abs(made.values[:, 1:]).max() < 0.006


def test_nothing_stays_nothing() -> None:
    strips = network(True)
    made = adjust(strips, pairs_of(strips, np.zeros((4, 3)), NOISE, np.random.default_rng(2)), 0.05)
    assert (np.abs(made.values) < 3.5 * made.errors).all() and np.abs(made.values).max() < 0.006
    exact = adjust(strips, pairs_of(strips, np.zeros((4, 3)), 0.0, np.random.default_rng(2)), 0.05)
    assert np.abs(exact.values).max() == 0.0 and exact.left == 0.0


def test_what_all_strips_have_in_common_is_not_told() -> None:
    strips = network(True)
    pairs = pairs_of(strips, np.array([[0.5, 0.0, 0.0]] * 4), NOISE, np.random.default_rng(3))
    assert np.abs(adjust(strips, pairs, 0.05).values).max() < 0.006


def test_outliers_move_nothing() -> None:
    rng, strips = np.random.default_rng(4), network(True)
    pairs = pairs_of(strips, np.zeros((4, 3)), NOISE, rng)
    pairs.dz[::10] += 0.7  # grass that grew, lorries
    made = adjust(strips, pairs, 0.05)
    assert np.abs(made.values).max() < 0.005 and made.sigma < 0.03 and made.left > 0.2


def test_the_order_of_pairs_changes_nothing() -> None:
    rng, strips = np.random.default_rng(5), network(True)
    pairs = pairs_of(strips, rng.normal(0, 0.05, (4, 3)), NOISE, rng)
    order = rng.permutation(len(pairs.dz))
    other = Pairs(*(getattr(pairs, n)[order] for n in ("first", "second", "x", "y", "dz", "weight")))
    assert (adjust(strips, pairs, 0.05).values == adjust(strips, other, 0.05).values).all()


def test_few_pairs_tell_no_tilt_and_none_tell_nothing() -> None:
    strips = network(False)
    rng = np.random.default_rng(6)
    some = pairs_of(strips, np.zeros((3, 3)), NOISE, rng)
    few = Pairs(*(getattr(some, n)[some.first == 0][:12] for n in ("first", "second", "x", "y", "dz", "weight")))
    made = adjust(strips, few, 0.003)
    assert np.isfinite(made.values[:2, 0]).all() and np.isnan(made.values[2]).all() and made.pairs.tolist()[2] == 0
    assert np.isnan(made.values[:2, 1:]).all()
    one = Pairs(*(getattr(some, n)[:0] for n in ("first", "second", "x", "y", "dz", "weight")))
    nothing = adjust(strips, one, 0.05)
    assert np.isnan(nothing.values).all() and np.isnan(nothing.sigma) and np.isnan(nothing.left)
