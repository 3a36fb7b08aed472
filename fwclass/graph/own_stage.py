"""Workflows and stages of a user's own file: Python that the command line names, loaded in every worker."""

from __future__ import annotations

import hashlib
import importlib.util
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fwclass.classify.stage import CLASSIFY
from fwclass.errors import ConfigError, StoreError
from fwclass.graph.classify import CLASSIFY_ECHOES
from fwclass.graph.ground import FILTER_GROUND, around_block, of_flags
from fwclass.graph.stage import Made, Plan, Stage, StageInputs, always
from fwclass.graph.workflow import Workflow
from fwclass.ground.filters import Flags
from fwclass.schema import Column, Table

CLASSIFY_COLUMNS = CLASSIFY.writes
_PREFIX = "fwclass_own_"
"""Of the names under which such files are modules."""


def chunk_stage(
    name: str,
    function: Callable[..., Mapping[str, ArrayLike]],
    reads: tuple[str, ...],
    writes: Iterable[Column],
    halo: float = 0.0,
    settings: Mapping[str, Any] | None = None,
    version: int = 1,
) -> Stage:
    """A stage of one function over an overlapping chunk.

    Parameters
    ----------
    name : of the stage, in the store and in reports.
    function : ``function(chunk, **settings)`` gives for every column one value per core row, in the order of
        ``chunk.core``; `chunk` has the columns `reads`, the identity, x and y, of the tile and of its neighbours within
        `halo` [m], in canonical order. What it computes of an echo must follow from the echoes within `halo` of it.
    writes : the columns; those of the program's own names are not given again.
    settings : plain data; they enter the key of every part, as the bytes of the file do.
    version : raised where another library or file that the function uses makes it give something else.
    """
    columns = tuple(writes)
    return Stage(
        name,
        version,
        "tile",
        "echo",
        OfChunk(function),
        arguments=lambda plan: dict(settings or {}),
        reads=reads,
        writes=tuple(c.name for c in columns),
        declares=columns,
        halo=halo,
        cells=True,
    )


def ground_filter_stage(
    function: Callable[..., tuple[ArrayLike, ArrayLike]],
    halo: float,
    settings: Mapping[str, Any] | None = None,
    version: int = 1,
) -> Stage:
    """A ground filter in the place of the program's (`Workflow.with_stage_instead`).

    ``function(table, **settings)`` gives two flags for every row, ground and noise; `table` has x, y, z, echo number,
    number of echoes and fit flags of a block of ``ground.block`` and what lies within `halo` [m] around it.
    """
    return replace(
        FILTER_GROUND,
        version=version,
        function=OfBlock(function),
        arguments=lambda plan: {**(settings or {}), "block": plan.config.ground.block},
        halo=halo,
    )


def classifier_stage(
    function: Callable[..., Mapping[str, ArrayLike]],
    reads: tuple[str, ...],
    settings: Mapping[str, Any] | None = None,
    version: int = 1,
) -> Stage:
    """A classifier in the place of the program's; what trains may be left out (`Workflow.without_training`).

    ``function(table, **settings)`` gives ``classification`` (codes), ``confidence`` and ``entropy`` for every row of a
    tile; `table` has the columns `reads`.
    """
    return replace(
        CLASSIFY_ECHOES,
        version=version,
        function=OfRows(function),
        when=always,
        arguments=lambda plan: dict(settings or {}),
        own=reads,
        writes=CLASSIFY_COLUMNS,
        after=(),
        needs=lambda plan, tile: (),
        source=lambda plan, tile: None,
    )


def delivery_stage(
    name: str,
    function: Callable[..., object],
    reads: tuple[str, ...],
    settings: Mapping[str, Any] | None = None,
    version: int = 1,
) -> Stage:
    """An output format more: ``function(table, directory, tile, **settings)`` writes files of a tile below `directory`,
    at the paths that they have in the delivery; `table` has the columns `reads`, `tile` is the tile's key."""
    return Stage(
        name,
        version,
        "tile",
        "echo",
        OfDelivery(function),
        arguments=lambda plan: dict(settings or {}),
        own=reads,
        where="deliver",
    )


@dataclass(frozen=True)
class OfBlock:
    """The adapter of a ground filter."""

    function: Callable[..., tuple[ArrayLike, ArrayLike]]

    def __call__(self, here: StageInputs, block: float, **settings: Any) -> Made:
        around = around_block(here)
        ground, noise = (np.asarray(flags, bool) for flags in self.function(around.table, **settings))
        return of_flags(around, Flags(ground, noise))


