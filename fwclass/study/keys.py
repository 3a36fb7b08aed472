"""What the parts of a study need, and what enters their keys: their tasks are made one by one, of no stage's record."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from fwclass.conf import Config
from fwclass.run.part import Name


def plain(params: Any) -> Any:
    """Params as plain data for a key."""
    return params.model_dump(mode="json")


def plain_classes(config: Config) -> list[dict[str, Any]]:
    """The survey's classes as plain data for a key; `legacy_code` decides nothing of what is learned."""
    return [{**c.model_dump(mode="json"), "legacy_code": None} for c in config.survey.classes]


def needs_of(columns: Mapping[str, str], parts: Iterable[str]) -> tuple[Name, ...]:
    """The parts that hold `columns` (stage by column) of the tiles `parts`, and the tiles themselves."""
    return tuple((stage, part) for part in parts for stage in sorted({*columns.values(), "tile"}))
