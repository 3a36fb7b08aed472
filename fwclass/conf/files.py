"""Configuration files: where they are, how they are read, and how one is laid over another."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from fwclass.errors import ConfigError, nearest
from fwclass.redact import redacted_setting

_SIZE_LIMIT = 1 << 20


def conf_directory() -> Path:
    """The `conf` directory: beside the package in a checkout, inside it when installed."""
    here = Path(__file__).resolve().parents[1]
    installed = here / "_conf"
    return installed if installed.is_dir() else here.parent / "conf"


def find(name: str | Path) -> Path:
    """A configuration by path, or by the name of one that comes with fwclass."""
    path = Path(name)
    if path.is_file():
        return path
    shipped = conf_directory() / "surveys"
    by_name = shipped / f"{path.stem}.yaml"
    if path.parent in (Path(), Path("conf/surveys")) and by_name.is_file():
        return by_name
    known = [p.stem for p in shipped.glob("*.yaml")]
    raise ConfigError(
        "no such configuration",
        where=path,
        expected="a YAML file, or the name of one that comes with fwclass",
        got=nearest(path.stem, known),
        do="give its path",
    )


class _Loader(yaml.SafeLoader):
    """Safe loading that refuses a key given twice (plain YAML keeps the last one silently)."""


def _mapping(loader: _Loader, node: yaml.MappingNode) -> dict[Any, Any]:
    keys = [loader.construct_object(k, deep=True) for k, _ in node.value]
    twice = {str(k) for k in keys if keys.count(k) > 1}
    if twice:
        raise yaml.constructor.ConstructorError(
            None, None, f"key given twice: {', '.join(sorted(twice))}", node.start_mark
        )
    return {k: loader.construct_object(v, deep=True) for k, (_, v) in zip(keys, node.value, strict=True)}


_Loader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _mapping)


def read(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > _SIZE_LIMIT:
            raise ConfigError("a configuration this large is not one", where=path, got=f"{path.stat().st_size} bytes")
        value = yaml.load(path.read_text(encoding="utf-8"), Loader=_Loader)  # noqa: S506 - a SafeLoader
    except (OSError, yaml.YAMLError, UnicodeDecodeError) as fault:
        told = _told(fault, path.name)
        tabs = "indent with spaces: YAML knows no tabs" if "\\t" in told else "mend the YAML at the place named"
        raise ConfigError("a configuration cannot be read", where=path, got=told, do=tabs) from fault
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise ConfigError("a configuration is a mapping of sections", where=path, got=type(value).__name__)
    return value


def _told(fault: Exception, name: str) -> str:
    """What is wrong and where; the lines themselves, which the fault's own text quotes, may hold a secret."""
    if not isinstance(fault, yaml.MarkedYAMLError):
        return " ".join(str(fault).split()).replace('"<unicode string>"', name)
    mark = fault.problem_mark or fault.context_mark
    place = f" in {name}, line {mark.line + 1}, column {mark.column + 1}" if mark else ""
    return ", ".join(text for text in (fault.context, fault.problem) if text) + place


def merged(base: Any, change: Any) -> Any:
    """`change` laid over `base`: mappings merge, everything else is replaced."""
    if isinstance(base, dict) and isinstance(change, dict):
        return {k: merged(base.get(k), change[k]) if k in change else base[k] for k in {**base, **change}}
    return change


def setting(text: str) -> dict[str, Any]:
    """``ground.slope=0.2`` as a nested mapping."""
    path, equals, value = text.partition("=")
    names = path.strip().split(".")
    if not equals or len(names) < 2 or not all(names):
        raise ConfigError(
            "--set wants section.key=value",
            where="--set",
            expected="for example ground.slope=0.2",
            got=redacted_setting(text),
        )
    try:
        result: Any = yaml.safe_load(value)
    except yaml.YAMLError as fault:
        told = _told(fault, "the value")
        raise ConfigError(
            "the value of --set cannot be read", where=f"--set {redacted_setting(text)}", got=told
        ) from fault
    for name in reversed(names):
        result = {name: result}
    return dict(result)
