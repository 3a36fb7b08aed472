"""Kernels compute compiled what their Python says: every one of them once more without compilation, on small data."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

import workloads

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
CLOSE = {"float64": {"rtol": 1e-9, "atol": 1e-12}, "float32": {"rtol": 1e-6, "atol": 1e-12}}
"""Only kernels that are `vectorised` may differ at all, in their last bits: they may sum in another order."""

NOT_REACHED: dict[str, str] = {}
"""Kernels that no work of `workloads` calls, and why."""


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """What was told by a process without compilation, and the directory of its answers."""
    out = tmp_path_factory.mktemp("uncompiled")
    line = [sys.executable, str(Path(__file__).with_name("child.py")), str(out)]
    ended = subprocess.run(
        line,
        env=os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert ended.returncode == 0, ended.stderr[-3000:]
    return json.loads((out / "told.json").read_text()), out


@pytest.mark.parametrize("name", workloads.WORK)
def test_compiled_answers_are_those_of_the_python(plain, name, tmp_path):
    told, out = plain
    assert not numba.config.DISABLE_JIT, "here they are compiled"
    assert not told["work"][name]["fault"], told["work"][name]["fault"]
    answers = workloads.flat(workloads.WORK[name](tmp_path))
    assert list(answers) == told["work"][name]["answers"] and answers
    with np.load(out / f"{name}.npz") as kept:
        for k, (path, compiled) in enumerate(answers.items()):
            python = kept[f"a{k}"]
            assert python.shape == compiled.shape and python.dtype == compiled.dtype, path
            if compiled.dtype.kind == "f":
                np.testing.assert_allclose(compiled, python, err_msg=path, **CLOSE[compiled.dtype.name])
            else:
                np.testing.assert_array_equal(compiled, python, err_msg=path)


def test_every_kernel_is_reached_but_those_that_are_named(plain):
    told, _ = plain
    reached = {kernel for work in told["work"].values() for kernel in work["kernels"]}
    left = set(told["kernels"]) - reached
    print(f"{len(told['kernels']) - len(left)} of {len(told['kernels'])} kernels were called; not {sorted(left)}")
    assert len(told["kernels"]) > 200 and reached <= set(told["kernels"])
    assert left == set(NOT_REACHED)
