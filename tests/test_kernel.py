"""Compiled code is kept as long as it is what the source says, and no longer."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

LOWER = """
from fwclass.kernel import inlined, kernel
LIMIT = {limit}

@kernel
def more(x):
    return x + {more}

@inlined
def half(x):
    return {share} * x
"""
UPPER = """
from fwclass.kernel import kernel
from lower import LIMIT, half, more

@kernel
def total(x):
    return min(half(more(x)), LIMIT)
"""
STAMPS = """
import importlib, json, pathlib, pkgutil, fwclass
from fwclass.kernel import Kernel
found = {}
for module in pkgutil.walk_packages(fwclass.__path__, "fwclass."):
    if "fwclass.kernel import" in pathlib.Path(module.module_finder.find_spec(module.name).origin).read_text():
        names = vars(importlib.import_module(module.name))
        found |= {f"{module.name}.{name}": value.stamp() for name, value in names.items() if isinstance(value, Kernel)}
print(json.dumps(found))
"""


def run(code: str, directory: Path, **environment: str) -> str:
    """What a process prints, without bytecode: that goes by whole seconds, and files are rewritten within one."""
    path = os.pathsep.join([str(directory), str(Path(__file__).parents[1])])
    ended = subprocess.run(
        [sys.executable, "-P", "-c", code],
        env=os.environ | {"PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"} | environment,
        check=True,
        capture_output=True,
        text=True,
    )
    return ended.stdout


def test_a_kernel_follows_what_it_calls_in_other_files(tmp_path: Path) -> None:
    """numba itself looks at the time of a kernel's own file alone."""
    (tmp_path / "upper.py").write_text(UPPER)
    for numbers, answer in (
        ({"limit": 9.0, "more": 1.0, "share": 0.5}, 2.0),
        ({"limit": 9.0, "more": 5.0, "share": 0.5}, 4.0),
        ({"limit": 9.0, "more": 5.0, "share": 2.0}, 9.0),
        ({"limit": 7.0, "more": 5.0, "share": 2.0}, 7.0),
        ({"limit": 9.0, "more": 1.0, "share": 0.5}, 2.0),
    ):
        (tmp_path / "lower.py").write_text(LOWER.format(**numbers))
        told = run("from upper import total; print(total(3.0))", tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "kept"))
        assert float(told) == answer


def test_a_kernel_follows_the_defaults_of_what_it_calls(tmp_path: Path) -> None:
    (tmp_path / "upper.py").write_text(DEFAULT)
    for more in (1.0, 5.0):
        (tmp_path / "below.py").write_text(BELOW.format(more=more))
        told = run("from upper import total; print(total(3.0))", tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "kept"))
        assert float(told) == 3.0 + more


BELOW = """
from fwclass.kernel import kernel

@kernel
def add(x, more={more}):
    return x + more
"""
DEFAULT = """
from below import add
from fwclass.kernel import kernel

@kernel
def total(x):
    return add(x)
"""


def test_what_is_unchanged_is_not_compiled_again(tmp_path: Path) -> None:
    (tmp_path / "lower.py").write_text(LOWER.format(limit=9.0, more=1.0, share=0.5))
    code = "import upper; upper.total(3.0); print(sum(upper.total.compiled().stats.cache_hits.values()))"
    hits = []
    for _ in range(2):
        (tmp_path / "upper.py").write_text(UPPER)
        hits.append(int(run(code, tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "kept"))))
    assert hits == [0, 1]


def test_stamps_are_the_same_in_every_process(tmp_path: Path) -> None:
    one, other = (json.loads(run(STAMPS, tmp_path, PYTHONHASHSEED=seed)) for seed in ("1", "2"))
    assert len(one) > 200 and one == other


def test_kernels_that_are_compiled_ahead_exist() -> None:
    """A kernel that moved would be compiled by the first who needs it, and nobody be told."""
    root = Path(__file__).parents[1]
    for name, *_ in json.loads((root / "conf" / "kernels.json").read_text()):
        module, _, kernel = name.rpartition(".")
        assert f"\ndef {kernel}(" in (root / f"{module.replace('.', '/')}.py").read_text(), name
