"""A forest as an ONNX graph, for programs that are not this one (operators: ai.onnx.ml TreeEnsembleClassifier).

input ``X`` float32 (rows, features) → ``label`` int64 (rows,) class codes, ``votes`` float32 (rows, classes) whole
numbers, ``probabilities`` float32 (rows, classes) votes over trees. Infinite values count as missing, a missing value
(NaN) goes right at every node and a value on a threshold too, as here: every row gets the same class.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import ConfigError
from fwclass.model import LEAF, Forest

OPSET, ML_OPSET, IR_VERSION = 17, 3, 8
"""Old enough for ONNX Runtime 1.12 (2022) and all that followed."""


def onnx_forest(forest: Forest) -> bytes:
    """The graph, serialised; `ConfigError` where the package onnx is not installed.

    The features in order, the classes and the whole card stand in the model's metadata.
    """
    try:
        from onnx import TensorProto, checker, helper
    except ImportError as fault:
        raise ConfigError(
            "the package onnx is not installed", where="--format onnx", do="pip install 'fwclass[onnx]'"
        ) from fault
    forest.check()
    wide, n_classes = len(forest.features), len(forest.codes)
    nodes = [
        helper.make_node("IsInf", ["X"], ["infinite"]),
        helper.make_node("Where", ["infinite", "nan", "X"], ["known"]),
        helper.make_node(
            "TreeEnsembleClassifier", ["known"], ["unused", "votes"], domain="ai.onnx.ml", **attributes(forest)
        ),
        helper.make_node("ArgMax", ["votes"], ["winner"], axis=1, keepdims=0),  # the first on a tie
        helper.make_node("Gather", ["codes", "winner"], ["label"]),
        helper.make_node("Div", ["votes", "trees"], ["probabilities"]),
    ]
    constants = [
        helper.make_tensor("nan", TensorProto.FLOAT, [], [float("nan")]),
        helper.make_tensor("codes", TensorProto.INT64, [n_classes], forest.codes.tolist()),
        helper.make_tensor("trees", TensorProto.FLOAT, [], [float(forest.trees)]),
    ]
    outputs = [
        helper.make_tensor_value_info("label", TensorProto.INT64, ["rows"]),
        helper.make_tensor_value_info("votes", TensorProto.FLOAT, ["rows", n_classes]),
        helper.make_tensor_value_info("probabilities", TensorProto.FLOAT, ["rows", n_classes]),
    ]
    graph = helper.make_graph(
        nodes, "forest", [helper.make_tensor_value_info("X", TensorProto.FLOAT, ["rows", wide])], outputs, constants
    )
    opsets = [helper.make_opsetid("", OPSET), helper.make_opsetid("ai.onnx.ml", ML_OPSET)]
    model = helper.make_model(graph, opset_imports=opsets, ir_version=IR_VERSION, producer_name="fwclass")
    helper.set_model_props(
        model,
        {
            "features": json.dumps(list(forest.features)),
            "classes": json.dumps(forest.card["classes"]),
            "card": json.dumps(dict(forest.card), sort_keys=True),
        },
    )
    checker.check_model(model)
    return model.SerializeToString()


def attributes(forest: Forest) -> dict[str, Any]:
    """The trees as attributes of TreeEnsembleClassifier; a leaf weighs 1 for its class, so sums are votes."""
    inner = forest.feature != LEAF
    size = np.diff(forest.offsets)
    tree = np.repeat(np.arange(forest.trees), size)
    own = np.arange(len(inner)) - np.repeat(forest.offsets[:-1], size)
    child = forest.child.astype(np.int64)
    leaf, n_classes = np.flatnonzero(~inner), len(forest.codes)
    # Every row passes the first tree: its leaves name every class with weight 0, for where a row has no score of the
    # second of two classes, ONNX Runtime takes the first's for a margin.
    first = np.repeat(leaf[leaf < forest.offsets[1]], n_classes)
    every = np.resize(np.arange(n_classes), len(first))
    return {
        "nodes_treeids": tree.tolist(),
        "nodes_nodeids": own.tolist(),
        "nodes_featureids": _where(inner, forest.feature.astype(np.int64)),
        "nodes_values": np.where(inner, forest.threshold, np.float32(0)).tolist(),
        "nodes_modes": np.where(inner, b"BRANCH_LT", b"LEAF").tolist(),
        "nodes_truenodeids": _where(inner, child),
        "nodes_falsenodeids": _where(inner, child + 1),
        "nodes_missing_value_tracks_true": np.zeros(len(inner), np.int64).tolist(),
        "class_treeids": tree[np.r_[leaf, first]].tolist(),
        "class_nodeids": own[np.r_[leaf, first]].tolist(),
        "class_ids": np.r_[child[leaf], every].tolist(),
        "class_weights": [1.0] * len(leaf) + [0.0] * len(first),
        "classlabels_int64s": list(range(n_classes)),
        "post_transform": "NONE",
    }


def _where(inner: NDArray[np.bool_], values: NDArray[np.int64]) -> list[int]:
    return list(np.where(inner, values, 0).tolist())
