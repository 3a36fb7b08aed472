"""Votes against a naive walk, classes and confidences, and models that must be refused."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fwclass.classify import vote
from fwclass.classify.stage import classify, votes
from fwclass.errors import InputError
from fwclass.model import FORMAT, LEAF, Forest, assemble
from fwclass.schema import Table

NAMES = ("zc", "width", "number_of_echoes", "amplitude", "inclination_r100", "echo_ratio_r100")


def card(features=NAMES, codes=(2, 6, 5)):
    return {"format": FORMAT, "features": list(features), "classes": [{"name": str(c), "code": c} for c in codes]}


def random_tree(r, splits, m, n_classes):
    """A tree that is nothing but well formed, lop-sided at times."""
    feature, threshold, child = [LEAF], [0.0], [int(r.integers(n_classes))]
    for _ in range(splits):
        leaf = r.choice(np.flatnonzero(np.array(feature) == LEAF)) if r.random() < 0.5 else len(feature) - 1
        feature[leaf], threshold[leaf], child[leaf] = int(r.integers(m)), r.normal(), len(feature)
        feature += [LEAF, LEAF]
        threshold += [0.0, 0.0]
        child += r.integers(n_classes, size=2).tolist()
    return np.array(feature, np.uint16), np.array(threshold, np.float32), np.array(child, np.uint32)


def random_forest(seed, trees=7, m=6, n_classes=3, splits=40):
    r = np.random.default_rng(seed)
    names = [f"zc_r{k}" for k in range(m)] if m != 6 else NAMES
    made = [random_tree(r, int(r.integers(splits + 1)), m, n_classes) for _ in range(trees)]
    return assemble(made, card(names, range(1, n_classes + 1)))


def naive(X, forest):
    out = np.zeros((len(X), len(forest.codes)), np.uint16)
    for i, row in enumerate(X):
        for a in forest.offsets[:-1]:
            k = a
            while forest.feature[k] != LEAF:
                k = a + forest.child[k] + (0 if row[forest.feature[k]] < forest.threshold[k] else 1)
            out[i, forest.child[k]] += 1
    return out


def rows(n, m, seed, gaps=0.1):
    r = np.random.default_rng(seed)
    X = r.normal(size=(n, m)).astype(np.float32)
    X[r.random(X.shape) < gaps] = np.nan
    return X


@pytest.mark.parametrize("n", [0, 1, 7, 8, 9, 100])
@pytest.mark.parametrize(("m", "n_classes"), [(6, 3), (1, 2), (2, 1), (130, 9)])
def test_votes_equal_a_naive_walk(n, m, n_classes):
    forest = random_forest(n + m, m=m, n_classes=n_classes)
    X = rows(n, m, seed=n)
    np.testing.assert_array_equal(votes(X, forest), naive(X, forest))


def test_votes_do_not_depend_on_the_block(monkeypatch):
    forest, X = random_forest(1), rows(301, 6, seed=2)
    expected = votes(X, forest)
    for block in (1, 8, 37, 300):
        monkeypatch.setattr(vote, "BLOCK", block)
        np.testing.assert_array_equal(votes(X, forest), expected)
        np.testing.assert_array_equal(vote.winners(X, vote.walkable(forest)), expected.argmax(axis=1))


@pytest.mark.parametrize("trees", [1, 2, 3, 10, 41, 100])
@pytest.mark.parametrize("n_classes", [1, 2, 3, 9])
def test_who_wins_is_known_before_all_have_voted(trees, n_classes):
    """Shallow trees of chance agree little: ties and narrow leads are common."""
    forest = random_forest(trees * n_classes, trees=trees, n_classes=n_classes, splits=6)
    X = rows(500, 6, seed=trees)
    counted = votes(X, forest)
    np.testing.assert_array_equal(vote.winners(X, vote.walkable(forest)), counted.argmax(axis=1))
    if n_classes > 1 and trees % 2 == 0:
        top = np.sort(counted, axis=1)
        assert (top[:, -1] == top[:, -2]).any()  # there were ties


def test_no_row_has_a_winner():
    assert vote.winners(np.empty((0, 6), np.float32), vote.walkable(random_forest(3))).shape == (0,)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, 60), st.integers(0, 40))
def test_votes_equal_a_naive_walk_on_anything(seed, splits, n):
    forest = random_forest(seed, trees=3, splits=splits)
    X = rows(n, 6, seed)
    X[X > 2] = np.inf
    np.testing.assert_array_equal(votes(X, forest), naive(X, forest))


def test_a_value_on_the_threshold_goes_right():
    tree = (np.array([0, LEAF, LEAF], np.uint16), np.array([0.1, 0, 0], np.float32), np.array([1, 0, 1], np.uint32))
    forest = assemble([tree], card(("zc",), (2, 5)))
    t = np.float32(0.1)
    X = np.array([[np.nextafter(t, np.float32(0))], [t], [np.nan]], np.float32)
    np.testing.assert_array_equal(classify(X, forest)["classification"], [2, 5, 5])


def stumps(classes):
    """One leaf per tree."""
    return [(np.array([LEAF], np.uint16), np.zeros(1, np.float32), np.array([c], np.uint32)) for c in classes]


def test_ties_go_to_the_first_class_and_confidence_is_the_share():
    made = classify(np.zeros((3, 6), np.float32), assemble(stumps([2, 1, 1, 2, 0]), card()))
    np.testing.assert_array_equal(made["classification"], [6, 6, 6])
    np.testing.assert_array_equal(made["confidence"], np.full(3, np.float32(0.4)))


def test_rows_without_any_value_get_a_class():
    made = classify(np.full((9, 6), np.nan, np.float32), random_forest(3))
    assert np.isin(made["classification"], [1, 2, 3]).all()


def test_no_rows():
    made = classify(np.empty((0, 6), np.float32), random_forest(3))
    assert made.rows == 0
    assert set(made) == {"classification", "confidence", "entropy"}


def test_a_table_is_read_by_name_in_any_order():
    forest, X = random_forest(4), np.abs(rows(50, 6, seed=5, gaps=0))
    X[:, 2] = np.rint(X[:, 2])
    table = Table({n: X[:, k] for k, n in reversed(list(enumerate(NAMES)))} | {"z": np.zeros(50)})
    a, b = classify(table, forest), classify(X, forest)
    np.testing.assert_array_equal(a["classification"], b["classification"])
    np.testing.assert_array_equal(a["confidence"], b["confidence"])


def test_a_missing_feature_is_named():
    table = Table({n: np.zeros(4) for n in NAMES if n != "width"})
    with pytest.raises(InputError, match="'width' is missing"):
        classify(table, random_forest(5))


@pytest.mark.parametrize("shape", [(4, 5), (4, 7), (6,), (2, 3, 6)])
def test_a_matrix_of_another_shape_is_refused(shape):
    with pytest.raises(InputError, match="do not fit"):
        votes(np.zeros(shape, np.float32), random_forest(6))


def spoilt(forest, name, at, value):
    array = getattr(forest, name).copy()
    array[at] = value
    return replace(forest, **{name: array})


def damaged():
    sound = random_forest(7)
    node = int(np.flatnonzero(sound.feature != LEAF)[0])
    leaf = int(np.flatnonzero(sound.feature == LEAF)[0])
    return {
        "unknown feature": spoilt(sound, "feature", node, 6),
        "loop": spoilt(sound, "child", node, 0),
        "child outside": spoilt(sound, "child", node, 10**6),
        "last child outside": spoilt(sound, "child", node, np.diff(sound.offsets)[0] - 1),
        "unknown class": spoilt(sound, "child", leaf, 3),
        "offset past the end": spoilt(sound, "offsets", -1, len(sound.feature) + 5),
        "offsets not in order": spoilt(sound, "offsets", 1, -3),
        "empty tree": spoilt(sound, "offsets", 1, 0),
        "arrays of unequal length": replace(sound, threshold=sound.threshold[:-1]),
        "another dtype": replace(sound, threshold=sound.threshold.astype(np.float64)),
        "no trees": replace(sound, offsets=np.zeros(1, np.int64)),
        "another layout": replace(sound, card={**sound.card, "format": 99}),
        "card without features": replace(sound, card={"format": FORMAT, "classes": sound.card["classes"]}),
        "card that is none": replace(sound, card={"format": FORMAT, "features": 3, "classes": None}),
        "code too large": replace(sound, card={**sound.card, "classes": [{"code": 999}] * 3}),
    }


@pytest.mark.parametrize("fault", damaged())
def test_a_damaged_model_is_refused_before_it_is_walked(fault):
    with pytest.raises(InputError, match="model is damaged"):
        votes(np.zeros((10, 6), np.float32), damaged()[fault])


@settings(max_examples=150, deadline=None)
@given(st.binary(min_size=60, max_size=60), st.integers(1, 3))
def test_any_bytes_are_a_sound_model_or_an_error(data, trees):
    """Whatever passes the check is walked safely to a leaf."""
    raw = np.frombuffer(data, np.uint8)
    feature = np.where(raw[:6] < 128, LEAF, raw[:6] % 8).astype(np.uint16)
    child = (raw[6:12] % 9).astype(np.uint32)
    threshold = raw[12:36].view(np.float32)
    offsets = np.sort(np.r_[0, raw[36 : 36 + trees] % 7, 6]).astype(np.int64)
    forest = Forest(feature, threshold, child, offsets, card())
    X = raw[36:60].view(np.float32).reshape(1, 6)
    try:
        made = votes(X, forest)
    except InputError:
        return
    np.testing.assert_array_equal(made, naive(X, forest))


def test_a_tree_too_large_for_its_links_is_refused():
    splits = 40_000  # with 40 000 features a link has 16 bits for the node
    node = np.arange(2 * splits + 1)
    feature = np.where(node < splits, 0, LEAF).astype(np.uint16)
    child = np.where(node < splits, 2 * node + 1, 0).astype(np.uint32)
    forest = assemble([(feature, np.zeros(len(feature), np.float32), child)], card([f"f{k}" for k in range(40_000)]))
    with pytest.raises(InputError, match="too large"):
        votes(np.zeros((1, 40_000), np.float32), forest)


def test_an_empty_forest_cannot_be_assembled():
    with pytest.raises(ValueError, match="needs a tree"):
        assemble([], card())
