"""One file of waveforms as a survey of its own, for workflows that classify nothing."""

from __future__ import annotations

import glob
import json
from pathlib import Path
from typing import Any

from fwclass.errors import ConfigError
from fwclass.read.projection import to_project
from fwclass.read.source import open_source
from fwclass.store.atomic import write_text
from fwclass.store.url import Url
from fwclass.survey.systems import given_crs


def survey_of(source: Path, out: Any) -> tuple[Path, Any]:
    """The configuration that `source` is, or that is written for it, and the run directory.

    A file that is no configuration becomes a survey of one source; its configuration lies in the run directory.
    """
    if _is_configuration(source):
        from fwclass import conf as configuration

        name = configuration.load(source, (), classifies=False).survey.name
        return source, out if out is not None else Path("runs") / f"{name}-backscatter"
    root = out if out is not None else Path("runs") / f"{_name(source)}-backscatter"
    if isinstance(root, Url):
        raise ConfigError(
            "one file goes to a directory of this host",
            where="--out",
            got=root,
            do="write a configuration for the survey, and give that",
        )
    root.mkdir(parents=True, exist_ok=True)
    path = root / "survey.yaml"
    text = _text(source.resolve())
    if not path.exists() or path.read_text() != text:
        write_text(path, text)
    return path, root


def system_settings(source: Path, crs: str) -> tuple[str, ...]:
    """What `crs`, named for a survey or one file, is in the configuration: a file in degrees, or geocentric, is brought
    into it."""
    settings = (f"survey.crs={json.dumps(crs)}",)
    if _is_configuration(source) or not to_project(open_source(source), given_crs(crs, "--crs")):
        return settings
    return (*settings, f"read.project_to={json.dumps(crs)}")


def _is_configuration(source: Path) -> bool:
    return source.suffix.lower() in (".yaml", ".yml", "") or not source.is_file()


def _name(source: Path) -> str:
    name = "".join(c if c.isalnum() or c in " _.-" else "_" for c in source.stem)[:80].strip(" .-")
    return name if name and (name[0].isalnum() or name[0] == "_") else f"_{name}"


def _text(source: Path) -> str:
    return f"""# Written by fwclass for one file; nothing is classified.
survey:
  name: {json.dumps(_name(source))}
  directory: {json.dumps(str(source.parent))}
  sources: [{json.dumps(glob.escape(source.name))}]
"""
