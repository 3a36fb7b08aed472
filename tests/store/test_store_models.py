"""Models of every kind on disk: what is written is what is read, and a stranger's bytes run nothing."""

import json
import shutil
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from modelmaker import NAMES, card, contextual, models, two_layers

from fwclass.classify.shares import answer
from fwclass.errors import InputError
from fwclass.model import FORMAT, KINDS, LEAF, Boosted, Contextual, KernelMachine, Layered, TwoLayer, trees
from fwclass.model.base import LARGEST
from fwclass.store.models import load_array, load_forest, load_model, model_digest, save_model

ONE_LAYER = sorted(name for name, kind in KINDS.items() if not issubclass(kind, Layered))


def test_every_kind_is_tried():
    assert set(models()) == set(ONE_LAYER)


@pytest.mark.parametrize("kind", ONE_LAYER)
def test_a_model_round_trips(tmp_path, kind):
    made = models()[kind]
    save_model(tmp_path / "m", made)
    found = load_model(tmp_path / "m")
    assert type(found) is type(made) and found.card == {**made.card, "kind": kind, "digest": found.card["digest"]}
    for name in made.layout:
        np.testing.assert_array_equal(getattr(found, name), getattr(made, name))
    assert sorted(p.suffix for p in (tmp_path / "m").iterdir()) == [".json", *[".npy"] * len(made.layout)]


@pytest.mark.parametrize("kind", ONE_LAYER)
def test_damaged_models_are_refused_or_answer(tmp_path, kind):
    """Any byte of any file set to any of a few values: loading refuses, or gives a model that answers."""
    save_model(tmp_path / "m", models()[kind])
    X, refused = np.array([[0.5, 1.0], [np.nan, 9.0]], np.float32), 0
    for path in sorted((tmp_path / "m").iterdir()):
        good = path.read_bytes()
        for at in range(0, len(good), 7):
            for value in (0, 49, 127, 255):
                path.write_bytes(good[:at] + bytes([value]) + good[at + 1 :])
                try:
                    with np.errstate(all="ignore"):
                        winner, shares = answer(X, load_model(tmp_path / "m"))
                    assert shares.shape[0] == 2 and (winner < shares.shape[1]).all()
                except InputError:
                    refused += 1
        for cut in (0, 10, len(good) // 2):
            path.write_bytes(good[:cut])
            with pytest.raises(InputError):
                load_model(tmp_path / "m")
        path.write_bytes(good)
    assert refused > 100


@pytest.mark.parametrize("length", ["99999999999", str(1 << 32)])
@pytest.mark.parametrize("kind", ONE_LAYER)
def test_a_header_that_promises_more_than_there_is_allocates_nothing(tmp_path, kind, length):
    save_model(tmp_path / "m", models()[kind])
    name, (dtype, dimensions) = next(iter(models()[kind].layout.items()))
    shape = ", ".join([length] * dimensions) + ","
    head = f"{{'descr': '<{dtype}', 'fortran_order': False, 'shape': ({shape}), }}"
    head = head.ljust(117) + "\n"
    (tmp_path / "m" / f"{name}.npy").write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head.encode())
    with pytest.raises(InputError, match="not a model"):
        load_model(tmp_path / "m")


@pytest.mark.parametrize("kind", ONE_LAYER)
def test_a_pickled_array_is_not_loaded(tmp_path, kind):
    save_model(tmp_path / "m", models()[kind])
    name = next(iter(models()[kind].layout))
    np.save(tmp_path / "m" / f"{name}.npy", np.array([{"a": 1}], object), allow_pickle=True)
    with pytest.raises(InputError, match="not a model"):
        load_model(tmp_path / "m")


