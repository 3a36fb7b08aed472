"""The workflow of a user's own file: Python that the command line names, loaded in every worker."""

from __future__ import annotations

import hashlib
import importlib.abc
import importlib.machinery
import importlib.util
import sys
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

from fwclass.errors import ConfigError, FwclassError, InputError, StoreError
from fwclass.graph.own_stage import Adapter
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import StageInputs
from fwclass.graph.stages import STAGES
from fwclass.paths import open_regular
from fwclass.walk.workflow import Workflow

_PREFIX = "fwclass_own_"
"""Of the names under which such files are modules."""


def own_workflow(path: Path) -> Workflow:
    """The `workflow` of a user's file. Its own functions travel to workers by file and name, and the file's digest is
    in the key of every part of a stage that is not the program's.

    `ConfigError`: no such file, it cannot be imported, it has no `workflow`, or one that no run can go through.
    """
    where = path.resolve()
    try:
        with open_regular(where) as file:
            digest = hashlib.sha256(file.read()).hexdigest()
    except OSError as fault:
        raise ConfigError(
            "the workflow's file cannot be read",
            where="--workflow",
            got=f"{path}: {fault.strerror}",
            do="name a Python file, or one of the workflows that `fwclass run --help` lists",
        ) from fault
    try:
        module = _module(where, digest)
    except FwclassError:
        raise
    except (Exception, SystemExit) as fault:
        raise ConfigError(
            "the workflow's file cannot be imported",
            where=_line(fault, where),
            got=f"{type(fault).__name__}: {fault}",
            do="mend it; it can import what is installed, no files beside it; fwclass's own are fwclass.workflows.NAME",
        ) from fault
    workflow = getattr(module, "workflow", None)
    if not isinstance(workflow, Workflow):
        raise ConfigError(
            "the file has no workflow",
            where=path,
            expected="workflow = classification.with_stage(...), as docs/extending.md shows",
            got="nothing of that name" if workflow is None else type(workflow).__name__,
        )
    ours = {id(stage) for stage in STAGES}
    stages = tuple(s if id(s) in ours else _by_file(s, where, digest, module) for s in workflow.stages)
    workflow = replace(workflow, stages=stages)
    workflow.check(path)
    return workflow


def _line(fault: BaseException, path: Path) -> str:
    """Where in the file a fault came from, as path:line."""
    if isinstance(fault, SyntaxError) and fault.lineno:
        return f"{path}:{fault.lineno}"
    lines = [f.lineno for f in traceback.extract_tb(fault.__traceback__) if f.filename == str(path)]
    return f"{path}:{lines[-1]}" if lines else str(path)


def _by_file(stage: Stage, path: Path, digest: str, module: ModuleType) -> Stage:
    """A stage of the file's own, with its function named by file and the file's digest in its key."""
    adapter: Any = stage.function if isinstance(stage.function, Adapter) else None
    inner: Any = adapter.function if adapter else stage.function
    if not isinstance(inner, FunctionType):
        raise _no_function(stage, path, f"{type(inner).__name__} {inner!r}")
    named: Callable[..., Any] = inner
    if getattr(inner, "__module__", "") == module.__name__:
        if vars(module).get(inner.__name__) != inner:
            raise _no_function(stage, path, inner.__qualname__)
        named = FunctionOfFile(str(path), digest, inner.__name__, stage.name)
    own_arguments = stage.arguments

    def arguments(plan: Plan) -> Mapping[str, Any]:
        return {**own_arguments(plan), "code": digest[:16]}

    work = replace(adapter, function=named) if adapter else named
    return replace(stage, function=_WithoutCode(work), arguments=arguments)


def _no_function(stage: Stage, path: Path, got: str) -> ConfigError:
    return ConfigError(
        "the work of a stage is a function of the file, by its name",
        where=f"{path}, stage {stage.name}",
        expected="def name(...): at the file's outermost level; workers look it up by that name",
        got=got[:120],
        do="give what it needs as settings, not by a lambda, a closure, a partial or an object",
    )


@dataclass(frozen=True)
class FunctionOfFile:
    """A function of a user's file, by name: workers import the file, and refuse it if it is not the one of `digest`.

    What the function raises is told with the line of the file.
    """

    path: str
    digest: str
    name: str
    stage: str

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        path = Path(self.path)
        function = getattr(_module(path, self.digest), self.name)
        try:
            return function(*arguments, **named)
        except (MemoryError, FwclassError, OSError):
            raise
        except (Exception, SystemExit) as fault:
            text = fault.args[0] if isinstance(fault, KeyError) and fault.args else fault
            raise InputError(
                "the function of a stage failed",
                where=f"{_line(fault, path)}, stage {self.stage}",
                got=f"{type(fault).__name__}: {text}",
                do="mend it; a column that it needs is named in the stage's `reads`",
            ) from fault


@dataclass(frozen=True)
class _WithoutCode:
    """Takes the file's digest, which is for the key alone, from the arguments."""

    function: Callable[..., Any]

    def __call__(self, here: StageInputs, code: str, **arguments: Any) -> Any:
        return self.function(here, **arguments)


class _FromBytes(importlib.abc.SourceLoader):
    """Takes a module's code from the bytes whose digest was looked at, never from a ``__pycache__`` beside its file:
    whoever brought the directory may have filled that."""

    def __init__(self, path: str, source: bytes) -> None:
        self._path, self._source = path, source

    def get_filename(self, fullname: str) -> str:
        return self._path

    def get_data(self, path: str | bytes) -> bytes:
        return self._source


def _module(path: Path, digest: str) -> ModuleType:
    """The module of a file with these bytes, imported once in a process."""
    name = _PREFIX + digest[:16]
    if name in sys.modules:
        return sys.modules[name]
    with open_regular(path) as file:
        source = file.read()
    if hashlib.sha256(source).hexdigest() != digest:
        raise StoreError(
            "the workflow's file was changed while the run was under way", where=path, do="run the same again"
        )
    loader = _FromBytes(str(path), source)
    spec = importlib.machinery.ModuleSpec(name, loader, origin=str(path))
    spec.has_location = True  # `__file__`
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
