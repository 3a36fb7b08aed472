"""Two runs compared on the blocks that both judged, and the intervals of a run's own figures."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
from runmaker import walk
from tolerances import FLOAT64_UNIT

from fwclass.assess.intervals import FEW, FIGURES, caution
from fwclass.errors import InputError
from fwclass.operate.assess_runs import assess_runs, describe
from fwclass.store.arrays import read_arrays
from fwclass.store.run_store import Store

pytestmark = pytest.mark.slow


def test_a_run_gains_nothing_over_itself_and_blocks_are_its_confusion(finished):
    root = finished[0]
    told = json.loads((root / "report.json").read_text())["accuracy"]
    arrays, _ = read_arrays(Store(root).arrays_path("assess", "all", "counts"))
    assert (arrays["blocks"].sum(axis=0)[:, :-1] == np.array(told["confusion"])).all()
    if told["intervals"] is None:
        with pytest.raises(InputError, match="too few blocks"):
            assess_runs(root, root)
    else:
        made = assess_runs(root, root)
        assert made["kappa"] == {"difference": 0.0, "interval": [0.0, 0.0]}
        assert "+0.00" in describe(made)


def test_the_gain_is_that_of_the_reports(survey, finished, tmp_path):
    """Fewer, smaller trees are another map of the same echoes; small blocks make intervals of a small area."""
    roots, reports = [], []
    for trees in (11, 2):
        root = tmp_path / str(trees)
        shutil.copytree(finished[0], root, symlinks=True)
        walk(survey, root, f"train.trees={trees}", "assess.block=5")
        roots.append(root)
        reports.append(json.loads((root / "report.json").read_text())["accuracy"])
    made = assess_runs(*roots)
    for name in ("overall_accuracy", "kappa", "mean_iou"):
        assert made[name]["difference"] == pytest.approx(reports[1][name] - reports[0][name], abs=FLOAT64_UNIT)
        low, high = made[name]["interval"]
        assert low <= made[name]["difference"] <= high
    assert ("CAUTION" in describe(made)) == (made["blocks"] < FEW)
    assert (reports[0]["intervals"]["caution"] is None) == (reports[0]["intervals"]["blocks"] >= FEW)
    low, high = reports[0]["intervals"]["overall_accuracy"]
    assert low <= reports[0]["overall_accuracy"] <= high
    with pytest.raises(InputError, match="not judged on the same echoes"):
        assess_runs(roots[0], finished[0])


def test_few_blocks_are_told():
    part = {"difference": 0.01, "interval": [-0.1, 0.2]}
    made = {"level": 0.95, "blocks": 7, "caution": caution(7), **dict.fromkeys(FIGURES, part)}
    assert "from 7 blocks" in describe(made) and "CAUTION: 7 blocks are too few blocks to lean on" in describe(made)
    assert "CAUTION" not in describe({**made, "caution": None})


def test_a_directory_that_is_no_run_is_refused(finished, tmp_path):
    with pytest.raises(InputError, match="no assessed run"):
        assess_runs(finished[0], tmp_path)
