"""The exported forest, run by ONNX Runtime, says what the forest says."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from fwclass.classify.stage import classify, votes
from fwclass.errors import ConfigError
from fwclass.model import FORMAT, LEAF, assemble
from fwclass.publish.onnx_forest import onnx_forest
from fwclass.schema import Table
from fwclass.store.models import save_model

NAMES = ("zc", "width", "echo_ratio_r100", "amplitude")


def random_tree(r, splits, n_classes):
    feature, threshold, child = [LEAF], [0.0], [int(r.integers(n_classes))]
    for _ in range(splits):
        leaf = r.choice(np.flatnonzero(np.array(feature) == LEAF))
        limit = np.inf if r.random() < 0.05 else np.rint(4 * r.normal()) / 4  # values lie on thresholds
        feature[leaf], threshold[leaf], child[leaf] = int(r.integers(len(NAMES))), limit, len(feature)
        feature += [LEAF, LEAF]
        threshold += [0.0, 0.0]
        child += r.integers(n_classes, size=2).tolist()
    return np.array(feature, np.uint16), np.array(threshold, np.float32), np.array(child, np.uint32)


def forest(n_classes, trees=30, splits=40, seed=0):
    r = np.random.default_rng(seed)
    codes = (2, 5, 6, 9, 17)[:n_classes]
    card = {
        "format": FORMAT,
        "kind": "forest",
        "features": list(NAMES),
        "classes": [{"name": f"class {c}", "code": c, "codes": [c]} for c in codes],
    }
    return assemble([random_tree(r, int(r.integers(splits)), n_classes) for _ in range(trees)], card)


def rows(n, seed=1):
    r = np.random.default_rng(seed)
    X = (np.rint(4 * r.normal(size=(n, len(NAMES)))) / 4).astype(np.float32)
    X[r.random(X.shape) < 0.15] = np.nan
    X[0] = np.nan
    return X


def run(content, X):
    runtime = pytest.importorskip("onnxruntime", reason="onnxruntime is not installed: the export was not run")
    session = runtime.InferenceSession(content, providers=["CPUExecutionProvider"])
    return session.run(["label", "votes", "probabilities"], {"X": X}), session.get_modelmeta().custom_metadata_map


@pytest.mark.parametrize("n_classes", [2, 3, 5])
@pytest.mark.parametrize("trees", [1, 2, 30])
def test_onnx_runtime_gives_the_same_votes_and_classes(n_classes, trees):
    pytest.importorskip("onnx", reason="onnx is not installed: the export was not made")
    model, X = forest(n_classes, trees), rows(3000)
    (label, cast, shares), told = run(onnx_forest(model), X)
    expected = votes(X, model)
    np.testing.assert_array_equal(cast, expected)
    np.testing.assert_array_equal(np.rint(shares * trees), expected)
    np.testing.assert_array_equal(label, classify(X, model)["classification"])
    assert json.loads(told["features"]) == list(NAMES)
    assert [c["code"] for c in json.loads(told["classes"])] == model.codes.tolist()


def test_infinite_values_are_missing_values_there_too():
    pytest.importorskip("onnx", reason="onnx is not installed: the export was not made")
    model, X = forest(3), rows(500)
    X[np.isnan(X)] = np.inf
    X[::2][np.isinf(X[::2])] = -np.inf
    (label, _, _), _ = run(onnx_forest(model), X)
    table = Table({name: X[:, k] for k, name in enumerate(NAMES)})
    np.testing.assert_array_equal(label, classify(table, model)["classification"])


def test_without_the_package_it_says_so(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(ConfigError, match="onnx is not installed"):
        onnx_forest(forest(2))


def test_the_command_writes_a_file_and_no_other_over_it(tmp_path):
    pytest.importorskip("onnx", reason="onnx is not installed: the export was not made")
    from fwclass.cli import cli

    save_model(tmp_path / "model", forest(3))
    command = ["export", str(tmp_path / "model"), str(tmp_path / "made" / "forest.onnx")]
    (tmp_path / "made").mkdir()
    assert CliRunner().invoke(cli, command).exit_code == 0
    content = (tmp_path / "made" / "forest.onnx").read_bytes()
    (label, _, _), _ = run(content, rows(10))
    assert len(label) == 10
    again = CliRunner().invoke(cli, command)
    assert isinstance(again.exception, ConfigError)
    assert CliRunner().invoke(cli, [*command, "--overwrite"]).exit_code == 0
    assert [p.name for p in (tmp_path / "made").iterdir()] == ["forest.onnx"]


@pytest.mark.parametrize(("name", "says"), [("no/forest.onnx", "does not exist"), ("forest.txt", "ends in .onnx")])
def test_the_command_refuses_a_place_or_an_ending_that_is_none(tmp_path, name, says):
    from fwclass.cli import cli

    save_model(tmp_path / "model", forest(3))
    made = CliRunner().invoke(cli, ["export", str(tmp_path / "model"), str(tmp_path / name)])
    assert isinstance(made.exception, ConfigError) and says in str(made.exception)
    assert [p.name for p in tmp_path.iterdir()] == ["model"]
