"""The configuration of a command that runs, or looks at, a survey: with boxes for areas that are named by files."""

from __future__ import annotations

from pathlib import Path

from fwclass import conf
from fwclass.conf import Config


def configured(name: str | Path, settings: tuple[str, ...] = (), classifies: bool = True) -> Config:
    """`conf.load`, and of what `classifies` the areas as boxes (`survey.area_files`)."""
    config = conf.load(name, settings, classifies)
    if not classifies or (config.areas.train_by is None and config.areas.test_by is None):
        return config
    from fwclass.survey.area_files import with_areas  # opens files: slow to load

    return with_areas(config)