@dataclass(frozen=True)
class OfRows:
    """The adapter of a function of a tile's rows."""

    function: Callable[..., Mapping[str, ArrayLike]]

    def __call__(self, here: StageInputs, **settings: Any) -> Made:
        table = Table(self.function(here.rows(), **settings))
        codes, counts = np.unique(table["classification"], return_counts=True)
        return table, {"codes": {str(c): int(n) for c, n in zip(codes, counts, strict=True)}, "filled": 0}


@dataclass(frozen=True)
class OfDelivery:
    """The adapter of a function that writes files of a tile."""

    function: Callable[..., object]

    def __call__(self, here: StageInputs, **settings: Any) -> Made:
        table = here.rows()
        self.function(table, here.directory, here.part, **settings)
        return {"rows": table.rows}


@dataclass(frozen=True)
class OfChunk:
    """The adapter of a function over a chunk."""

    function: Callable[..., Mapping[str, ArrayLike]]

    def __call__(self, here: StageInputs, **settings: Any) -> Table:
        return Table(self.function(here.chunk(), **settings))


_ADAPTERS = (OfChunk, OfBlock, OfRows, OfDelivery)


@dataclass(frozen=True)
class FunctionOfFile:
    """A function of a user's file, by name: workers import the file, and refuse it if it is not the one of `digest`."""

    path: str
    digest: str
    name: str

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        target: Any = _module(Path(self.path), self.digest)
        for part in self.name.split("."):
            target = getattr(target, part)
        return target(*arguments, **named)


def own_workflow(path: Path) -> Workflow:
    """The `workflow` of a user's file, whose own functions travel by file and name.

    Raises
    ------
    ConfigError : no such file, it cannot be imported, or it has no `workflow`.
    """
    where = path.resolve()
    try:
        digest = hashlib.sha256(where.read_bytes()).hexdigest()
    except OSError as fault:
        raise ConfigError(
            "the workflow's file cannot be read",
            where="--workflow",
            got=f"{path}: {fault.strerror}",
            do="name a Python file, or one of the workflows that `fwclass run --help` lists",
        ) from fault
    try:
        module = _module(where, digest)
    except Exception as fault:
        raise ConfigError(
            "the workflow's file cannot be imported", where=path, got=f"{type(fault).__name__}: {fault}", do="mend it"
        ) from fault
    workflow = getattr(module, "workflow", None)
    if not isinstance(workflow, Workflow):
        raise ConfigError(
            "the file has no workflow",
            where=path,
            expected="workflow = Workflow(...), as docs/extending.md shows",
            got="nothing of that name" if workflow is None else type(workflow).__name__,
        )
    workflow.check(path)
    stages = tuple(_by_file(stage, str(where), digest, module.__name__) for stage in workflow.stages)
    return replace(workflow, stages=stages)


def _by_file(stage: Stage, path: str, digest: str, module: str) -> Stage:
    """`stage` with its function named by file where it is the file's own; the file's digest enters the key."""
    adapter = type(stage.function) if isinstance(stage.function, _ADAPTERS) else None
    inner: Any = stage.function.function if isinstance(stage.function, _ADAPTERS) else stage.function
    if getattr(inner, "__module__", None) != module:
        return stage
    named = FunctionOfFile(path, digest, inner.__qualname__)
    given = stage.arguments

    def arguments(plan: Plan) -> Mapping[str, Any]:
        return {**given(plan), "code": digest[:16]}

    work = adapter(named) if adapter is not None else named
    return replace(stage, function=_WithoutCode(work), arguments=arguments)


@dataclass(frozen=True)
class _WithoutCode:
    """Takes the file's digest, which is for the key alone, from the arguments."""

    function: Callable[..., Any]

    def __call__(self, here: StageInputs, code: str, **arguments: Any) -> Any:
        return self.function(here, **arguments)


def _module(path: Path, digest: str) -> ModuleType:
    """The module of a file with these bytes, imported once in a process."""
    name = _PREFIX + digest[:16]
    if name in sys.modules:
        return sys.modules[name]
    if hashlib.sha256(path.read_bytes()).hexdigest() != digest:
        raise StoreError(
            "the workflow's file was changed while the run was under way", where=path, do="run the same again"
        )
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ConfigError("this is no Python file", where=path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
