"""The search of C and gamma, thinning by class and place, and what a card tells of trimming."""

import json
from dataclasses import replace

import numpy as np
import pytest
from defaults import BASE

from fwclass.classify.shares import answer
from fwclass.graph.machine_search import folds_of_squares, make_folds
from fwclass.model import ClassDef
from fwclass.train.baselines.params import CompareParams
from fwclass.train.baselines.prepare import fewer
from fwclass.train.baselines.search import by_pulses, pairs_of, right, search, search_rows, search_summary, smoothest
from fwclass.train.baselines.stage import train_other
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample

pytest.importorskip("sklearn")
CLASSES = tuple(ClassDef(n, k + 2, (k + 2,)) for k, n in enumerate("abc"))
PARAMS = TrainParams(**BASE["train"] | {"method": "rbf-svm"})


def compare(**svm):
    return CompareParams(**BASE["compare"] | {"rbf_svm": BASE["compare"]["rbf_svm"] | svm})


def sample(rows=900, seed=1):
    r = np.random.default_rng(seed)
    y = r.integers(0, 3, rows).astype(np.uint8)
    X = (r.normal(size=(rows, 3)) + 1.5 * np.eye(3)[y]).astype(np.float32)
    place = np.round(r.random((rows, 2)) ** 2 * 200_000).astype(np.int64)
    key = np.arange(rows, dtype=np.uint64)
    counts = np.bincount(y, minlength=3).astype(np.int64)
    return Sample(tuple("uvw"), X, y, key, r.permutation(rows).astype(np.uint64), counts, place=place)


def test_equal_scores_go_to_the_smoother_machine():
    assert smoothest([(1, 1, 0.9), (10, 0.1, 0.9), (1, 0.1, 0.9), (1, 0.01, 0.8)]) == (1, 0.1)


def test_folds_are_squares_with_a_gap():
    made = sample()
    folding = make_folds(50.0, 10.0, made, 3)
    assert folding.blocks > 3 and set(folding.fold.tolist()) == {0, 1, 2} and not folding.note
    at = made.place * 0.001
    for k in range(3):
        learns, asked = at[folding.learns[k]], at[folding.fold == k]
        apart = np.abs(learns[:, None] - asked[None]).max(axis=2).min()
        assert apart >= 10.0 - 0.002


def test_too_few_squares_fall_back_to_pulses_and_say_so():
    folding = make_folds(500.0, 10.0, sample(), 3)
    assert "pieces of consecutive pulses" in folding.note and folding.blocks == 0
    np.testing.assert_array_equal(folding.fold, by_pulses(sample(), 3).fold)


def test_parts_of_the_search_add_up_to_the_whole():
    made, svm = sample(), compare(c=[1.0, 10.0], gamma=[0.1, 1.0], search_rows=500).rbf_svm
    places = folds_of_squares(50.0, 5.0)
    looked = search_rows(made, svm, places.edge)
    folding = places.folding(looked, svm.folds)
    whole = search(looked, folding, svm, "standard", None)
    folds = range(svm.folds)
    counts = [[right(looked, folding, f, c, g, svm, "standard", None) for f in folds] for c, g in pairs_of(svm)]
    assert search_summary(looked.rows, folding, pairs_of(svm), counts) == whole
    model = train_other(
        made, PARAMS, compare(c=[1.0, 10.0], gamma=[0.1, 1.0], search_rows=500), CLASSES, "rbf-svm", places
    )
    assert model.card["search"]["tried"] == whole["tried"] and model.card["search"]["blocks"] == folding.blocks


