"""Stages of a user's own: one function over a chunk, a block or a tile, with what goes in and comes out checked."""

from __future__ import annotations

import math
import re
import stat
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fwclass.classes import ClassDef
from fwclass.classify.stage import CLASSIFY
from fwclass.errors import ConfigError, InputError
from fwclass.features.names import MAX_REACH
from fwclass.graph.classify import CLASSIFY_ECHOES
from fwclass.graph.ground import FILTER_GROUND, around_block, flags_of_block
from fwclass.graph.key_values import plain_values
from fwclass.graph.stage import Stage, always
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.ground.filters import Flags
from fwclass.schema import Column, Table, column

Function = Callable[..., Any]
Settings = Mapping[str, Any] | None

_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")


def chunk_stage(
    name: str,
    function: Callable[..., Mapping[str, ArrayLike]],
    reads: Iterable[str],
    writes: Iterable[Column],
    halo: float = 0.0,
    settings: Settings = None,
    version: int = 1,
) -> Stage:
    """A stage of one function over an overlapping chunk.

    Parameters
    ----------
    name : of the stage, in the store and in reports.
    function : ``function(chunk, **settings)`` gives for every column one value per core row, in the order of
        ``chunk.core``; `chunk` has the columns `reads`, the identity, x and y, of the tile and of its neighbours within
        `halo` [m], in canonical order. What it computes of an echo must follow from the echoes within `halo` of it.
    reads : columns of the program, its features among them, or of stages before.
    writes : the columns that it gives.
    settings : plain data; they enter the key of every part, as the bytes of the file do.
    version : raised where another library or file that the function uses makes it give something else.

    `ConfigError`: a name, a column, a halo or a setting that cannot be.
    """
    columns = tuple(writes) if not isinstance(writes, Column) else (writes,)
    wrong = [c for c in columns if not isinstance(c, Column)]
    if wrong or not columns:
        raise ConfigError(
            "a stage writes columns",
            where=f"stage {name}, writes",
            expected='[Column("name", "f4", "m", "what it means")]',
            got=wrong[0] if wrong else "none",
        )
    return Stage(
        _check_name(name),
        version,
        "tile",
        "echo",
        OfChunk(name, function),
        arguments=_constant(name, settings),
        reads=_column_names(name, reads),
        writes=tuple(c.name for c in columns),
        declares=columns,
        halo=_halo(name, halo),
        row_digests=True,
    )


def ground_filter_stage(
    function: Callable[..., tuple[ArrayLike, ArrayLike]], halo: float, settings: Settings = None, version: int = 1
) -> Stage:
    """A ground filter in the place of the program's (`Workflow.with_stage_instead`).

    ``function(table, **settings)`` gives two flags for every row, ground and noise; `table` has x, y, z, echo number,
    number of echoes and fit flags of a block of ``ground.block`` and what lies within `halo` [m] around it.
    """
    arguments = _constant(FILTER_GROUND.name, settings)
    return replace(
        FILTER_GROUND,
        version=version,
        function=OfBlock(FILTER_GROUND.name, function),
        arguments=lambda plan: {**arguments(plan), "block": plan.config.ground.block},
        halo=_halo(FILTER_GROUND.name, halo),
        after=(),
        needs=lambda plan, block: (),
    )


def classifier_stage(
    function: Callable[..., Mapping[str, ArrayLike]], reads: Iterable[str], settings: Settings = None, version: int = 1
) -> Stage:
    """A classifier in the place of the program's; what trains may be left out (`Workflow.without_training`).

    ``function(table, **settings)`` gives ``classification`` (codes of ``survey.classes``), ``confidence`` (0 to 1) and
    ``entropy`` for every row of a tile; `table` has the columns `reads`.
    """
    arguments = _constant(CLASSIFY.name, settings)
    return replace(
        CLASSIFY_ECHOES,
        version=version,
        function=OfRows(CLASSIFY.name, function),
        when=always,
        arguments=lambda plan: {**arguments(plan), "classes": plan.config.classes},
        keyed=lambda plan: {},
        own=_column_names(CLASSIFY.name, reads),
        writes=CLASSIFY.writes,
        after=(),
        needs=lambda plan, tile: (),
        source=lambda plan, tile: None,
    )


def delivery_stage(
    name: str, function: Callable[..., object], reads: Iterable[str], settings: Settings = None, version: int = 1
) -> Stage:
    """An output format more: ``function(table, directory, tile, **settings)`` writes files of a tile below `directory`,
    at the paths that they have in the delivery; `table` has the columns `reads`, `tile` is the tile's key, which the
    files' names must have in them."""
    return Stage(
        _check_name(name),
        version,
        "tile",
        "echo",
        OfDelivery(name, function),
        arguments=_constant(name, settings),
        own=_column_names(name, reads),
        place="deliver",
    )


