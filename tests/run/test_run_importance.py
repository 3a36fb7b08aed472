"""The parts that weigh features join to what the whole forest gives, and the model's card holds it."""

from types import SimpleNamespace

import numpy as np
from defaults import BASE as DEFAULTS

from fwclass.graph import learn
from fwclass.graph.stage_work import StageInputs
from fwclass.graph.training_rows import SAMPLE
from fwclass.model import ClassDef
from fwclass.store.arrays import arrays_at, read_arrays, write_arrays
from fwclass.store.models import load_model
from fwclass.train.importance import importance
from fwclass.train.params import TrainParams
from fwclass.train.sample import Sample
from fwclass.train.stage import grow_trees

BASE = DEFAULTS["train"]
CLASSES = (ClassDef("ground", 2, (2,)), ClassDef("tree", 5, (5,)))
NAMES = ("zc", "width", "amplitude")


def test_importance_in_parts(tmp_path):
    r = np.random.default_rng(1)
    y = r.integers(0, 2, 300).astype(np.uint8)
    X = (r.normal(size=(300, 3)) + y[:, None] * [2, 0.5, 0]).astype(np.float32)
    key = np.arange(300, dtype=np.uint64)
    sample = Sample(NAMES, X, y, key, key, np.bincount(y))
    params = TrainParams(**{**BASE, "trees": 4, "importance_repeats": 3})

    def path(stage, part, name=""):
        (tmp_path / stage / part).mkdir(parents=True, exist_ok=True)
        return tmp_path / stage / part / name

    inputs = SimpleNamespace(
        path=path,
        arrays=lambda stage, part, name, only=None: read_arrays(arrays_at(path(stage, part, name)), only),
        arrays_path=lambda stage, part, name: arrays_at(path(stage, part, name)),
        digest=lambda stage, part: "",
        meta=lambda stage, part: {},
    )
    write_arrays(path("training", "all") / SAMPLE, sample.arrays())
    for first, count in ((0, 3), (3, 1)):
        part = f"{first:05d}"
        learn.grow_part(StageInputs(inputs, path("trees", part), part), NAMES, params, CLASSES, count)
        learn.measure_importance(StageInputs(inputs, path("importance", part), part), NAMES, params, 3)
    needs = tuple((stage, part) for stage in ("trees", "importance") for part in ("00000", "00003"))
    here = StageInputs(inputs, path("train", "model"), "model", needs)
    made = learn.deliver_forest(here, NAMES, params, CLASSES, {})
    expected = importance(sample, grow_trees(sample, CLASSES, 0, 4, params), 2, params.drawing, 3)
    for card in (made["card"], load_model(path("train", "model", learn.MODEL)).card):
        told = card["importance"]
        assert told["repeats"] == 3
        assert [told["drop"][n]["mean"] for n in NAMES] == expected.mean(axis=1).tolist()