def test_rows_are_thinned_alike_by_class_and_square():
    made = sample(6000)
    some = fewer(made, 900, 50.0)
    assert some.rows == 900 and set(np.unique(some.y)) == {0, 1, 2}
    square = (some.place // 50_000) @ [1000, 1]
    plain = fewer(made, 900)
    before = (plain.place // 50_000) @ [1000, 1]
    assert (
        np.bincount(np.unique(square, return_inverse=True)[1]).std()
        < np.bincount(np.unique(before, return_inverse=True)[1]).std()
    )
    model = train_other(
        made, PARAMS, compare(c=[1.0], gamma=[0.3], max_rows=900), CLASSES, "rbf-svm", folds_of_squares(50.0, 5.0)
    )
    assert any("900 of 6,000 rows, alike by class and by squares of 50 m" in n for n in model.card["notes"])


def test_the_card_tells_what_trimming_took():
    made = sample()
    plain = train_other(made, PARAMS, compare(c=[1.0], gamma=[0.3]), CLASSES, "rbf-svm")
    once = train_other(made, PARAMS, compare(c=[1.0], gamma=[0.3], trim="nearest"), CLASSES, "rbf-svm")
    often = train_other(made, PARAMS, compare(c=[1.0], gamma=[0.3], trim="repeated"), CLASSES, "rbf-svm")
    went = [sum(m.card["trimmed"].values()) for m in (once, often)]
    assert "trimmed" not in plain.card and 0 < went[0] < went[1]
    assert len(often.vectors) < len(once.vectors) < len(plain.vectors)
    assert set(once.card["trimmed"]) == {"a", "b", "c"} and any("were trimmed" in n for n in once.card["notes"])
    json.dumps(once.card)


def test_a_class_trimmed_away_whole_stays_and_is_noted():
    made = sample()
    rare = np.flatnonzero(made.y == 2)[:2]
    keep = np.sort(np.r_[np.flatnonzero(made.y < 2), rare])
    few = made.take(keep)
    X = few.X.copy()
    X[few.y == 2] = X[few.y == 0][:2] + np.float32(1e-4)
    few = replace(few, X=X)
    model = train_other(few, PARAMS, compare(c=[1.0], gamma=[0.3], trim="nearest"), CLASSES, "rbf-svm")
    assert model.card["trimmed"]["c"] == 0 and any("'c'" in n and "stays untrimmed" in n for n in model.card["notes"])


def test_constant_features_and_missing_values_train():
    made = sample()
    X = made.X.copy()
    X[:, 1], X[::7, 2] = 4.0, np.nan
    model = train_other(replace(made, X=X), PARAMS, compare(c=[1.0], gamma=[0.3], trim="nearest"), CLASSES, "rbf-svm")
    assert np.isfinite(model.vectors).all() and any("'v' is 4" in n for n in model.card["notes"])


def test_rows_of_one_place_and_rows_all_alike_train_and_are_noted():
    made, few = sample(), compare(c=[1.0, 10.0], gamma=[0.3], trim="nearest")
    one = replace(made, place=np.zeros_like(made.place))
    model = train_other(one, PARAMS, few, CLASSES, "rbf-svm", folds_of_squares(50.0, 5.0))
    assert any("pieces of consecutive pulses: 1 blocks" in n for n in model.card["notes"])
    alike = replace(made, X=np.full_like(made.X, 3.0))
    model = train_other(alike, PARAMS, few, CLASSES, "rbf-svm", folds_of_squares(50.0, 5.0))
    assert sum("is 3 in every training row" in n for n in model.card["notes"]) == 3
    assert model.card["trimmed"] == {"a": 0, "b": 0, "c": 0}, "a twin of the same class is as near as any"
    assert len(set(answer(alike.X[:50], model)[0].tolist())) == 1


def test_a_choice_at_the_edge_of_the_grid_is_told():
    pairs = [(c, g) for c in (1.0, 10.0, 100.0) for g in (0.1, 1.0, 10.0)]
    folding = by_pulses(sample(), 2)

    def note(best):
        counts = [[{"right": 90 + 9 * (pair == best), "judged": 100}] * 2 for pair in pairs]
        return search_summary(900, folding, pairs, counts)["note"]

    assert "C = 100 is the largest" in note((100.0, 1.0)) and "gamma" not in note((100.0, 1.0))
    assert "gamma = 0.1 is the smallest" in note((10.0, 0.1)) and note((10.0, 1.0)) == folding.note
    alone = search_summary(900, folding, [(5.0, 0.3)], [[{"right": 1, "judged": 2}] * 2])
    assert alone["note"] == folding.note
