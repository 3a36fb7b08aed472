"""Boundaries of two classes against plain distances; answers elsewhere stay bit for bit."""

import numpy as np
import pytest
from modelmaker import two_layers

from fwclass.classify.refine import COARSE, at_boundary, refine_boundary
from fwclass.classify.shares import answer
from fwclass.classify.stage import classify
from fwclass.grid import Tile
from fwclass.schema import Table
from fwclass.stage import Chunk

TILE = Tile(5000, 54000, 100.0)


def cloud(rows=600, seed=1, codes=(2, 3, 4)):
    r = np.random.default_rng(seed)
    x, y, z = r.uniform(0, 20, rows) + 500_000, r.uniform(0, 20, rows) + 5_400_000, r.uniform(0, 5, rows)
    table = {"x": x.round(3), "y": y.round(3), "z": z.round(3), "coarse_class": r.choice(codes, rows).astype(np.uint8)}
    return Table({n: np.asarray(v) for n, v in table.items()})


@pytest.mark.parametrize("within", [0.8, 1.5, 2.5])
def test_a_boundary_echo_has_an_answer_of_the_other_class_as_near(within):
    table = cloud()
    core = np.arange(0, table.rows, 2)
    at = at_boundary(Chunk(table, core, TILE), (2, 4), within)
    place, codes = np.stack([table[n] for n in "xyz"], axis=1), table["coarse_class"]
    far = np.sqrt(((place[core][:, None] - place[None]) ** 2).sum(axis=2)) <= within + 1e-9
    other = {2: 4, 4: 2}
    expected = [c in other and (far[k] & (codes == other[c])).any() for k, c in enumerate(codes[core].tolist())]
    np.testing.assert_array_equal(at, expected)
    assert 0 < at.sum() < len(core)


@pytest.mark.parametrize(("codes", "all_of"), [((2,), False), ((3,), False), ((2, 4), True)])
def test_no_boundary_or_nothing_but_boundary(codes, all_of):
    table = cloud(codes=codes)
    at = at_boundary(Chunk(table, np.arange(table.rows), TILE), (2, 4), 50.0)
    assert at.all() if all_of else not at.any()
    assert at_boundary(Chunk(table, np.arange(0), TILE), (2, 4), 1.0).shape == (0,)


def answered(rows=400, seed=3):
    model, r = two_layers(), np.random.default_rng(seed)
    X = r.normal(size=(rows, 2)).astype(np.float32)
    made = classify(X, model.coarse, probabilities=True)
    columns = dict(zip(COARSE, (made[n] for n in ("classification", "confidence", "entropy")), strict=True))
    at = (r.random(rows) < 0.3) & np.isin(made["classification"], model.pair)
    fine = np.stack([r.random(rows), X[:, 1]], axis=1).astype(np.float32)
    fine[::11, 0] = np.nan  # at the edge of a survey a wide sphere may be empty
    return model, Table({**columns, "boundary": at}), fine, made


def test_the_second_layer_answers_at_the_boundary_and_nowhere_else():
    model, table, fine, before = answered()
    at = table["boundary"]
    made = refine_boundary(table, fine[at], model, before)
    for name in before:
        np.testing.assert_array_equal(made[name][~at], before[name][~at])
    winner, shares = answer(fine[at], model.fine)
    np.testing.assert_array_equal(made["classification"][at], model.fine.codes[winner])
    assert set(made["classification"][at].tolist()) <= set(model.pair)
    np.testing.assert_array_equal(made["confidence"][at], shares.max(axis=1).astype(np.float32))
    total = sum(made[n].astype(np.float64) for n in made if n.startswith("probability_"))
    np.testing.assert_allclose(total, 1, atol=1e-6)
    third = next(c for c in model.codes if c not in model.pair)
    assert (made[f"probability_{third}"][at] == 0).all()


def test_without_a_boundary_all_answers_stay():
    model, table, fine, before = answered()
    none = table.with_columns(Table({"boundary": np.zeros(table.rows, bool)}))
    made = refine_boundary(none, fine[:0], model)
    for name in made:
        np.testing.assert_array_equal(made[name], before[name])