def rewrite(directory, **changes):
    path = directory / "card.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"kind": "oracle"}, "kind 'oracle' is unknown"),
        ({"kind": None}, "kind None"),
        ({"kind": []}, "kind"),
        ({"kind": "linear-svm"}, "weights.npy"),
        ({"format": FORMAT + 1}, "its layout is"),
        ({"features": ["zc"]}, "damaged"),
        ({"classes": [{"name": "a", "code": 300}] * 3}, "damaged"),
        ({"classes": "abc"}, "damaged"),
        ({"features": {"a": 1}}, "damaged"),
        ({"features": 7}, "damaged"),
        ({"computed": []}, "damaged"),
        ({"computed": "ground"}, "damaged"),
        ({"classes": [{"name": n, "code": 2, "codes": [[]]} for n in "abc"]}, "damaged"),
        ({"classes": [{"name": n, "code": True, "codes": [2]} for n in "abc"]}, "damaged"),
    ],
)
def test_a_card_that_does_not_fit_is_refused(tmp_path, change, told):
    save_model(tmp_path / "m", models()["forest"])
    rewrite(tmp_path / "m", **change)
    with pytest.raises(InputError, match=told):
        load_model(tmp_path / "m")


@pytest.mark.parametrize(
    "ready",
    [
        None,
        [],
        {"fill": [0, 0], "shift": [0, 0]},
        {"fill": [0], "shift": [0, 0], "scale": [1, 1]},
        {"fill": [0, 0], "shift": [0, 0], "scale": [1, 0]},
        {"fill": [0, 1e999], "shift": [0, 0], "scale": [1, 1]},
        {"fill": ["a", 0], "shift": [0, 0], "scale": [1, 1]},
    ],
)
@pytest.mark.parametrize("kind", ["linear-svm", "rbf-svm"])
def test_a_machine_without_a_sound_preparation_is_refused(tmp_path, kind, ready):
    save_model(tmp_path / "m", models()[kind])
    rewrite(tmp_path / "m", preparation=ready)
    with pytest.raises(InputError):
        load_model(tmp_path / "m")


@pytest.mark.parametrize(
    "change",
    [
        {"features": list(NAMES[::-1])},
        {"computed": {"cell_x": 20.0}},
        {"params": {"trees": 2}},
        {"digest": None},
        {"classes": [{"name": f"c{k}", "code": 4 - k, "codes": [4 - k]} for k in range(3)]},
        {"digest": []},
    ],
)
@pytest.mark.parametrize("kind", ONE_LAYER)
def test_card_and_arrays_belong_together(tmp_path, kind, change):
    """Whatever decides cannot be edited by accident; remarks can."""
    save_model(tmp_path / "m", models()[kind])
    rewrite(tmp_path / "m", notes=["mine"])
    assert load_model(tmp_path / "m").card["notes"] == ["mine"]
    rewrite(tmp_path / "m", **change)
    with pytest.raises(InputError, match="do not belong together"):
        load_model(tmp_path / "m")


@pytest.mark.parametrize("kind", ONE_LAYER)
def test_an_array_of_another_model_is_refused(tmp_path, kind):
    save_model(tmp_path / "m", models()[kind])
    name = {"forest": "threshold", "boosting": "threshold", "linear-svm": "weights", "rbf-svm": "vectors"}[kind]
    np.save(tmp_path / "m" / f"{name}.npy", getattr(models()[kind], name) * 2)
    with pytest.raises(InputError, match="do not belong together"):
        load_model(tmp_path / "m")


def test_a_model_without_digest_or_directory_is_refused(tmp_path):
    save_model(tmp_path / "m", models()["forest"])
    path = tmp_path / "m" / "card.json"
    path.write_text(json.dumps({k: v for k, v in json.loads(path.read_text()).items() if k != "digest"}))
    with pytest.raises(InputError, match="without digest"):
        load_model(tmp_path / "m")
    with pytest.raises(InputError, match="no such model directory"):
        load_model(tmp_path / "nomodel")
    with pytest.raises(InputError, match="a file where a model's directory is wanted"):
        load_model(path)


@pytest.mark.parametrize(("value", "sound"), [(np.nan, False), (-np.inf, False), (np.inf, True)])
@pytest.mark.parametrize("kind", ["forest", "boosting"])
def test_thresholds_of_inner_nodes_are_numbers_or_divide_known_from_missing(kind, value, sound):
    made = models()[kind]
    made.threshold[1] = value  # a leaf's says nothing
    made.check()
    made.threshold[2] = value
    if sound:
        made.check()
        return
    with pytest.raises(InputError, match="threshold"):
        made.check()


