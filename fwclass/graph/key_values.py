"""Arguments of a stage as the plain data that its key is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

from fwclass.conf.sections import Section
from fwclass.grid import Box, Tile
from fwclass.params import Params


def plain_values(values: Mapping[str, Any], silent: frozenset[str] = frozenset()) -> dict[str, Any]:
    """Arguments as plain data for a key, those named `params` (a section of the configuration) field by field.

    `silent`: names of arguments, and of fields of sections among them, that are left out.

    `TypeError` for one that has no plain form: what is used is in the key.
    """
    result: dict[str, Any] = {}
    for name, value in values.items():
        if name in silent:
            continue
        plain = _plain(value, silent)
        result = merge_disjoint(result, plain if name == "params" else {name: plain})
    return result


def merge_disjoint(values: dict[str, Any], others: dict[str, Any]) -> dict[str, Any]:
    """Both together; `TypeError` where one would hide a value of the other from the key."""
    both = values.keys() & others.keys()
    if both:
        raise TypeError(f"two arguments of a stage enter its key as {', '.join(sorted(both))}: give one another name")
    return {**values, **others}


def _plain(value: Any, silent: frozenset[str] = frozenset()) -> Any:
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, (Params, Section)):
        return value.model_dump(mode="json", exclude=set(silent) & set(type(value).model_fields))
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, (Box, Tile)):
        return list(value.bounds) if isinstance(value, Box) else value.key
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value))
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (tuple, list)):
        return [_plain(v) for v in value]
    raise TypeError(f"{type(value).__name__} cannot enter a key: give a stage plain data, or a section of settings")
