"""A mean field against plain loops; rows, order and surroundings that do not change it."""

import numpy as np
import pytest

from fwclass import conf
from fwclass.classify.mean_field import (
    after_mean_field,
    agreed_shares,
    answers,
    model_share_columns,
    shares_of,
    whole_columns,
)
from fwclass.schema import Table

CODES = np.array([2, 5, 6], np.uint8)


def params(**given):
    words = {"strength": 0.3, "neighbours": 6, "reach": 3.0, "rounds": 3, **given}
    return conf.section("classify", tuple(f"classify.regularize.{n}={v}" for n, v in words.items())).regularize


def cloud(rows=400, seed=1, wide=12_000, step=1):
    """Places [mm], on a lattice of `step` so that many are equally far, and shares."""
    r = np.random.default_rng(seed)
    place = np.stack([r.integers(-wide, wide, rows), r.integers(-wide, wide, rows), r.integers(0, 3000, rows)], axis=1)
    return place // step * step, r.integers(0, 256, (rows, len(CODES))).astype(np.uint8)


def plain(place, shares, p):
    """As `agreed_shares` of all rows, echo by echo."""
    key = np.empty(len(place), int)
    key[np.lexsort((*shares.T[::-1], *place.T[::-1]))] = np.arange(len(place))
    reach, now = round(1000 * p.reach), shares.astype(int)
    scaled = place * [1, 1, p.height]
    links = []
    for i in range(len(place)):
        apart = ((scaled - scaled[i]) ** 2).sum(axis=1).astype(int)
        near = [j for j in np.lexsort((key, apart)) if j != i and apart[j] <= reach**2][: p.neighbours]
        end = (apart[near[-1]] if len(near) == p.neighbours else reach**2) + 1
        links.append((near, np.array([256 * (end - apart[j]) // end for j in near], int)))
    for _ in range(p.rounds):
        sums = np.array([(w[:, None] * now[near]).sum(axis=0) for near, w in links])
        scores = np.log(np.maximum(shares / 255, p.least)) + p.strength * sums / (256 * 255)
        answers = np.exp(scores - scores.max(axis=1, keepdims=True))
        answers /= answers.sum(axis=1, keepdims=True)
        now = np.rint(255 * answers).astype(int)
    return answers


@pytest.mark.parametrize("given", [{}, {"neighbours": 40}, {"reach": 0.5}, {"rounds": 1}, {"height": 1.0}])
@pytest.mark.parametrize("step", [1, 1000])
def test_shares_are_those_of_plain_loops(given, step):
    place, shares = cloud(step=step)
    p = params(**given)
    got = agreed_shares(place, shares, np.arange(len(place)), p)
    np.testing.assert_allclose(got, plain(place, shares, p), rtol=0, atol=1e-12)


@pytest.mark.parametrize("step", [1, 500])
def test_neither_order_nor_what_lies_beyond_the_halo_changes_a_share(step):
    """At a lattice of half a metre many neighbours are equally near, some at one place."""
    place, shares = cloud(4000, wide=20_000, step=step)
    p = params(reach=1.5, height=1.0)
    core = np.flatnonzero((np.abs(place[:, :2]) < 6000).all(axis=1))
    whole = agreed_shares(place, shares, core, p)
    near = np.flatnonzero((np.abs(place[:, :2]) <= 6000 + 1000 * p.halo).all(axis=1))
    order = np.random.default_rng(3).permutation(near)
    at = np.empty(len(place), np.int64)
    at[order] = np.arange(len(order))
    np.testing.assert_array_equal(agreed_shares(place[order], shares[order], at[core], p), whole)
    assert len(near) < len(place)


def test_a_halo_that_is_too_small_would_show():
    place, shares = cloud(4000, wide=20_000)
    p = params(reach=1.5, strength=2.0)
    core = np.flatnonzero((np.abs(place[:, :2]) < 6000).all(axis=1))
    near = np.flatnonzero((np.abs(place[:, :2]) <= 6000 + 500 * p.reach).all(axis=1))
    some = agreed_shares(place[near], shares[near], np.searchsorted(near, core), p)
    assert (some != agreed_shares(place, shares, core, p)).any()


def test_whole_shares_keep_the_class_that_was_answered():
    shares = np.random.default_rng(4).dirichlet([1.0, 1.0, 1.0], 20_000)
    shares[::3, 2] = shares[::3, :2].max(axis=1) + 1e-4  # rounded they are often equal
    shares /= shares.sum(axis=1, keepdims=True)
    codes = (5, 2, 14)
    answered = answers(shares, np.array(codes, np.uint8), True)
    whole = shares_of(whole_columns(answered, codes), codes)
    np.testing.assert_array_equal(np.array(codes)[whole.argmax(axis=1)], answered["classification"])
    rounded = np.rint(shares * 255)
    assert 0 < (whole != rounded).any(axis=1).sum() < 10_000 and np.abs(whole - rounded).max() == 1


@pytest.mark.parametrize("rows", [0, 1, 2])
def test_few_echoes_or_none(rows):
    place, shares = cloud(rows)
    got = agreed_shares(place, shares, np.arange(rows), params())
    assert got.shape == (rows, 3)
    np.testing.assert_allclose(got.sum(axis=1), 1.0)


def test_equal_places_and_far_strays():
    """All at one place; and two that lie a thousand kilometres apart, which agree with nobody."""
    place, shares = cloud(60)
    p = params(least=0.001)
    np.testing.assert_allclose(
        agreed_shares(place * 0, shares, np.arange(60), p), plain(place * 0, shares, p), atol=1e-12
    )
    far = place.copy()
    far[0] = 10**9
    alone = np.maximum(shares[0] / 255, p.least)
    np.testing.assert_allclose(agreed_shares(far, shares, np.arange(1), p)[0], alone / alone.sum())


def test_one_among_others_takes_their_class_and_is_as_sure():
    place = np.stack([np.arange(9) * 300, np.zeros(9, int), np.zeros(9, int)], axis=1)
    shares = np.tile(np.array([230, 15, 10], np.uint8), (9, 1))
    shares[4] = [100, 125, 30]
    table = Table(
        dict(zip("xyz", (place / 1000.0).T, strict=True)) | dict(zip(model_share_columns(CODES), shares.T, strict=True))
    )
    own = shares_of(table, CODES)
    answered = answers(after_mean_field(table, np.arange(9), own, params(strength=0.5)), CODES, True)
    assert (answered["classification"] == 2).all()
    np.testing.assert_array_equal(answered["confidence"], answered["probability_2"])
    weak = answers(after_mean_field(table, np.arange(9), own, params(strength=0.001)), CODES, False)
    assert weak["classification"][4] == 5