@dataclass(frozen=True)
class Adapter:
    """What runs a user's function in a stage: `stage` names it in words."""

    stage: str
    function: Function

    def fault(self, what: str, expected: object, got: object, do: str) -> InputError:
        """The error of a function that does not keep what its stage declares."""
        return InputError(what, where=f"stage {self.stage}", expected=expected, got=got, do=do)

    def columns(self, values: Any, rows: int, names: tuple[str, ...]) -> Table:
        """What a function gave as a table; `InputError` for anything but one sound value per row and column.

        NaN and masked values are sound in floating columns whose record says so (`Column.null`).
        """
        if not isinstance(values, Mapping):
            kind = type(values).__name__
            raise self.fault("a stage's function gives columns", f"a dict of {', '.join(names)}", kind, "return a dict")
        if set(values) != set(names):
            got = ", ".join(map(str, values)) or "nothing"
            raise self.fault("a function gives other columns than its stage writes", ", ".join(names), got, "name them")
        return Table({n: self._check(n, v, rows) for n, v in values.items()})

    def _check(self, name: str, value: Any, rows: int) -> NDArray:
        values, none = np.asarray(np.ma.getdata(value)), column(name).null
        if values.shape != (rows,):
            raise self.fault(
                f"a function gives a wrong number of values of {name!r}",
                f"{rows:,}, one for every echo of the tile (chunk.core), not of the halo",
                f"shape {values.shape}",
                "return one value per row",
            )
        target = np.dtype(column(name).dtype)
        masked = np.ma.getmaskarray(value)
        if masked.any():
            if none is None:
                raise self._without_value(name, int(masked.sum()), "masked")
            values = np.where(masked, none, values)
        if values.dtype.kind not in "biuf":
            raise self.fault(f"{name!r} is no number", str(target), values.dtype, "return numbers")
        if target.kind in "ui":
            limits = np.iinfo(target)
            exact = np.isfinite(values) if values.dtype.kind == "f" else np.ones(rows, bool)
            exact &= (values >= limits.min) & (values <= limits.max)
            exact &= values == np.trunc(values) if values.dtype.kind == "f" else True
            if not exact.all():
                raise self.fault(
                    f"a value of {name!r} does not fit its column",
                    f"whole numbers, {limits.min} to {limits.max}",
                    values[~exact][0],
                    "give the column another dtype, or other values",
                )
        if target.kind == "b" and values.dtype.kind != "b":
            raise self.fault(f"{name!r} is no truth value", "bool", values.dtype, "return a bool array")
        with np.errstate(over="ignore"):
            fitting = values.astype(target)
        if target.kind == "f":
            missing = np.isnan(fitting)
            if missing.any() and (none is None or not math.isnan(none)):
                raise self._without_value(name, int(missing.sum()), "NaN")
            endless = np.isinf(fitting)
            if endless.any():
                raise self.fault(
                    f"a value of {name!r} does not fit its column",
                    f"finite numbers, up to {np.finfo(target).max:.3g}",
                    f"{values[endless][0]} and {int(endless.sum()) - 1:,} more",
                    "give the column another dtype, or other values",
                )
        return fitting

    def _without_value(self, name: str, count: int, kind: str) -> InputError:
        return self.fault(
            f"echoes have no value of {name!r}",
            "one for every echo",
            f"{count:,} {kind}",
            "give them one, or say that there may be none: Column(..., null=float('nan'))",
        )


@dataclass(frozen=True)
class OfChunk(Adapter):
    """The adapter of a function over a chunk."""

    def __call__(self, here: StageInputs, **settings: Any) -> Result:
        chunk = here.chunk()
        table = self.columns(self.function(chunk, **settings), len(chunk.core), here.writes)
        nulls = {n: column(n).null for n in table}
        counts = {
            n: np.isnan(v) if math.isnan(none) else v == none
            for n, v in table.items()
            if (none := nulls[n]) is not None
        }
        without = {n: int(of.sum()) for n, of in counts.items() if of.any()}
        return (table, {"without_value": without}) if without else table


@dataclass(frozen=True)
class OfRows(Adapter):
    """The adapter of a classifier of a tile's rows."""

    def __call__(self, here: StageInputs, classes: tuple[ClassDef, ...], **settings: Any) -> Result:
        rows = here.rows()
        table = self.columns(self.function(rows, **settings), rows.rows, CLASSIFY.writes)
        codes, counts = np.unique(table["classification"], return_counts=True)
        codes_of_classes = {c.code for c in classes}
        strange = [int(c) for c in codes if int(c) not in codes_of_classes]
        if strange:
            raise self.fault(
                "a class that the survey has not",
                sorted(codes_of_classes),
                strange,
                "give codes of survey.classes, or add it there",
            )
        for name, words in (("confidence", "a confidence is no share"), ("entropy", "an entropy is no share")):
            share = table[name]
            if not ((share >= 0.0) & (share <= 1.0)).all():
                raise self.fault(words, "0 to 1", f"{share.min():g} to {share.max():g}", "scale it")
        return table, {"codes": {str(c): int(n) for c, n in zip(codes, counts, strict=True)}, "filled": 0}