def test_offsets_that_go_round_the_numbers_are_refused(tmp_path):
    """0, 2^63 - 1, -2, 5: each is one more than the last or more, as 64 bits count."""
    made = models()["forest"]
    for offsets in ([0, 2**63 - 1, -2, 5], [0, 2, 2**62 + 2, -(2**63) + 1, -(2**62), 1, 5]):
        assert (np.diff(np.array(offsets, np.int64)) >= 1).all()
        save_model(tmp_path / str(len(offsets)), replace(made, offsets=np.array(offsets, np.int64)))
        with pytest.raises(InputError, match="do not fill"):
            load_model(tmp_path / str(len(offsets)))


def test_usual_values_beyond_what_a_number_holds_are_refused(tmp_path):
    save_model(tmp_path / "m", models()["forest"])
    for pair in ([0, 10**400], [-(10**400), 0]):
        rewrite(tmp_path / "m", ranges=dict.fromkeys(NAMES, pair))
        with pytest.raises(InputError, match="beyond what a number holds"):
            load_model(tmp_path / "m")


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("linear-svm", "weights"),
        ("linear-svm", "bias"),
        ("rbf-svm", "dual"),
        ("rbf-svm", "vectors"),
        ("rbf-svm", "gamma"),
        ("boosting", "value"),
        ("boosting", "baseline"),
    ],
)
@pytest.mark.parametrize("sign", [-1, 1])
def test_no_sum_of_a_model_is_infinite(kind, name, sign):
    """Shares that are no numbers would be delivered: a model's numbers are refused, or give some."""
    X = np.array([[3e38, -3e38], [np.nan, 9.0], [0.5, 1.0]], np.float32)
    for value, sound in ((LARGEST, True), (2 * LARGEST, False), (1e308, False)):
        made = models()[kind]
        getattr(made, name)[...] = abs(value) if name == "gamma" else sign * value
        if not sound:
            with pytest.raises(InputError, match="1e\\+100"):
                answer(X, made)
            continue
        winner, shares = answer(X, made)
        np.testing.assert_allclose(shares.sum(axis=1), 1)
        assert (winner < shares.shape[1]).all()


@pytest.mark.parametrize("kind", ["linear-svm", "rbf-svm"])
def test_a_preparation_that_makes_samples_infinite_is_refused(kind):
    made = models()[kind]
    for changed in ({"scale": [1.0, 5e-324]}, {"shift": [0.0, 1e308]}, {"fill": [1e308, 0.0]}):
        ready = {**made.card["preparation"], **changed}
        with pytest.raises(InputError):
            replace(made, card={**made.card, "preparation": ready}).check()


def test_no_number_of_json_and_no_object_are_refused(tmp_path):
    save_model(tmp_path / "m", models()["forest"])
    for text in ("NaN", "[]", "{", '{"format": Infinity}', "[" * 100_000):
        (tmp_path / "m" / "card.json").write_text(text)
        with pytest.raises(InputError):
            load_model(tmp_path / "m")


def test_only_a_forest_is_a_forest(tmp_path):
    save_model(tmp_path / "m", models()["boosting"])
    with pytest.raises(InputError, match="not a forest"):
        load_forest(tmp_path / "m")


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.integers(0, 3), min_size=9, max_size=9),
    st.lists(st.integers(0, 10), min_size=9, max_size=9),
    st.lists(st.integers(0, 9), min_size=1, max_size=5),
    st.integers(1, 4),
)
def test_any_nodes_are_sound_boosted_trees_or_an_error(feature, child, cuts, n):
    """Whatever passes the check is walked safely to a leaf."""
    asked = np.array([LEAF if f > 1 else f for f in feature], np.uint16)
    offsets = np.array([0, *sorted(cuts), 9])
    scores = 1 if n == 2 else n
    model = Boosted(
        asked,
        np.linspace(-1, 1, 9).astype(np.float32),
        np.array(child, np.uint32),
        np.arange(9, dtype=np.uint8) % 2,
        np.ones(9),
        offsets,
        np.zeros(scores),
        card(n),
    )
    X = np.array([[0.3, np.nan], [-5, 2], [np.nan, np.nan]], np.float32)
    try:
        winner, shares = answer(X, model)
    except InputError:
        return
    np.testing.assert_allclose(shares.sum(axis=1), 1)
    assert (winner < n).all()


