"""The configuration of a command that runs, or looks at, a survey: with boxes for areas that are named by files."""

from __future__ import annotations

import shlex
from pathlib import Path

from fwclass import conf
from fwclass.conf import Config
from fwclass.errors import ConfigError
from fwclass.operate.request import Request
from fwclass.store.url import is_url


def configured(name: str | Path, settings: tuple[str, ...] = (), classifies: bool = True) -> Config:
    """`conf.load`, and of what `classifies` the areas as boxes (`survey.area_files`)."""
    config = conf.load(name, settings, classifies)
    if not classifies or (config.areas.train_by is None and config.areas.test_by is None):
        return config
    from fwclass.survey.area_files import with_areas  # opens files: slow to load

    return with_areas(config)


def configured_as_kept(request: Request, classifies: bool, settings: tuple[str, ...] = ()) -> Config:
    """The configuration of a run by the words that its directory keeps, and by the user's own `settings`.

    `ConfigError` where the kept words of a directory on this host lead to object storage: nobody may have read them.
    Who names a run in a bucket goes there anyway.
    """
    config = configured(request.conf, (*request.settings, *settings), classifies)
    for key in ("directory", "model", "base_model"):
        value = getattr(config.survey, key)
        own = any(setting.strip().startswith(f"survey.{key}=") for setting in settings)
        if value is not None and is_url(value) and not own and not is_url(request.root):
            raise ConfigError(
                "the words that this run directory keeps lead to object storage",
                where=f"{request.root}: survey.{key}",
                expected="addresses that you name yourself",
                got=value,
                do=f"if you trust it: fwclass status CONF --out {shlex.quote(request.root)} (for seams: --set "
                f"survey.{key}=ADDRESS)",
            )
    return config