@dataclass(frozen=True)
class OfBlock(Adapter):
    """The adapter of a ground filter."""

    def __call__(self, here: StageInputs, block: float, **settings: Any) -> Result:
        around = around_block(here)
        answer = self.function(around.table, **settings)
        flags = [np.asarray(f) for f in answer] if isinstance(answer, (tuple, list)) else []
        if len(flags) != 2 or any(f.dtype != bool or f.shape != (around.table.rows,) for f in flags):
            raise self.fault(
                "a ground filter gives two flags for every row: ground, and noise",
                f"two bool arrays of {around.table.rows:,}",
                ", ".join(f"{f.dtype} {f.shape}" for f in flags) or type(answer).__name__,
                "return ground, noise",
            )
        return flags_of_block(around, Flags(*flags))


@dataclass(frozen=True)
class OfDelivery(Adapter):
    """The adapter of a function that writes files of a tile."""

    def __call__(self, here: StageInputs, **settings: Any) -> Result:
        table = here.rows()
        self.function(table, here.directory, here.part, **settings)
        paths = sorted(here.directory.rglob("*"))
        strange = [p for p in paths if not _is_own(p)]
        if strange:
            raise self.fault(
                "what a stage delivers are files of its own",
                "regular files and directories, no links: those of a delivery are made read-only and belong to it",
                strange[0].relative_to(here.directory).as_posix(),
                "copy the file",
            )
        names = [p.relative_to(here.directory).as_posix() for p in paths if p.is_file()]
        if not names:
            raise self.fault("nothing was written", "files below `directory`", "none", "write them there")
        for name in names:
            if here.part not in name or name.startswith(_PROGRAM):
                raise self.fault(
                    "a file of a tile has a name that another may have",
                    f"a path with the tile's key {here.part} in it, not in {', '.join(_PROGRAM)}",
                    name,
                    "choose a directory and names of its own",
                )
        return {"rows": table.rows}


def _is_own(path: Path) -> bool:
    """A directory, or a regular file that has no other name."""
    facts = path.lstat()
    return stat.S_ISDIR(facts.st_mode) or (stat.S_ISREG(facts.st_mode) and facts.st_nlink == 1)


_PROGRAM = (
    *("laz/", "parquet/", "rasters/", "model/", "report", "vectors/", "samples/", "stacked/"),
    *("store/", "generations/", "current/", "logs/", "survey/", "plan/"),
)
"""Where the program's own deliveries lie, and in a run directory what is no delivery."""


def _check_name(name: str) -> str:
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise ConfigError(
            "this cannot be the name of a stage",
            where="a stage's name",
            expected="small letters, digits and hyphens",
            got=repr(name),
        )
    return name


def _column_names(name: str, reads: Iterable[str]) -> tuple[str, ...]:
    if isinstance(reads, str):
        raise ConfigError(
            "the columns that a stage reads are a list",
            where=f"stage {name}, reads",
            expected=f'("{reads}",)',
            got=repr(reads),
        )
    return tuple(reads)


def _halo(name: str, halo: float) -> float:
    sound = isinstance(halo, (int, float)) and math.isfinite(halo) and 0.0 <= halo <= MAX_REACH
    if not sound:
        raise ConfigError(
            "this cannot be a halo",
            where=f"stage {name}, halo",
            expected=f"0 to {MAX_REACH:g} m: every tile reads its surroundings that far",
            got=halo,
        )
    return float(halo)


def _constant(name: str, settings: Settings) -> Callable[[Any], Mapping[str, Any]]:
    """The settings as a stage's arguments; `ConfigError` for one that cannot enter a key."""
    arguments = dict(settings or {})
    for key, value in arguments.items():
        try:
            plain = plain_values({"value": value})["value"]
            sound = isinstance(key, str) and key.isidentifier() and not _not_finite(plain)
        except TypeError:
            sound = False
        if not sound:
            raise ConfigError(
                "this cannot be a setting: it enters the key of every part",
                where=f"stage {name}, settings, {key!r}",
                expected="a name, and a text, a truth value, a finite number, or lists and dicts of these",
                got=f"{type(value).__name__} {value!r}"[:120],
            )
    return lambda plan: arguments


def _not_finite(value: Any) -> bool:
    if isinstance(value, Mapping):
        return any(_not_finite(v) for v in value.values())
    if isinstance(value, list):
        return any(_not_finite(v) for v in value)
    return isinstance(value, float) and not math.isfinite(value)