@settings(max_examples=200, deadline=None)
@given(
    st.integers(0, 6), st.integers(0, 4), st.integers(0, 4), st.lists(st.integers(-2, 7), max_size=5), st.integers(2, 4)
)
def test_any_shapes_are_a_sound_machine_or_an_error(rows, columns, duals, counts, n):
    model = KernelMachine(
        np.ones((rows, columns)),
        np.ones((duals, rows)),
        np.zeros(n * (n - 1) // 2),
        np.array(counts, np.int64),
        np.array([1.0]),
        card(n),
    )
    try:
        winner, shares = answer(np.zeros((2, 2), np.float32), model)
    except InputError:
        return
    assert columns == 2 and shares.shape == (2, n) and (winner < n).all()


def test_a_machine_of_before_trimming_and_search_in_squares_still_opens(tmp_path):
    """Its card tells of neither; it answers as it did."""
    made = models()["rbf-svm"]
    card = {k: v for k, v in made.card.items() if k not in ("trimmed", "search", "ranges")}
    card["params"] = {"c": 1.0, "gamma": 0.3}
    old = replace(made, card=card)
    save_model(tmp_path / "m", old)
    found = load_model(tmp_path / "m")
    X = np.random.default_rng(0).normal(size=(50, len(made.features))).astype(np.float32)
    np.testing.assert_array_equal(answer(X, found)[0], answer(X, made)[0])
    assert "trimmed" not in found.card


def test_two_layers_round_trip(tmp_path):
    made = two_layers()
    save_model(tmp_path / "m", made)
    found = load_model(tmp_path / "m")
    assert isinstance(found, TwoLayer) and found.pair == made.pair and found.within == 1.5
    assert found.wide == ("eigenvalue_1_r90",) and found.card["layers"].keys() == {"coarse", "fine"}
    for layer in ("coarse", "fine"):
        for name in getattr(made, layer).layout:
            np.testing.assert_array_equal(getattr(getattr(found, layer), name), getattr(getattr(made, layer), name))
    assert load_model(tmp_path / "m" / "coarse").features == NAMES, "a layer is a model by itself"


def test_a_contextual_model_round_trips(tmp_path):
    given = contextual()
    save_model(tmp_path / "m", given)
    read = load_model(tmp_path / "m")
    assert isinstance(read, Contextual) and read.cells == given.cells
    assert read.fine.features == given.fine.features and model_digest(tmp_path / "m")


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"context": None}, "how wide its cells are"),
        ({"context": {"cells": []}}, "none"),
        ({"context": {"cells": [0.5, "wide"]}}, "how wide its cells are"),
        ({"context": {"cells": [0.5, -1.0]}}, "are none"),
        ({"context": {"cells": [0.5, float("nan")]}}, "are none"),
        ({"context": {"cells": [0.5, 1e9]}}, "are none"),
        ({"context": {"cells": [0.5, 0.00001]}}, "whole millimetres"),
        ({"context": {"cells": [0.5, 2.0]}}, "other features"),
        ({"context": {"cells": [0.5] * 1000}}, "none"),
        ({"context": {"cells": [0.5, 1.0], "weights": [1.0, 2.0]}}, "weights of 1, 2 are none"),
        ({"context": {"cells": [0.5, 1.0], "weights": [1.0, 2.0, float("nan")]}}, "weights of 1, 2, nan are none"),
        ({"context": {"cells": [0.5, 1.0], "weights": [1.0, 0.0, 1.0]}}, "weights of 1, 0, 1 are none"),
        ({"context": {"cells": [0.5, 1.0], "weights": [1.0, 1.0, 1e9]}}, "are none of its classes"),
        ({"context": {"cells": [0.5, 1.0], "weights": [1.0, 1.0, "much"]}}, "what classes weigh"),
        ({"features": ["zc"]}, "other features or classes"),
    ],
)
def test_a_card_of_a_contextual_model_that_cannot_be_is_refused(change, told):
    given = contextual()
    with pytest.raises(InputError, match=told):
        Contextual(given.coarse, given.fine, {**given.card, **change}).check()


