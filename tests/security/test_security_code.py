"""Nothing in the package turns bytes from outside into code."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest
from modelmaker import models

from fwclass.errors import InputError
from fwclass.store.models import load_model, save_model

ROOT = Path(__file__).parents[2]
SOURCES = sorted(p for d in ("fwclass", "workflows") for p in (ROOT / d).rglob("*.py"))

MODULES = {"pickle", "cPickle", "_pickle", "cloudpickle", "dill", "joblib", "marshal", "shelve", "copyreg", "code"}
BUILTINS = {"eval", "exec", "compile", "__import__"}
YAML = {"load", "load_all", "full_load", "full_load_all", "unsafe_load", "unsafe_load_all"}
SHELL = {("os", "system"), ("os", "popen"), ("subprocess", "getoutput"), ("subprocess", "getstatusoutput")}
EXECUTED = {"fwclass/compiling.py": "imports pickle", "fwclass/cli/__init__.py": "calls exec"}
"""Compiled code is run, whatever it is wrapped in: its directory is the user's alone (`isolation.kernel_cache`). A
command executes the text ``pass`` before it ends by an interrupt."""

FILES = {"load", "save", "savez", "savez_compressed", "fromregex"}


def faults(tree: ast.AST) -> list[str]:
    """What in a module could run code that a file brings, with its line."""
    found = []
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [a.name.split(".")[0] for a in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [(node.module or "").split(".")[0]]
        found += [f"{node.lineno}: imports {n}" for n in names if n in MODULES]
        if isinstance(node, ast.Call):
            found += [f"{node.lineno}: {fault}" for fault in _of_call(node)]
    return found


def _of_call(node: ast.Call) -> list[str]:
    given = {k.arg: k.value for k in node.keywords}

    def is_true(name: str) -> bool:
        value = given.get(name)
        return value is not None and not (isinstance(value, ast.Constant) and not value.value)

    if isinstance(node.func, ast.Name):
        return [f"calls {node.func.id}"] if node.func.id in BUILTINS else []
    if not isinstance(node.func, ast.Attribute):
        return []
    name, owner = node.func.attr, node.func.value.id if isinstance(node.func.value, ast.Name) else ""
    found = []
    if owner == "yaml" and name in YAML:
        found.append(f"yaml.{name}")
    if (owner, name) in SHELL or is_true("shell"):
        found.append(f"a shell: {owner}.{name}")
    pickles = given.get("allow_pickle")
    refused = isinstance(pickles, ast.Constant) and pickles.value is False
    if owner == "np" and name in FILES and not refused:
        found.append(f"np.{name} without allow_pickle=False")
    if pickles is not None and not refused:
        found.append("allow_pickle")
    return found


def test_no_module_runs_what_a_file_says() -> None:
    assert len(SOURCES) > 300
    found = {p.relative_to(ROOT).as_posix(): faults(ast.parse(p.read_text(encoding="utf-8"))) for p in SOURCES}
    seen = {name: [fault.partition(": ")[2] for fault in what] for name, what in found.items() if what}
    assert seen == {name: [fault] for name, fault in EXECUTED.items()}
    assert (ROOT / "fwclass/cli/__init__.py").read_text(encoding="utf-8").count("exec(") == 1
    assert 'exec("pass")' in (ROOT / "fwclass/cli/__init__.py").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "code",
    [
        "import pickle",
        "from marshal import loads",
        "import shelve as s",
        "eval('1')",
        "exec(x)",
        "yaml.load(text)",
        "yaml.unsafe_load(text)",
        "np.load(path)",
        "np.load(path, allow_pickle=True)",
        "np.save(path, a)",
        "subprocess.run(words, shell=True)",
        "os.system(words)",
        "subprocess.Popen(words, shell=wanted)",
        "__import__(name)",
        "numpy.load(path, allow_pickle=wanted)",
        "def f():\n  import cloudpickle",
    ],
)
def test_the_scan_sees_what_it_looks_for(code: str) -> None:
    assert faults(ast.parse(code))


def test_an_array_of_objects_is_refused(tmp_path: Path) -> None:
    save_model(tmp_path / "m", models()["forest"])
    np.save(tmp_path / "m" / "feature.npy", np.array([print, {}], object), allow_pickle=True)
    with pytest.raises(InputError, match="not a model"):
        load_model(tmp_path / "m")


@pytest.mark.parametrize("version", [2, 3])
def test_an_array_whose_header_may_be_of_any_length_is_refused(version: int, tmp_path: Path) -> None:
    save_model(tmp_path / "m", models()["forest"])
    path = tmp_path / "m" / "feature.npy"
    data = path.read_bytes()
    path.write_bytes(data[:6] + bytes([version, 0]) + data[8:10] + b"\0\0" + data[10:])
    with pytest.raises(InputError, match="version 1 of the format"):
        load_model(tmp_path / "m")
