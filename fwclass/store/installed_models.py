"""Models that have a name: those of the package `fwclass_models`, and of the directory that a variable names."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path

from fwclass.store.models import CARD

PACKAGE, VARIABLE = "fwclass_models", "FWCLASS_MODELS"


def installed_models() -> dict[str, Path]:
    """Directory of every model that has a name; those of the directory that `VARIABLE` names go before the package's.
    The package is looked up and never imported."""
    spec = importlib.util.find_spec(PACKAGE)
    directories = [Path(p) for p in (spec.submodule_search_locations or ())] if spec else []
    if named := os.environ.get(VARIABLE):
        directories.append(Path(named).absolute())
    models: dict[str, Path] = {}
    for directory in directories:
        if (directory / CARD).is_file():  # a model itself
            models[directory.name] = directory
        elif directory.is_dir():
            models |= {d.name: d for d in sorted(directory.iterdir()) if (d / CARD).is_file()}
    return models


def model_location(named: Path | str, beside: Path = Path()) -> Path:
    """The directory of a model, by path below `beside`, or by name where there is no such path."""
    path = beside / named
    alone = Path(named).parent == Path() and not path.exists()
    return installed_models().get(str(named), path) if alone else path
