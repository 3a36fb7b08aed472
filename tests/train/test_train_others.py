"""Classifiers trained by scikit-learn, kept as arrays, must give scikit-learn's own answers."""

from dataclasses import replace

import numpy as np
import pytest
from defaults import BASE
from tolerances import FLOAT32_UNIT, FLOAT64_UNIT

from fwclass.classify.boosted import probabilities, raw_scores
from fwclass.classify.machines import double_decisions, linear_scores
from fwclass.classify.shares import answer
from fwclass.errors import ConfigError, InputError
from fwclass.model import ClassDef
from fwclass.train.baselines import fit
from fwclass.train.baselines.params import CompareParams
from fwclass.train.baselines.prepare import fewer, pieces, preparation
from fwclass.train.baselines.stage import METHODS, train_other
from fwclass.train.baselines.trees import beyond
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample

ensemble = pytest.importorskip("sklearn.ensemble")
svm = pytest.importorskip("sklearn.svm")
threadpoolctl = pytest.importorskip("threadpoolctl")

NAMES = ("zc", "width", "amplitude", "echo_ratio_r100", "energy")


@pytest.fixture(autouse=True)
def one_thread():
    with threadpoolctl.threadpool_limits(1):
        yield


def params(**changes):
    return TrainParams(**{**BASE["train"], "trees": 12, **changes})


def compare(**changes):
    raw = {**BASE["compare"]}
    raw["rbf_svm"] = {**raw["rbf_svm"], "c": [3.0], "gamma": [0.4]}
    raw["boosting"] = {**raw["boosting"], "rounds": 15}
    for name, value in changes.items():
        raw[name] = {**raw[name], **value} if isinstance(value, dict) else value
    return CompareParams(**raw)


def classes(n):
    return tuple(ClassDef(f"c{k}", 2 + k, (2 + k,)) for k in range(n))


def sample(n_classes=4, rows=1200, seed=1, gaps=0.05):
    """Overlapping classes; one feature is a small whole number, some values are missing."""
    r = np.random.default_rng(seed)
    y = np.sort(r.integers(0, n_classes, rows)).astype(np.uint8)
    y = y[r.permutation(rows)]
    X = r.normal(size=(rows, len(NAMES))) + r.normal(size=(n_classes, len(NAMES)))[y] * 1.3
    X[:, 3] = np.rint(X[:, 3])
    X[:, 2] = X[:, 2] * 400 + 900  # features of very different size
    X = X.astype(np.float32)
    X[r.random(X.shape) < gaps] = np.nan
    key = np.arange(rows, dtype=np.uint64)
    counts = np.bincount(y, minlength=n_classes).astype(np.int64)
    return Sample(NAMES, X, y, key, r.permutation(rows).astype(np.uint64), counts)


def fresh(n_classes=4):
    return sample(n_classes, rows=3000, seed=2).X


def trained(method, n=4, made=None, settings=None, **changes):
    return train_other(made or sample(n), settings or params(), compare(**changes), classes(n), method)


@pytest.mark.parametrize("n", [2, 3, 4])
@pytest.mark.parametrize("scaling", ["standard", "minmax"])
def test_the_linear_machine_is_scikit_learns(n, scaling):
    model, made, X = trained("linear-svm", n, scaling=scaling), sample(n), fresh(n)
    ready = preparation(made.X, scaling)
    own = BASE["compare"]["linear_svm"]
    peer = svm.LinearSVC(C=own["c"], tol=own["tolerance"], dual=False).fit(ready(made.X), made.y)
    winner, shares = answer(X, model)
    np.testing.assert_array_equal(winner, peer.predict(ready(X)))
    scores = linear_scores(X, model)
    np.testing.assert_allclose(scores[:, 0] if n == 2 else scores, peer.decision_function(ready(X)), atol=1e-9)
    np.testing.assert_allclose(shares.sum(axis=1), 1, atol=FLOAT64_UNIT)
    np.testing.assert_array_equal(shares.argmax(axis=1), winner)


