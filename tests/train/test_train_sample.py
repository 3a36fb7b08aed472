"""The sample must not know how the survey was cut; what cannot train must say so."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from defaults import BASE as DEFAULTS

from fwclass.classes import SEVERAL, counterparts, one_to_one
from fwclass.classify.stage import votes
from fwclass.errors import ConfigError, InputError
from fwclass.model import ClassDef, class_index, code_index
from fwclass.schema import Table, canonical_key
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample, review
from fwclass.train.stage import candidates, card, grow_trees, merge, out_of_bag, train

BASE = TrainParams(**DEFAULTS["train"])
CLASSES = (ClassDef("ground", 2, (2, 9)), ClassDef("vegetation", 5, (3, 4, 5)), ClassDef("building", 6, (6,)))
FEATURES = ("zc", "echo_ratio_r100", "amplitude", "number_of_echoes")


def survey(n=4000, seed=0):
    """(features, reference, key, inside) of n echoes."""
    r = np.random.default_rng(seed)
    reference = r.choice(np.array([0, 2, 3, 4, 5, 6, 9, 20], np.uint8), n)
    c = np.maximum(class_index(reference, CLASSES), 0)
    features = Table(
        {
            "zc": r.gamma(1 + c, 2.0),
            "echo_ratio_r100": np.where(r.random(n) < 0.05, np.nan, r.beta(4 - c, 1)),
            "amplitude": r.normal(50 + 20 * c, 15).clip(1),
            "number_of_echoes": r.integers(1, 3 + c),
        }
    )
    identity = {"strip": r.integers(0, 3, n), "pulse": np.arange(n) // 2, "echo_number": 1 + np.arange(n) % 2}
    return features, reference, canonical_key(Table(identity)), r.random(n) < 0.8


def small(**values):
    return BASE.model_copy(update={"samples_per_class": 300, "trees": 5, **values})


def same(a, b):
    assert a.features == b.features
    for x, y in zip(a.arrays().values(), b.arrays().values(), strict=True):
        np.testing.assert_array_equal(x, y)


@pytest.mark.parametrize("parts", [1, 2, 7, 40])
def test_the_sample_does_not_depend_on_the_tiling_or_the_order(parts):
    features, reference, key, inside = survey()
    whole = merge([candidates(features, reference, key, inside, small(), CLASSES)], small())
    r = np.random.default_rng(parts)
    tile = r.integers(0, parts, len(key))
    tiles = []
    for t in r.permutation(parts):
        rows = r.permutation(np.flatnonzero(tile == t))
        tiles.append(candidates(features.take(rows), reference[rows], key[rows], inside[rows], small(), CLASSES))
    same(merge(tiles, small()), whole)
    pairs = [merge(tiles[i : i + 2], small()) for i in range(0, parts, 2)]  # merged again: associative
    again = merge(reversed(pairs), small())
    same(again, whole)
    assert again.digest == whole.digest
    assert whole.counts.tolist() == [300, 300, 300]


@pytest.mark.parametrize("parts", [1, 2, 7, 40])
@pytest.mark.parametrize(("corrected", "share"), [(0.05, 0.25), (0.6, 0.25), (0.6, 1.0), (1.0, 0.25)])
def test_corrected_rows_are_a_share_of_a_class_unless_others_do_not_suffice(parts, corrected, share):
    features, reference, key, inside = survey()
    inside |= True
    params, r = small(corrected_share=share), np.random.default_rng(5)
    first = r.random(len(key)) < corrected
    cut = np.array_split(r.permutation(len(key)), parts)
    drawn = [
        candidates(features.take(c), reference[c], key[c], inside[c], params, CLASSES, first=first[c]) for c in cut
    ]
    sample = merge(drawn, params)
    same(sample, merge([candidates(features, reference, key, inside, params, CLASSES, first=first)], params))
    is_first = first[np.argsort(key)][np.searchsorted(np.sort(key), sample.key)]
    index = class_index(reference, CLASSES)
    for k in range(len(CLASSES)):
        there = first[index == k]
        assert (sample.y == k).sum() == min(len(there), 300)
        expected = min(there.sum(), max(round(share * 300), 300 - (~there).sum()))
        assert (is_first & (sample.y == k)).sum() == expected


def test_the_same_forest_whatever_the_parts():
    features, reference, key, inside = survey(2000)
    params = small()
    made = []
    for cut in ([0, 2000], [0, 300, 301, 1500, 2000]):
        samples = [
            candidates(features.take(slice(a, b)), reference[a:b], key[a:b], inside[a:b], params, CLASSES)
            for a, b in pairwise(cut)
        ]
        sample = merge(samples, params)
        step = 5 if len(cut) == 2 else 2
        trees = [
            t for first in range(0, 5, step) for t in grow_trees(sample, CLASSES, first, min(step, 5 - first), params)
        ]
        made.append(train(sample, trees, params, CLASSES))
    a, b = made
    assert a.card == b.card
    for name in ("feature", "threshold", "child", "offsets"):
        assert getattr(a, name).tobytes() == getattr(b, name).tobytes()


def test_only_labelled_rows_inside_train_and_the_smallest_hashes_are_kept():
    features, reference, key, inside = survey()
    sample = candidates(features, reference, key, inside, small(), CLASSES)
    row = {int(k): i for i, k in enumerate(key)}
    rows = np.array([row[int(k)] for k in sample.key])
    assert inside[rows].all()
    np.testing.assert_array_equal(class_index(reference, CLASSES)[rows], sample.y)
    np.testing.assert_array_equal(sample.X[:, 0], features["zc"][rows])
    everything = candidates(features, reference, key, inside, small(samples_per_class=10**6), CLASSES)
    assert everything.rows == everything.eligible.sum() == (inside & (class_index(reference, CLASSES) >= 0)).sum()
    np.testing.assert_array_equal(everything.eligible, sample.eligible)
    for c in range(3):
        expected = np.sort(everything.hash[everything.y == c])[:300]
        np.testing.assert_array_equal(np.sort(sample.hash[sample.y == c]), expected)


def test_another_seed_takes_other_rows():
    data = survey()
    a, b = (candidates(*data, small(seed=s), CLASSES) for s in (1, 2))
    assert len(np.intersect1d(a.key, b.key)) < 0.9 * a.rows


def test_rows_without_any_feature_and_empty_tiles_do_not_train():
    features, reference, key, inside = survey(50)
    nothing = Table({n: np.full(50, np.nan) for n in FEATURES[:3]})
    assert candidates(nothing, reference, key, inside, small(), CLASSES).rows == 0
    none = candidates(features.take(slice(0)), reference[:0], key[:0], inside[:0], small(), CLASSES)
    one = candidates(features, reference, key, inside, small(), CLASSES)
    same(merge([none, one], small()), one)


def test_infinite_features_count_as_missing():
    features, reference, key, inside = survey(200)
    bad = features.with_columns({"amplitude": np.where(np.arange(200) % 2, np.inf, features["amplitude"])})
    sample = candidates(bad, reference, key, inside, small(), CLASSES)
    assert not np.isinf(sample.X).any()
    assert np.isnan(sample.X[:, 2]).any()


def test_the_same_echo_from_two_tiles_is_noticed():
    data = survey(100)
    sample = candidates(*data, small(), CLASSES)
    with pytest.raises(ValueError, match="twice"):
        merge([sample, sample], small())


def test_arrays_and_back():
    sample = candidates(*survey(100), small(), CLASSES)
    same(Sample.from_arrays(sample.features, sample.arrays()), sample)


def test_the_digest_sees_every_value():
    sample = candidates(*survey(100), small(), CLASSES)
    X = sample.X.copy()
    X[7, 1] += 1e-3
    other = Sample(sample.features, X, sample.y, sample.key, sample.hash, sample.eligible)
    assert other.digest != sample.digest


def test_a_class_without_rows_is_an_error_that_names_it():
    features, reference, key, inside = survey(300)
    sample = candidates(features, np.where(reference == 6, 0, reference), key, inside, small(), CLASSES)
    with pytest.raises(InputError, match="'building'") as caught:
        card(sample, CLASSES, small())
    assert "vegetation" in caught.value.got
    assert caught.value.do


def test_one_class_is_an_error():
    features, reference, key, inside = survey(300)
    sample = candidates(features, reference, key, inside, small(), CLASSES[:1])
    with pytest.raises(InputError, match="only one"):
        review(sample, CLASSES[:1])


def test_a_feature_without_any_value_is_an_error_and_a_constant_one_a_remark():
    features, reference, key, inside = survey(300)
    flat = features.with_columns({"number_of_echoes": np.ones(300)})
    notes = review(candidates(flat, reference, key, inside, small(), CLASSES), CLASSES)
    assert notes == ("feature 'number_of_echoes' is 1 in every training row that has it",)
    nothing = features.with_columns({"amplitude": np.full(300, np.nan)})
    with pytest.raises(InputError, match="'amplitude'"):
        review(candidates(nothing, reference, key, inside, small(), CLASSES), CLASSES)


def test_a_class_with_one_row_is_a_remark():
    features, reference, key, inside = survey(300)
    first = np.flatnonzero((reference == 6) & inside)[0]
    few = np.where((reference == 6) & (np.arange(300) != first), 0, reference)
    notes = review(candidates(features, few, key, inside, small(), CLASSES), CLASSES)
    assert notes[0] == "class 'building' has one training row"
    assert "class_weights" in notes[1]


def test_the_out_of_bag_accuracy_foretells_that_on_new_rows():
    params = small(samples_per_class=1500, trees=40)
    sample = candidates(*survey(12_000), params, CLASSES)
    trees = grow_trees(sample, CLASSES, 0, params.trees, params)
    forest = train(sample, trees, params, CLASSES)
    fresh = candidates(*survey(12_000, seed=1), params, CLASSES)
    hit = (votes(fresh.X, forest).argmax(axis=1) == fresh.y).mean()
    told = forest.card["out_of_bag"]
    assert told["rows"] == sample.rows
    # two binomial shares of 4500 rows, and 63 % of the trees: 0.02 is three standard deviations
    assert abs(told["accuracy"] - hit) < 0.02
    seen = (votes(sample.X, forest).argmax(axis=1) == sample.y).mean()
    assert seen > told["accuracy"] + 0.05  # the sample itself is no test
    assert out_of_bag(sample, trees, 3, params) == told


def test_classes_by_their_reference_codes():
    codes = np.array([[0, 2, 9], [4, 6, 255]], np.uint8)
    np.testing.assert_array_equal(class_index(codes, CLASSES), [[-1, 0, 0], [1, 2, -1]])
    assert class_index(np.empty(0, np.uint8), CLASSES).shape == (0,)
    with pytest.raises(ConfigError, match="two classes"):
        class_index(codes, (*CLASSES, ClassDef("water", 9, (9,))))
    with pytest.raises(ConfigError, match="impossible"):
        class_index(codes, (ClassDef("a", 2, (300,)),))


def test_a_predicted_code_means_its_class_before_it_means_a_reference_code():
    classes = (ClassDef("low", 5, (3,)), ClassDef("high", 6, (5, 6)))
    np.testing.assert_array_equal(code_index(np.array([5, 6, 3, 0], np.uint8), classes), [0, 1, 0, -1])


def test_classes_of_two_lists_are_the_same_by_their_codes_whatever_they_are_called():
    theirs = (ClassDef("ground", 2, (2, 11)), ClassDef("plants", 5, (3, 4, 5)), ClassDef("roof", 6, (6,)))
    ours = (ClassDef("Dach", 6, (6, 26)), ClassDef("Boden", 20, (2,)), ClassDef("Busch", 5, (1,)))
    assert counterparts(theirs, ours).tolist() == [1, 2, 0] and one_to_one(theirs, ours)
    finer = (ClassDef("low", 3, (3,)), ClassDef("tall", 5, (4, 5)), ClassDef("water", 9, (9,)))
    assert counterparts(theirs, finer).tolist() == [-1, SEVERAL, -1] and not one_to_one(theirs, finer)
    coarser = (ClassDef("bare", 2, (2, 6)), ClassDef("plants", 5, (5,)))
    assert counterparts(theirs, coarser).tolist() == [0, 1, 0] and not one_to_one(theirs, coarser)
    assert counterparts(coarser, theirs).tolist() == [SEVERAL, 1]


def test_many_of_one_class_and_few_of_another_are_told():
    features, reference, key, _ = survey(6000)
    rare = np.where((reference == 6) & (np.arange(6000) % 300 > 0), 0, reference)
    sample = merge([candidates(features, rare, key, np.ones(6000, bool), small(), CLASSES)], small())
    few = int(sample.counts[2])
    assert 0 < few < 10
    notes = review(sample, CLASSES)
    assert any("class 'ground': 300 of" in n and "samples_per_class" in n for n in notes)
    assert any(f"'building' {few}" in n and "class_weights" in n for n in notes)


def test_rows_without_any_value_are_counted_and_the_feature_is_named():
    """They never train; where they are all that a class has, the features are at fault and not the labels."""
    features, reference, key, inside = survey()
    index = class_index(reference, CLASSES)
    bare = np.flatnonzero(inside & (index == 2))
    known = np.asarray(features["amplitude"]).copy()
    known[bare[:50]] = np.nan
    sample = candidates(Table({"amplitude": known}), reference, key, inside, small(), CLASSES)
    assert sample.bare.tolist() == [0, 0, 50]
    assert sample.bare.sum() + sample.eligible.sum() == (inside & (index >= 0)).sum()
    halves = [np.arange(len(key)) % 2 == k for k in range(2)]
    parts = [
        candidates(Table({"amplitude": known[h]}), reference[h], key[h], inside[h], small(), CLASSES) for h in halves
    ]
    same(merge(parts, small()), sample)
    known[bare] = np.nan
    sample = candidates(Table({"amplitude": known}), reference, key, inside, small(), CLASSES)
    with pytest.raises(InputError, match=r"feature 'amplitude' has no value in any labelled row of class 'building'"):
        review(sample, CLASSES)
    none = candidates(Table({"amplitude": known * np.nan}), reference, key, inside, small(), CLASSES)
    with pytest.raises(InputError, match="'ground', 'vegetation', 'building'"):
        review(none, CLASSES)
    unlabelled = np.where(reference == 6, 0, reference).astype(np.uint8)
    with pytest.raises(InputError, match=r"no training rows of class 'building'"):
        review(candidates(Table({"amplitude": known}), unlabelled, key, inside, small(), CLASSES), CLASSES)


def test_more_features_per_split_than_there_are_is_told():
    features, reference, key, inside = survey(600)
    for asked, told in ((9, True), (4, False), ("all", False)):
        params = small(trees=1, features_per_split=asked)
        sample = candidates(features, reference, key, inside, params, CLASSES)
        made = train(sample, grow_trees(sample, CLASSES, 0, 1, params), params, CLASSES)
        assert any("features_per_split is 9: all 4" in note for note in made.card["notes"]) == told


def test_a_table_of_millions_is_not_copied_to_draw_thousands():
    """Peak memory of drawing stays well below a matrix of all rows (4 features x 4 bytes each)."""
    import tracemalloc

    n = 1_000_000
    r = np.random.default_rng(1)
    value = r.random(n, dtype=np.float32)
    features = Table({f"linearity_r{k}": value for k in range(10, 50)})  # 40 features, one array
    reference = np.where(np.arange(n) % 100_000 == 0, 6, 2).astype(np.uint8)
    key, inside = np.arange(n, dtype=np.uint64), np.ones(n, bool)
    tracemalloc.start()
    sample = candidates(features, reference, key, inside, small(), CLASSES)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert sample.counts.tolist() == [300, 0, 10]
    assert sample.eligible.tolist() == [n - 10, 0, 10]
    assert peak < 100e6  # a matrix of all rows alone has 160 MB


def test_tiles_are_merged_one_after_the_other():
    """More tiles than are held at once give the sample of the whole."""
    features, reference, key, inside = survey()
    params = small(samples_per_class=50)

    def tiles():
        for t in range(40):
            rows = np.arange(len(key)) % 40 == t
            yield candidates(features.take(rows), reference[rows], key[rows], inside[rows], params, CLASSES)

    merged = merge(tiles(), params)
    same(merged, merge([candidates(features, reference, key, inside, params, CLASSES)], params))


def test_a_class_of_one_place_is_told():
    features, reference, key, inside = survey()
    drawn = candidates(features, reference, key, inside, BASE, CLASSES)
    r = np.random.default_rng(3)
    place = r.integers(0, 90_000, (drawn.rows, 2))
    place[drawn.y == 2] = r.integers([5_000, 7_000], [5_900, 7_900], ((drawn.y == 2).sum(), 2))
    apart = replace(drawn, place=place)
    notes = [n for n in review(apart, CLASSES) if "of each other" in n]
    assert len(notes) == 1 and "'building'" in notes[0]
    assert not [n for n in review(drawn, CLASSES) if "of each other" in n]
