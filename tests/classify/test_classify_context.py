"""Means of neighbours' shares against plain loops; rows, order and surroundings that do not change them; answers."""

from dataclasses import replace

import numpy as np
import pytest
from modelmaker import contextual, models

from fwclass.classify.context import REACH, coarse_share_columns, context_of, halo_of, whole_shares, with_context
from fwclass.classify.shares import answer
from fwclass.classify.stage import classify
from fwclass.grid import millimetres
from fwclass.model import Contextual, Forest
from fwclass.model.contextual import context_names
from fwclass.schema import Table

CODES = (2, 5, 6)
COLUMNS = coarse_share_columns(CODES)


def cloud(rows=500, seed=1, wide=30.0, high=12.0):
    r = np.random.default_rng(seed)
    x, y, z = r.uniform(-wide, wide, rows), r.uniform(-wide, wide, rows), r.uniform(-high, high, rows)
    shares = r.integers(0, 256, (rows, len(CODES)), np.uint8)
    place = {"x": x.round(3), "y": y.round(3), "z": z.round(3)}
    return Table({**place, **dict(zip(COLUMNS, shares.T, strict=True))})


def plain_means(table, core, edge):
    """As `context_of` for cells of one edge [m], echo by echo."""
    cell = np.stack([millimetres(table[n]) for n in "xyz"], axis=1) // round(edge * 1000)
    shares = np.stack([table[n] for n in COLUMNS], axis=1).astype(int)
    near = (np.abs(cell[core][:, None] - cell[None]) <= REACH).transpose(0, 2, 1)
    means = []
    for within in (near[:, :2].all(axis=1), near.all(axis=1)):
        n = within.sum(axis=1)[:, None]
        means.append((2 * (within[:, :, None] * shares[None]).sum(axis=1) + n) // (2 * n))
    return np.concatenate(means, axis=1)


@pytest.mark.parametrize("edge", [0.5, 1.3, 5.0, 20.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_means_are_those_of_plain_loops(edge, seed):
    table = cloud(seed=seed)
    core = np.arange(0, table.rows, 3)
    context = context_of(table, core, COLUMNS, (edge,))
    np.testing.assert_array_equal(context[:, 3:], plain_means(table, core, edge))
    np.testing.assert_array_equal(context[:, :3], np.stack([table[n] for n in COLUMNS], axis=1)[core])
    assert context.shape[1] == len(context_names(CODES, (edge,)))


def test_neither_order_nor_what_lies_beyond_the_halo_changes_a_mean():
    table, cells = cloud(2000), (0.5, 2.0)
    core = np.flatnonzero((np.abs(table["x"]) < 10) & (np.abs(table["y"]) < 10))
    whole = context_of(table, core, COLUMNS, cells)
    reach = halo_of(cells)
    near = np.flatnonzero((np.abs(table["x"]) <= 10 + reach) & (np.abs(table["y"]) <= 10 + reach))
    order = np.random.default_rng(3).permutation(near)
    place = np.empty(table.rows, np.int64)
    place[order] = np.arange(len(order))
    some = context_of(table.take(order), place[core], COLUMNS, cells)
    np.testing.assert_array_equal(whole, some)
    assert len(near) < table.rows


@pytest.mark.parametrize("rows", [0, 1, 2])
def test_few_echoes_or_none(rows):
    table = cloud(rows)
    context = context_of(table, np.arange(rows), COLUMNS, (1.0,))
    assert context.shape == (rows, 9)
    if rows == 1:  # it is alone in all its boxes
        np.testing.assert_array_equal(context[0].reshape(3, 3), np.tile(context[0, :3], (3, 1)))


def test_equal_places_and_far_strays():
    """All in one cell; and two that lie a thousand kilometres apart."""
    rows = 50
    table = cloud(rows).with_columns(Table({n: np.zeros(rows) for n in "xyz"}))
    context = context_of(table, np.arange(rows), COLUMNS, (1.0,))
    assert (context[:, 3:] == context[0, 3:]).all()
    x = np.where(np.arange(rows) == 0, 1.0e6, table["x"])
    far = context_of(table.with_columns(Table({"x": x, "z": x * 9})), np.arange(rows), COLUMNS, (0.1,))
    np.testing.assert_array_equal(far[0].reshape(3, 3), np.tile(far[0, :3], (3, 1)))


def test_the_answer_is_the_mean_of_both_layers():
    model, r = contextual(), np.random.default_rng(5)
    X = r.normal(size=(400, len(model.features))).astype(np.float32)
    context = r.integers(0, 256, (400, len(model.fine.features) - X.shape[1]), np.uint8)
    table = classify(with_context(X, context), model, probabilities=True)
    shares = np.stack([table[f"probability_{c}"] for c in model.codes], axis=1)
    second = answer(with_context(X, context), model.fine)[1]
    np.testing.assert_allclose(shares, (answer(X, model.coarse)[1] + second) / 2, atol=1e-7)
    np.testing.assert_array_equal(table["classification"], model.codes[shares.argmax(axis=1)])
    np.testing.assert_allclose(shares.sum(axis=1), 1, atol=1e-6)


def test_every_layer_is_looked_at_once_for_an_answer(monkeypatch):
    """All nodes of a large forest are; three times of each took most of the time of an echo's explanation."""
    model, looked = contextual(), []
    X = np.zeros((3, len(model.fine.features)), np.float32)
    monkeypatch.setattr(Forest, "_fault", lambda forest, own=Forest._fault: looked.append(id(forest)) or own(forest))
    answer(X, model)
    assert sorted(looked) == sorted(map(id, (model.coarse, model.fine)))


def test_classes_weigh_in_the_answer_as_the_card_says():
    model, r = contextual(), np.random.default_rng(5)
    fine = replace(model.fine, child=np.array([1, 2, 3, 0, 1], np.uint32))  # which does not always say the first class
    X = r.uniform(-3, 3, (400, len(fine.features))).astype(np.float32)
    plain = answer(X, Contextual(model.coarse, fine, model.card))[1]
    card = {**model.card, "context": {**model.card["context"], "weights": [1.0, 1.414, 2.0]}}
    told, shares = answer(X, Contextual(model.coarse, fine, card))
    wanted = plain * [1.0, 1.414, 2.0]
    np.testing.assert_allclose(shares, wanted / wanted.sum(axis=1, keepdims=True), atol=1e-12)
    np.testing.assert_array_equal(told, wanted.argmax(axis=1))
    assert (told != plain.argmax(axis=1)).any()


@pytest.mark.parametrize("kind", sorted(models()))
def test_whole_shares_are_those_of_the_model(kind):
    model = models()[kind]
    X = np.random.default_rng(1).normal(size=(300, len(model.features))).astype(np.float32)
    whole = whole_shares(X, model)
    assert whole.dtype == np.uint8
    assert np.abs(whole / 255 - answer(X, model)[1]).max() <= 0.5 / 255 + 1e-12
