"""Scanners that come with fwclass."""

from __future__ import annotations

from pydantic import ValidationError

from fwclass.conf.files import conf_directory, read
from fwclass.errors import ConfigError, nearest
from fwclass.street.params import ScannerParams


def scanner(name: str) -> ScannerParams:
    """The data sheet of a scanner, by name; `ConfigError` for one that is not there."""
    names = sorted(p.stem for p in (conf_directory() / "street").glob("*.yaml"))
    if name not in names:
        raise ConfigError(
            "no such scanner", where="street.scanner", expected=", ".join(names), got=name, do=nearest(name, names)
        )
    try:
        return ScannerParams.model_validate(read(conf_directory() / "street" / f"{name}.yaml"))
    except ValidationError as fault:
        raise ConfigError("the scanner's file is wrong", where=name, got=str(fault)[:300]) from fault
