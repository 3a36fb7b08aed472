"""A trained model put where the user wants it, whole or not at all."""

from __future__ import annotations

import json
import os
import shutil
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fwclass.errors import ConfigError
from fwclass.model import Model
from fwclass.store.atomic import files_below, sync
from fwclass.store.model_rows import ModelRows, rows_facts, save_rows
from fwclass.store.models import CARD, load_model, save_model
from fwclass.temporary import temporary_directory


def check_target(target: Path, overwrite: bool) -> None:
    """`ConfigError` if no model may be written to `target`."""
    parent = next(p for p in target.absolute().parents if p.exists())
    if not parent.is_dir() or not os.access(parent, os.W_OK):
        raise ConfigError(
            "the model's directory cannot be made",
            where=target,
            expected="a directory that may be written to",
            got=parent,
            do="choose another place",
        )
    if not target.exists():
        return
    if not target.is_dir() or (any(target.iterdir()) and not (target / CARD).is_file()):
        raise ConfigError(
            "something else than a model is there", where=target, do="choose another name; it is not replaced"
        )
    if not overwrite:
        raise ConfigError("the model exists", where=target, do="choose another name, or add --overwrite")


def write_model(model: Model, target: Path, overwrite: bool, rows: ModelRows | None = None) -> None:
    """Write a model that lies nowhere yet to `target`, as `copy_model` does."""
    with temporary_directory("model") as place:
        save_model(place / "model", model)
        copy_model(place / "model", target, overwrite, None, rows)


def copy_model(
    source: Path,
    target: Path,
    overwrite: bool,
    measured: Mapping[str, Any] | None = None,
    rows: ModelRows | None = None,
) -> None:
    """Copy the model in `source` to `target`: written beside, flushed, checked, renamed. How good it was `measured`
    elsewhere is added to its card, and so are `rows` that it has learned from."""
    check_target(target, overwrite)
    target.parent.mkdir(parents=True, exist_ok=True)
    beside = target.with_name(f".{target.name}.{uuid.uuid4().hex}")
    old = target.with_name(f".{target.name}.{uuid.uuid4().hex}")
    try:
        shutil.copytree(source, beside, copy_function=shutil.copyfile)  # a run's own is read-only
        facts = {"measured": measured} if measured is not None else {}
        if rows is not None:
            save_rows(beside, rows)
            facts |= rows_facts(rows)
        if facts:
            card = {**json.loads((beside / CARD).read_text(encoding="utf-8")), **facts}
            (beside / CARD).write_text(json.dumps(card, sort_keys=True, indent=1) + "\n", encoding="utf-8")
        for path in files_below(beside):
            sync(path)
        load_model(beside)
        check_target(target, overwrite)  # another command may have put one there meanwhile
        if overwrite and target.exists():
            target.rename(old)
        try:
            beside.rename(target)
        except OSError:
            check_target(target, overwrite)
            raise
        sync(target.parent)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
        if old.exists() and target.exists():
            shutil.rmtree(old, ignore_errors=True)