@pytest.mark.parametrize("layers", [two_layers, contextual])
def test_damaged_layers_are_refused(tmp_path, layers):
    """Any byte of any file of either layer set to another: loading refuses, or only a remark has changed."""
    save_model(tmp_path / "m", layers())
    refused = 0
    for path in sorted(p for p in (tmp_path / "m").rglob("*") if p.is_file()):
        good = path.read_bytes()
        for at in range(0, len(good), 11):
            path.write_bytes(good[:at] + bytes([good[at] ^ 3]) + good[at + 1 :])
            try:
                load_model(tmp_path / "m")
            except InputError:
                refused += 1
        path.write_bytes(good[: len(good) // 2])
        with pytest.raises(InputError):
            load_model(tmp_path / "m")
        path.write_bytes(good)
    assert refused > 100
    load_model(tmp_path / "m")


@pytest.mark.parametrize(
    ("layer", "told"), [("coarse", "do not belong together"), ("fine", "do not belong together"), (None, "not a model")]
)
def test_a_layer_of_another_model_or_none_is_refused(tmp_path, layer, told):
    save_model(tmp_path / "m", two_layers())
    if layer is None:
        shutil.rmtree(tmp_path / "m" / "fine")
    else:
        other = two_layers(seed=2)
        shutil.rmtree(tmp_path / "m" / layer)
        save_model(tmp_path / "m" / layer, getattr(other, layer))
    with pytest.raises(InputError, match=told):
        load_model(tmp_path / "m")


def test_a_layer_with_layers_is_refused_without_following_it(tmp_path):
    save_model(tmp_path / "m", two_layers())
    save_model(tmp_path / "m" / "fine", two_layers())
    with pytest.raises(InputError, match="layers of its own"):
        load_model(tmp_path / "m")


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"refine": None}, "how near a boundary is"),
        ({"refine": {"within": -1.0}}, "is none"),
        ({"refine": {"within": "wide"}}, "how near a boundary is"),
        ({"features": ["zc"]}, "other features or classes"),
    ],
)
def test_a_card_of_two_layers_that_cannot_be_is_refused(change, told):
    made = two_layers()
    with pytest.raises(InputError, match=told):
        TwoLayer(made.coarse, made.fine, {**made.card, **change}).check()


def test_a_second_layer_names_classes_of_the_first():
    made = two_layers()
    alien = [{"name": "c0", "code": 2, "codes": [2]}, {"name": "boat", "code": 77, "codes": [77]}]
    fine = replace(made.fine, card={**made.fine.card, "classes": alien})
    with pytest.raises(InputError, match="boat"):
        TwoLayer(made.coarse, fine, made.card).check()


def test_a_tree_of_one_long_chain_is_refused():
    """Every sample would walk it: so many steps an echo that no command would end."""
    for length, refused in ((trees.DEEPEST, False), (trees.DEEPEST + 1, True)):
        node = np.arange(2 * length + 1)
        inner = (node % 2 == 0) & (node < 2 * length)
        feature = np.where(inner, 0, LEAF).astype(np.uint16)
        child = np.where(inner, node + 1, 0).astype(np.uint32)
        fault = trees.node_fault(feature, child, np.array([0, len(node)]), 1, 2)
        assert ("one after the other" in fault) == refused, fault


def test_a_digest_reads_what_a_model_has_and_nothing_else(tmp_path):
    path = tmp_path / "m"
    save_model(path, models()["forest"])
    before = model_digest(path)
    with (path / "extra.npy").open("wb") as stream:
        stream.truncate(1 << 42)  # takes no disk, and hours to read
    assert model_digest(path) == before
    (path / "child.npy").chmod(0o644)
    with (path / "child.npy").open("ab") as stream:
        stream.truncate(1 << 42)
    with pytest.raises(InputError, match="not a model of fwclass"):
        model_digest(path)
    with pytest.raises(InputError):
        model_digest(tmp_path)


@pytest.mark.parametrize("order", ["C", "F"])
def test_an_array_that_is_cut_off_while_it_is_read_is_refused(
    order: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.npy"
    values = np.asarray(np.arange(20_000.0).reshape(100, 200), order=order)
    np.save(path, values)
    np.testing.assert_array_equal(load_array(path, "<f8", 2), values)
    load = np.load

    def cut(*given: Any, **named: Any) -> Any:
        laid = load(*given, **named)
        with path.open("r+b") as file:
            file.truncate(200)
        return laid

    monkeypatch.setattr("fwclass.store.models.np.load", cut)
    with pytest.raises(ValueError, match="changed while it was read"):
        load_array(path, "<f8", 2)
