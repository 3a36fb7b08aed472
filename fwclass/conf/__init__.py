"""Configuration: `conf/base.yaml` holds every number once, a survey's file changes what it needs.

Everything is checked before anything runs; an unknown key is an error that names the nearest known one.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, get_args, get_origin

from pydantic import BaseModel, ValidationError

from fwclass.conf.checks import CHECKS, check_learning
from fwclass.conf.files import conf_directory, find, merge, plain, read, setting
from fwclass.conf.model import PARAMS, Config
from fwclass.conf.schedule import SECRET
from fwclass.errors import ConfigError, nearest
from fwclass.redact import redacted_setting

IDLE = {"adapt", "plan", "profile", "run", "seams", "store", "street", "street_scene", "suggest", "view", "voxels"}
"""Sections of which a run's delivery shows nothing."""

NAMED = 20
"""Faults of a configuration that a message tells."""

__all__ = [
    "Config",
    "build",
    "by_dotted_key",
    "checked",
    "conf_directory",
    "find",
    "load",
    "load_text",
    "own_settings",
    "preset",
    "presets",
    "section",
]


def load(name: str | Path, settings: tuple[str, ...] = (), classifies: bool = True) -> Config:
    """The configuration `name` over `conf/base.yaml`, with `settings` (``section.key=value``) over both.

    Where one of them names a ``ground.preset``, that lies between `conf/base.yaml` and the others. Unless it
    `classifies`, classes, labels and training areas may be missing.
    """
    path = find(name)
    change = read(path)
    for text in settings:
        change = merge(change, setting(text))
    raw = _lay_over(change)
    return build(path, raw, _origin(path, settings), classifies)


def load_text(text: str, path: Path, classifies: bool = True) -> Config:
    """As `load`, of a text that is to stand at `path`."""
    return build(path, _lay_over(plain(text)), classifies=classifies)


def section(name: str, settings: tuple[str, ...] = (), change: Mapping[str, Any] | None = None) -> Any:
    """The params of one section as `conf/base.yaml` has them (single-file commands).

    `settings` (``section.key=value``) go before the base, and `change` (nested mappings by section) before both.
    """
    path = conf_directory() / "base.yaml"
    changes: dict[str, Any] = {}
    for text in settings:
        changes = merge(changes, setting(text))
    raw = _lay_over(merge(changes, dict(change or {})), name)
    where = " ".join(f"--set {redacted_setting(text)}" for text in settings) or path
    return _build(name, raw.get(name), where)


def own_settings(config: Config) -> dict[str, str]:
    """What a configuration sets otherwise than `conf/base.yaml` and a delivery may show, by dotted keys, as text."""
    base = by_dotted_key(read(conf_directory() / "base.yaml"))
    flat = by_dotted_key({name: value for name, value in config.raw.items() if name not in IDLE})
    flat["survey.features"] = list(config.features_asked)
    return {key: str(value) for key, value in flat.items() if key not in base or base[key] != value}