@pytest.mark.parametrize("n", [2, 3, 4])
def test_the_kernel_machine_is_scikit_learns(n):
    model, made, X = trained("rbf-svm", n), sample(n), fresh(n)
    ready = preparation(made.X, "standard")
    peer = svm.SVC(C=3.0, gamma=0.4, decision_function_shape="ovo").fit(ready(made.X), made.y)
    winner, shares = answer(X, model)
    np.testing.assert_array_equal(winner, peer.predict(ready(X)))
    decisions = double_decisions(model.preparation(X), model)
    theirs = peer.decision_function(ready(X))
    np.testing.assert_allclose(-decisions[:, 0] if n == 2 else decisions, theirs, atol=1e-6)
    np.testing.assert_allclose(shares.sum(axis=1), 1, atol=FLOAT64_UNIT)
    assert (
        shares.argmax(axis=1) == winner
    ).mean() > 0.9  # a class with fewer, but surer, votes may have the larger share


def exact(made):
    """Balanced weights as whole numbers of the lightest, in thousandths."""
    weight = made.counts.max() / made.counts
    whole = np.rint(weight * 1000)
    return dict(enumerate(whole * made.rows / (whole @ made.counts)))


@pytest.mark.parametrize("n", [2, pytest.param(3, marks=pytest.mark.slow), 4])
@pytest.mark.parametrize("weights", ["none", "balanced"])
def test_boosting_is_scikit_learns_with_gaps(n, weights):
    made, X = sample(n), fresh(n)
    if weights == "balanced":
        made = made.take(np.flatnonzero((made.y != 0) | (np.arange(made.rows) % 3 == 0)))
    model = trained("boosting", n, made, params(class_weights=weights))
    peer = ensemble.HistGradientBoostingClassifier(
        max_iter=15, early_stopping=False, random_state=0, class_weight=None if weights == "none" else exact(made)
    ).fit(made.X, made.y)
    winner, _ = answer(X, model)
    np.testing.assert_array_equal(winner, peer.predict(X))
    scores = raw_scores(X, model)
    np.testing.assert_allclose(scores[:, 0] if n == 2 else scores, peer.decision_function(X), atol=2e-4)
    np.testing.assert_allclose(probabilities(scores, n), peer.predict_proba(X), atol=2e-4)


def test_boosting_sums_as_scikit_learn_does_to_the_last_digits():
    made, X = sample(), fresh()
    own = compare().boosting
    arrays = fit.boosting(made.X, made.y, own, 5, None)
    model = trained("boosting", settings=params(seed=1))
    peer = ensemble.HistGradientBoostingClassifier(
        max_iter=own.rounds,
        learning_rate=own.learning_rate,
        max_leaf_nodes=own.leaves,
        max_bins=own.bins,
        min_samples_leaf=own.min_samples_leaf,
        l2_regularization=own.l2,
        early_stopping=False,
        random_state=5,
    ).fit(made.X, made.y)
    same = type(model)(**arrays, card=model.card)
    np.testing.assert_allclose(raw_scores(X, same), peer.decision_function(X), atol=FLOAT64_UNIT)


@pytest.mark.parametrize("n", [2, 4])
def test_the_converted_forest_is_scikit_learns(n):
    made, X = sample(n), fresh(n)
    model = trained("sklearn-forest", n)
    settings = {k: v for k, v in model.card["params"].items() if k not in ("seed", "samples_per_class")}
    filled = [np.where(np.isnan(a), fit.MISSING, a) for a in (made.X, X)]
    peer = ensemble.RandomForestClassifier(**settings).fit(filled[0], made.y)
    winner, shares = answer(X, model)
    np.testing.assert_array_equal(winner, peer.predict(filled[1]))
    np.testing.assert_allclose(shares, peer.predict_proba(filled[1]), atol=FLOAT64_UNIT)
    assert not any("pure" in note for note in model.card["notes"])


def test_leaves_that_are_not_pure_are_told():
    model = trained("sklearn-forest", settings=params(min_samples_split=40))
    assert any("not pure" in note for note in model.card["notes"])
    winner, _ = answer(sample().X, model)
    assert (winner == sample().y).mean() > 0.7


