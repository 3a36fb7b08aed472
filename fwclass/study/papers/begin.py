"""What the papers' workflows check and prepare before they run."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from fwclass.conf import Config
from fwclass.errors import ConfigError
from fwclass.schema import base_of


def require_whole(config: Config, tiles: object | None, workflow: str) -> None:
    """`ConfigError` where the figures of a paper cannot be made."""
    if tiles is not None:
        raise ConfigError(
            f"--workflow {workflow} tells figures of the whole survey", where="--tiles", do="leave --tiles out"
        )
    if config.survey.model is not None:
        raise ConfigError(
            f"--workflow {workflow} trains its own models", where=f"{config.path}: survey.model", do="set it to null"
        )
    _require_further(config)


def _require_further(config: Config) -> None:
    """`ConfigError` where `papers.more_classes` names, or counts codes of, a class that is there already."""
    classes = (*config.survey.classes, *config.papers.more_classes)
    fields: tuple[tuple[str, list[Any]], ...] = (
        ("name", [c.name for c in classes]),
        ("code", [c.code for c in classes]),
        ("reference code", [code for c in classes for code in c.codes]),
    )
    for what, values in fields:
        twice = sorted({str(v) for v in values if values.count(v) > 1})
        if twice:
            raise ConfigError(
                f"a class {what} is given twice",
                where=f"{config.path}: survey.classes, papers.more_classes",
                got=", ".join(twice),
                do="list in papers.more_classes only what survey.classes lacks",
            )


def features_like(config: Config, bases: Iterable[str]) -> tuple[str, ...]:
    """The survey's features, and those that it computes besides, that a paper has too, in the paper's order."""
    columns = tuple(dict.fromkeys((*config.features_asked, *config.features.also)))
    names = tuple(n for b in bases for n in columns if base_of(n) == b)
    if len(names) < 2:
        raise ConfigError(
            "the survey has too few features of the paper",
            where=f"{config.path}: survey.features",
            expected=", ".join(bases),
            got=", ".join(columns),
        )
    return names
