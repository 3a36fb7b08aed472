"""A forest on disk: `.npy` arrays and `card.json`. Loading runs no code and checks everything it reads."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.model import Forest

_ARRAYS = {"feature": "uint16", "threshold": "float32", "child": "uint32", "offsets": "int64"}
_CARD_LIMIT = 1 << 24


def save_forest(directory: Path, forest: Forest) -> None:
    directory.mkdir(parents=True, exist_ok=True)
    for name in _ARRAYS:
        np.save(directory / f"{name}.npy", getattr(forest, name), allow_pickle=False)
    text = json.dumps(dict(forest.card), sort_keys=True, indent=1, allow_nan=False)
    (directory / "card.json").write_text(text + "\n", encoding="utf-8")


def load_forest(directory: Path) -> Forest:
    """The forest in `directory`, or an `InputError` that says what is wrong with it."""
    try:
        path = directory / "card.json"
        if path.stat().st_size > _CARD_LIMIT:
            raise ValueError(f"card.json has {path.stat().st_size} bytes")
        card = json.loads(path.read_text(encoding="utf-8"))
        arrays = {name: _array(directory / f"{name}.npy", kind) for name, kind in _ARRAYS.items()}
        forest = Forest(**arrays, card=card)
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as fault:
        raise InputError(
            "this is not a model of fwclass, or it is damaged",
            where=directory,
            expected="card.json and " + ", ".join(f"{n}.npy" for n in _ARRAYS),
            got=f"{type(fault).__name__}: {fault}",
            do="train again, or copy the whole model directory",
        ) from fault
    forest.check(directory)
    return forest


def _array(path: Path, kind: str) -> NDArray:
    """One array; memory-mapped first, so that a header cannot make us allocate more than the file holds."""
    try:
        array = np.array(np.load(path, mmap_mode="r", allow_pickle=False))
    except Exception as fault:  # numpy's header parser lets through whatever Python's tokenizer raises
        raise ValueError(f"{path.name}: {fault}") from fault
    if array.dtype != np.dtype(kind) or array.ndim != 1:
        raise ValueError(f"{path.name} is {array.dtype} of {array.ndim} dimensions, expected {kind} of one")
    return array