def test_a_threshold_of_64_bits_divides_the_same_rows_as_ours():
    values = np.array([0.1, 1 / 3, 2.5, -0.7, 1e-40, 3e38, 16777217.0])
    made = beyond(values)
    for t, ours in zip(values, made, strict=True):
        around = np.nextafter(np.float32(t), np.float32([-np.inf, np.inf]))
        x = np.array([around[0], np.float32(t), around[1], 0, 1], np.float32)
        np.testing.assert_array_equal(x.astype(np.float64) <= t, x < ours)


@pytest.mark.parametrize("method", METHODS[1:])
def test_the_same_sample_gives_the_same_model(method):
    one, two = trained(method), trained(method)
    for name in one.layout:
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    assert one.card == two.card and one.card["features"] == list(NAMES) and one.card["method"] == method


@pytest.mark.parametrize("method", METHODS[1:])
def test_a_row_does_not_depend_on_the_others(method):
    model, X = trained(method), fresh()[:40]
    _, whole = answer(X, model)
    parts = np.concatenate([answer(X[k : k + 7], model)[1] for k in range(0, 40, 7)])
    np.testing.assert_array_equal(whole, parts)


def test_missing_values_are_medians_and_counted():
    made = sample(gaps=0.2)
    model = trained("linear-svm", made=made)
    gaps = np.isnan(made.X).sum(axis=0)
    assert model.card["filled"] == dict(zip(NAMES, gaps.tolist(), strict=True))
    assert any("median" in note for note in model.card["notes"])
    X = np.full((1, len(NAMES)), np.nan, np.float32)
    middle = np.nanmedian(made.X, axis=0, keepdims=True).astype(np.float32)
    np.testing.assert_allclose(answer(X, model)[1], answer(middle, model)[1], atol=FLOAT32_UNIT)


def test_too_many_rows_are_cut_and_told():
    model = trained("rbf-svm", rbf_svm={"max_rows": 300})
    assert sum(model.card["samples"]) <= 300 and any("300 of 1,200" in note for note in model.card["notes"])


def test_fewer_rows_are_shared_alike_and_the_same_in_any_order():
    made = sample(3, rows=900)
    rare = made.take(np.flatnonzero((made.y != 2) | (np.arange(900) % 30 == 0)))
    cut = fewer(rare, 100)
    assert cut.rows <= 100 and cut.counts[2] == rare.counts[2] and abs(int(cut.counts[0] - cut.counts[1])) <= 1
    shuffled = fewer(rare.take(np.random.default_rng(0).permutation(rare.rows)), 100)
    assert set(shuffled.key) == set(cut.key)


def test_folds_are_pieces_of_neighbouring_pulses():
    made = sample(rows=1200)
    fold = pieces(made, 3)
    assert (np.bincount(fold) == 400).all() and (np.diff(fold[np.argsort(made.key)]) != 0).sum() == 11


def test_the_search_takes_the_pair_that_is_right_most_often():
    model = trained("rbf-svm", rbf_svm={"c": [0.001, 3.0], "gamma": [0.4, 500.0], "search_rows": 400})
    assert (model.card["params"]["c"], model.card["params"]["gamma"]) == (3.0, 0.4)
    assert len(model.card["search"]["tried"]) == 4


def test_without_scikit_learn_the_user_is_told(monkeypatch):
    import importlib

    def missing(name):
        raise ImportError(f"No module named {name!r}")

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(ConfigError, match="pip install"):
        trained("boosting")


@pytest.mark.parametrize("method", METHODS[1:])
def test_a_class_without_rows_is_refused(method):
    with pytest.raises(InputError, match="no training rows of class 'c3'"):
        made = replace(sample(3), eligible=np.array([9, 9, 9, 0]))
        train_other(made, params(), compare(), classes(4), method)


@pytest.mark.parametrize("method", METHODS[1:])
def test_one_row_of_a_class_and_a_constant_feature(method):
    made = sample(3)
    keep = np.flatnonzero((made.y != 2) | (np.arange(made.rows) == np.flatnonzero(made.y == 2)[0]))
    made.X[:, 4] = 7.0
    made = Sample(NAMES, made.X, made.y, made.key, made.hash, np.array([1, 1, 1])).take(keep)
    model = trained(method, 3, made)
    assert any("one training row" in n for n in model.card["notes"]) and any("is 7" in n for n in model.card["notes"])
    assert set(answer(made.X, model)[0]) <= {0, 1, 2}