def by_dotted_key(sections: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Nested settings by dotted keys."""
    flat: dict[str, Any] = {}
    for key, value in sections.items():
        flat |= by_dotted_key(value, f"{before}{key}.") if isinstance(value, Mapping) else {f"{before}{key}": value}
    return flat


def check_settings(
    settings: Iterable[str], sections: Iterable[str], do: str = "leave it out, or use `fwclass run`"
) -> None:
    """`ConfigError` for a setting of a section that the command does not look at; `do` is what to do instead."""
    for text in settings:
        if text.split(".")[0].strip() not in sections:
            raise ConfigError(
                "this setting has no effect here",
                where=f"--set {text}",
                expected=f"a key of {', '.join(sections)}",
                got=text.split("=")[0],
                do=do,
            )


def _origin(path: Path, settings: tuple[str, ...]) -> str:
    """Where a configuration comes from, for messages."""
    return " --set ".join([f"{path} with" if settings else str(path), *map(redacted_setting, settings)])


def _lay_over(change: dict[str, Any], section: str | None = None) -> dict[str, Any]:
    """`change` over `conf/base.yaml`, or a `section` of it, with the ground preset that it names between them."""
    base = read(conf_directory() / "base.yaml", section)
    ground = change.get("ground")
    name = ground.get("preset") if isinstance(ground, dict) else None
    if name is not None:
        own = {key: value for key, value in preset(str(name)).items() if key != "about"}
        base = merge(base, {"ground": own})
    return dict(merge(base, change))


def presets() -> dict[str, dict[str, Any]]:
    """What every preset of the ground filters changes, by name; ``about`` says what it is for."""
    return read(conf_directory() / "presets" / "ground.yaml")


def preset(name: str) -> dict[str, Any]:
    """One of `presets`."""
    shipped = presets()
    if name not in shipped:
        raise ConfigError(
            "no such preset", where="ground.preset", expected=", ".join(shipped), got=name, do=nearest(name, shipped)
        )
    return shipped[name]


def build(path: Path, raw: dict[str, Any], where: str = "", classifies: bool = True) -> Config:
    """A checked configuration; `where` names its origin in messages, `classifies` as for `load`."""
    where = where or str(path)
    faults = [
        ConfigError(f"unknown section {name!r}", where=where, got=name, do=nearest(str(name), PARAMS))
        for name in raw
        if name not in PARAMS
    ]
    values: dict[str, Any] = {}
    for name in PARAMS:
        simulated = "survey" in values and values["survey"].simulated and values["survey"].directory is None
        if name != "simulate" or simulated:
            try:
                values[name] = _build(name, raw.get(name), where)
            except ConfigError as fault:
                faults.append(fault)
    _raise(faults, where)
    sections = {name: value for name, value in raw.items() if name != "schedule"}  # it may hold secrets
    config = Config(path=path, raw=sections, simulate=values.pop("simulate", None), **values)
    checks = (*CHECKS, check_learning) if classifies else CHECKS
    _raise([fault for check in checks for fault in _faults(partial(check, config))], where)
    return config


def _faults(look: Callable[[], object]) -> list[ConfigError]:
    try:
        look()
    except ConfigError as fault:
        return [fault]
    return []


def _raise(faults: Sequence[ConfigError], where: object) -> None:
    """The one fault as it is, or all of several together, so that a file is mended once."""
    if len(faults) == 1:
        raise faults[0]
    if faults:
        lines = [f"{k}. {f.what}: {f.got or ''} {f.do or ''}".strip(" :") for k, f in enumerate(faults[:NAMED], 1)]
        more = [f"and {len(faults) - NAMED} more"] if len(faults) > NAMED else []
        raise ConfigError(f"the configuration has {len(faults)} faults", where=where, got="; ".join(lines + more))


def checked(name: str, value: Any, where: object) -> Any:
    """The params of a section from plain data; `where` names its origin in messages."""
    return _build(name, value, where)


def _build(name: str, value: Any, path: object) -> Any:
    if value is None:
        raise ConfigError(f"section {name!r} is missing", where=path, do=f"add `{name}:`")
    model = PARAMS[name]
    if name == "ground" and isinstance(value, dict):
        value = {key: v for key, v in value.items() if key != "preset"}  # laid under the other keys already
    try:
        return model.model_validate(value)
    except ValidationError as fault:
        raise ConfigError(
            f"section {name!r} is wrong",
            where=path,
            got="; ".join(_explain(name, model, e) for e in _apart(fault.errors())[:5]),
        ) from fault


def _apart(errors: Sequence[Any]) -> list[Any]:
    """`errors` without "too short" of a list whose entries are wrong: pydantic counts only the good ones."""
    within = {e["loc"][:k] for e in errors for k in range(len(e["loc"]))}
    return [e for e in errors if not (e["type"] == "too_short" and e["loc"] in within)]


def _explain(name: str, model: type[BaseModel], error: Any) -> str:
    key = ".".join([name, *(str(p).removesuffix("_by") for p in error["loc"])])
    if error["type"] == "extra_forbidden":
        fields = _keys_at(model, error["loc"][:-1])
        return f"unknown key {key} ({nearest(str(error['loc'][-1]), fields)})" if fields else f"unknown key {key}"
    if error["type"] == "missing":
        return f"{key} is missing"
    if error["type"] == "value_error" and isinstance(error["input"], Mapping):
        return f"{key}: {error['msg'].removeprefix('Value error, ')}"  # several keys that do not fit one another
    if error["type"] == "too_long":
        return f"{key}: at most {error['ctx']['max_length']:,} are wanted (got {error['ctx']['actual_length']:,})"
    if error["type"] == "string_too_long":
        return f"{key}: at most {error['ctx']['max_length']:,} letters are wanted (got {len(error['input']):,})"
    kind = "" if error["type"] in _RULES else error["type"].split("_")[0]
    wanted = _RULES.get(error["type"]) or _WANTED.get(kind, error["msg"].removeprefix("Value error, "))
    if name == "schedule" and error["loc"] and error["loc"][0] in SECRET:
        return f"{key}: {wanted}"
    return f"{key}: {wanted} (got {str(error['input'])[:80]!r})"


def _keys_at(model: type[BaseModel], loc: Iterable[int | str]) -> Collection[str]:
    """Keys of the mapping at `loc`, from the keys and places in lists that lead there; none where any key will do."""
    of_any_key = False
    for step in loc:
        if of_any_key or isinstance(step, int):
            of_any_key = False
            continue
        kind = model.model_fields[step].annotation if step in model.model_fields else None
        inner = [t for t in (kind, *get_args(kind)) if isinstance(t, type) and issubclass(t, BaseModel)]
        if not inner:
            return ()
        model, of_any_key = inner[0], get_origin(kind) in (dict, Mapping)
    return () if of_any_key else model.model_fields


_RULES = {
    "too_short": "at least one is wanted",
    "string_too_short": "a text that is not empty is wanted",
    "string_unicode": "a text is wanted that can be written as UTF-8",
    "string_pattern_mismatch": "a name of letters and digits is wanted, with no more than `_`, `-` and `.` in it",
}
"""What to say where the kind is right and the value is not."""

_WANTED = {
    "tuple": "a list is wanted, as in [a, b]",
    "model": "keys with values are wanted, as in `key: value`",
    "dict": "keys with values are wanted, as in `key: value`",
    "string": "a text is wanted; put it in quotes if YAML takes it for something else",
    "float": "a number is wanted",
    "int": "a whole number is wanted",
    "bool": "true or false is wanted",
}
"""What to say for pydantic's kinds of error."""
