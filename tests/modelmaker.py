"""A small model of every kind, for tests."""

from __future__ import annotations

import numpy as np

from fwclass.model import FORMAT, LEAF, Boosted, Contextual, Forest, KernelMachine, LinearMachine, TwoLayer
from fwclass.model.contextual import context_names
from fwclass.train.stage import Grower

NAMES = ("zc", "width")


def card(n=3, **more):
    classes = [{"name": f"c{k}", "code": 2 + k, "codes": [2 + k]} for k in range(n)]
    ready = {"fill": [0.0, 1.0], "shift": [0.0, 2.0], "scale": [1.0, 3.0]}
    return {"format": FORMAT, "features": list(NAMES), "classes": classes, "preparation": ready, "notes": [], **more}


def tree():
    feature = np.array([0, LEAF, 1, LEAF, LEAF], np.uint16)
    return feature, np.array([1, 0, 2, 0, 0], np.float32), np.array([1, 0, 3, 0, 0], np.uint32), np.array([0, 5])


def models():
    feature, threshold, child, offsets = tree()
    side, value = np.array([1, 0, 0, 0, 0], np.uint8), np.array([0, 0.5, 0, -1, 2.0])
    thrice = [np.tile(a, 3) for a in (feature, threshold, child, side, value)]
    return {
        "forest": Forest(feature, threshold, child, offsets, card()),
        "boosting": Boosted(*thrice, np.array([0, 5, 10, 15]), np.array([0.1, 0.2, 0.3]), card()),
        "linear-svm": LinearMachine(np.arange(6.0).reshape(3, 2), np.ones(3), card()),
        "rbf-svm": KernelMachine(
            np.arange(8.0).reshape(4, 2), np.ones((2, 4)), np.zeros(3), np.array([1, 2, 1]), np.array([0.5]), card()
        ),
    }


def two_layers(seed=1, within=1.5):
    """A forest of three classes, and a machine between the first two by one wide feature and one of the forest's."""
    coarse, r = models()["forest"], np.random.default_rng(seed)
    if seed != 1:
        coarse.threshold[:] += np.float32(seed)
    names = ["eigenvalue_1_r90", "width"]
    own = {**card(2), "features": names}
    fine = KernelMachine(r.normal(size=(5, 2)), r.normal(size=(1, 5)), np.zeros(1), np.array([2, 3]), np.ones(1), own)
    return TwoLayer(coarse, fine, {**card(), "kind": "two-layer", "refine": {"within": within}})


def contextual(cells=(0.5, 1.0), split=0.4):
    """A forest of three classes, and one by its features and the neighbours' shares of the last class."""
    coarse = models()["forest"]
    names = (*NAMES, *context_names(coarse.codes, cells))
    feature, threshold, child, offsets = tree()
    feature = np.where(feature == 0, len(names) - 1, feature).astype(np.uint16)
    threshold = np.where(feature == len(names) - 1, split, threshold).astype(np.float32)
    fine = Forest(feature, threshold, child, offsets, {**card(), "features": list(names)})
    return Contextual(coarse, fine, {**card(), "kind": "contextual", "context": {"cells": list(cells)}})


def grow_tree(X, y, n_classes, tree, params):
    """Tree number `tree` of a sample X (rows, features), y (rows,), whose classes are called 0, 1 …"""
    return Grower(X, y, [str(c) for c in range(n_classes)], params).tree(tree)
