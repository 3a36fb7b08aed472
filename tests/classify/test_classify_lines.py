"""Echoes on lines against plain loops; what changes no answer; power lines that run through crowns."""

import numpy as np
import pytest

from fwclass import conf
from fwclass.classify.line_kernels import on_line
from fwclass.classify.lines import count_settled, needed, settle_lines
from fwclass.schema import Table

WIRE = 1
"""Number of the class of wires, of three."""


def params(**given):
    return conf.section("classify", tuple(f"classify.lines.{n}={v}" for n, v in given.items())).lines


def power_line(seed=1, spans=3, crowns=60, density=4.0):
    """x, y, z, first echoes, true wires and shares [1/255]: wires that sag between poles 40 m apart, half of them
    among leaves, where a model is not sure; ground; and leaves that it takes for wires."""
    r = np.random.default_rng(seed)
    length = 40.0 * spans
    parts = []
    for side in (-0.8, 0.0, 0.8):
        s = np.sort(r.uniform(0, length, int(length * density * 0.2)))
        height = 9.0 - 0.7 * (1 - (2 * (s % 40.0) / 40.0 - 1) ** 2)
        hidden = (s // 10) % 2 == 1
        share = np.where(hidden, r.integers(30, 110, len(s)), r.integers(150, 255, len(s)))
        parts.append((s, side + r.normal(0, 0.08, len(s)), height + r.normal(0, 0.03, len(s)), share, 1))
    n = int(length * 40 * density)
    parts.append((r.uniform(0, length, n), r.uniform(-20, 20, n), r.normal(0, 0.05, n), np.zeros(n, int), 0))
    leaves = r.uniform([0, -15, 4], [length, 15, 10], (crowns * 10, 3))
    parts.append((*leaves.T, np.where(r.random(len(leaves)) < 0.02, 140, r.integers(0, 60, len(leaves))), 0))
    x, y, z, share, true = (np.concatenate([np.broadcast_to(p[k], len(p[0])) for p in parts]) for k in range(5))
    turned = 0.6
    x, y = x * np.cos(turned) - y * np.sin(turned) + 1000.0, x * np.sin(turned) + y * np.cos(turned) + 2000.0
    table = Table({"x": x.round(3), "y": y.round(3), "z": z.round(3), "echo_number": np.ones(len(x), np.uint8)})
    other = np.where(z > 2, 2, 0)
    own = np.zeros((len(x), 3), np.uint8)
    own[:, WIRE] = share
    own[np.arange(len(x)), other] = 255 - share
    return table, own, true.astype(bool)


def settled(table, core, own, how=None, learned=None):
    """Shares afterwards, and how many have got the class and lost it."""
    shares = own[core] / 255.0
    after, _ = settle_lines(table, core, own, shares, WIRE, how or params(), learned)
    return after, *count_settled(shares.argmax(axis=1), after.argmax(axis=1), [WIRE])


def test_wires_among_leaves_join_and_leaves_that_look_like_wires_leave():
    table, own, true = power_line()
    every = np.arange(table.rows)
    after, joined, left = settled(table, every, own)
    before, now = own.argmax(axis=1) == WIRE, after.argmax(axis=1) == WIRE
    assert (before & true).sum() / true.sum() < 0.6
    assert (now & true).sum() / true.sum() > 0.9
    assert (now & true).sum() / now.sum() > 0.85
    assert joined == (now & ~before).sum() > 50
    assert left == (before & ~now).sum() > 0


def test_shares_are_exchanged_and_nothing_else_changes():
    table, own, _ = power_line()
    after, joined, left = settled(table, np.arange(table.rows), own)
    before = own / 255.0
    np.testing.assert_array_equal(np.sort(after, axis=1), np.sort(before, axis=1))
    assert (after != before).any(axis=1).sum() == joined + left


def test_echoes_that_the_model_learned_from_stay_and_say_where_lines_are():
    table, own, _ = power_line()
    every = np.arange(table.rows)
    learned = np.random.default_rng(5).random(table.rows) < 0.5
    whole, after = settled(table, every, own)[0], settled(table, every, own, learned=learned)[0]
    assert (whole[learned] != own[learned] / 255.0).any()
    np.testing.assert_array_equal(after[learned], own[learned] / 255.0)
    np.testing.assert_array_equal(after[~learned], whole[~learned])


def test_neither_order_nor_what_lies_beyond_the_halo_changes_an_answer():
    table, own, _ = power_line()
    every = np.arange(table.rows)
    whole = settled(table, every, own)[0]
    order = np.random.default_rng(3).permutation(every)
    np.testing.assert_array_equal(settled(table.take(order), every, own[order])[0], whole[order])
    halo = params().halo
    for west in np.arange(np.floor(table["x"].min()), table["x"].max(), 30.0):
        core = np.flatnonzero((table["x"] >= west) & (table["x"] < west + 30.0))
        near = np.flatnonzero((table["x"] >= west - halo) & (table["x"] < west + 30.0 + halo))
        part = settled(table.take(near), np.searchsorted(near, core), own[near])[0]
        np.testing.assert_array_equal(part, whole[core])


def test_where_pulses_are_few_nothing_changes():
    table, own, _ = power_line()
    thin = np.random.default_rng(2).random(table.rows) < 0.1
    own[np.arange(table.rows) % 97 == 0] = [30, 200, 25]
    rows = np.flatnonzero(thin)
    _, joined, left = settled(table.take(rows), np.arange(len(rows)), own[rows])
    assert (joined, left) == (0, 0)
    sparse = settle_lines(table.take(rows), np.arange(len(rows)), own[rows], own[rows] / 255.0, WIRE, params())[1]
    may = (own[rows, WIRE] >= 0.1 * 255) & (own[rows].argmax(axis=1) != WIRE)
    assert sparse == may.sum() > 0
    assert settled(table, np.arange(table.rows), own)[2] > 20, "dense enough, they leave"


def test_the_cells_needed_follow_the_pulses():
    x, y = (v.ravel() for v in np.meshgrid(np.arange(0, 60, 0.5), np.arange(0, 60, 0.5)))
    place = np.stack([1000 * x, 1000 * y, 0 * x], axis=1).astype(np.int64)
    how = params(reach=20, width=0.25, share=0.2, fewest=3)
    every, rows = np.ones(len(place), bool), np.arange(9)
    need = np.ceil(0.2 * 40 * (1 - np.exp(-0.25 * 4)))
    np.testing.assert_array_equal(needed(place, every, rows, how), [[need] * 9, [need / 2] * 9])
    one_of_four = (place[:, 0] % 1000 == 0) & (place[:, 1] % 1000 == 0)
    np.testing.assert_array_equal(needed(place, one_of_four, rows, how), [[3.0] * 9, [0.0] * 9])
    np.testing.assert_array_equal(needed(place, ~every, rows, how), [[np.inf] * 9, [0.0] * 9])


def plain(place, need, sure, reach, tolerance, sag, slope):
    """As `on_line`, echo by echo in metres."""
    answer = []
    for p, least in zip(place / 1000.0, need, strict=True):
        d = sure / 1000.0 - p
        flat = np.hypot(d[:, 0], d[:, 1])
        d, flat = d[flat <= reach], flat[flat <= reach]
        best = 0
        for a in np.flatnonzero((flat >= 3.0) & (np.abs(d[:, 2]) <= slope * flat)):
            along = d[:, :2] @ d[a, :2] / flat[a]
            beside = np.abs(d[:, 0] * d[a, 1] - d[:, 1] * d[a, 0]) / flat[a]
            above = np.abs(d[:, 2] - d[a, 2] / flat[a] * along)
            on = (np.abs(along) >= 0.5) & (beside <= tolerance)
            on &= above <= tolerance + sag * np.abs(along) * np.abs(along - flat[a])
            best = max(best, len(set(np.trunc(along[on]) + np.copysign(0.5, along[on]))))
        answer.append(best >= least)
    return np.array(answer)


@pytest.mark.parametrize("seed", range(4))
def test_lines_are_those_of_plain_loops(seed):
    r = np.random.default_rng(seed)
    sure = np.unique(r.integers(0, [30_000, 6_000, 1_500], (100, 3)), axis=0)
    place, need = sure[::2].copy(), r.integers(3, 12, len(sure[::2])).astype(float)
    x, y, z = (np.ascontiguousarray(sure[:, k]) for k in range(3))
    got = on_line(place, need, x, y, z, 20_000, 250.0, 2e-6, 0.5, 1000, False)
    np.testing.assert_array_equal(got, plain(place, need, sure, 20.0, 0.25, 0.002, 0.5))
    assert 0 < got.mean() < 1


def test_a_crowd_of_sure_echoes_tells_nothing():
    place = np.stack([np.arange(0, 20_000, 500), *np.zeros((2, 40), int)], axis=1)
    x, y, z = (np.ascontiguousarray(place[:, k]) for k in range(3))
    need = np.full(40, 5.0)
    assert on_line(place, need, x, y, z, 20_000, 250.0, 2e-6, 0.5, 40, False).all()
    for crowded in (True, False):
        answer = on_line(place[15:25], need, x, y, z, 20_000, 250.0, 2e-6, 0.5, 30, crowded)
        assert (answer == crowded).all()


def test_without_a_sure_echo_none_joins_and_those_called_a_wire_leave_as_where_one_is_far():
    table, own, _ = power_line()
    own[:, WIRE] = np.minimum(own[:, WIRE], 60)
    alone = settled(table, np.arange(table.rows), own)
    assert alone[1] == 0 and alone[2] > 0
    far = Table({n: np.append(table[n], table[n][0] + (500.0 if n == "x" else 0)) for n in table})
    more = np.append(own, [[0, 255, 0]], axis=0).astype(np.uint8)
    np.testing.assert_array_equal(settled(far, np.arange(table.rows), more)[0], alone[0])
    assert settled(table, np.arange(0), own)[0].shape == (0, 3)


def test_in_a_crowd_of_sure_echoes_nothing_changes():
    table, own, _ = power_line()
    own[table["z"] > 2] = [30, 200, 25]
    assert settled(table, np.arange(table.rows), own, params(most=10))[1:] == (0, 0)
