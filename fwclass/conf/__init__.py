"""Configuration: `conf/base.yaml` holds every number once, a survey's file changes what it needs.

Everything is checked before anything runs; an unknown key is an error that names the nearest known one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from fwclass.conf.files import conf_directory, find, merge, plain, read, setting
from fwclass.conf.model import PARAMS, Config
from fwclass.conf.schedule import SECRET
from fwclass.errors import ConfigError, nearest
from fwclass.ground.params import MAX_HALO
from fwclass.ground.terrain.params import MOST_CELLS
from fwclass.ground.tuning_params import largest_halo
from fwclass.redact import redacted_setting

NAMED = 20
"""Faults of a configuration that a message tells."""

__all__ = ["Config", "build", "checked", "conf_directory", "find", "load", "load_text", "preset", "presets", "section"]


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


def load_text(text: str, path: Path) -> Config:
    """As `load`, of a text that is to stand at `path`."""
    return build(path, _lay_over(plain(text)))


def section(name: str, settings: tuple[str, ...] = (), change: Mapping[str, Any] | None = None) -> Any:
    """The params of one section as `conf/base.yaml` has them (single-file commands).

    `settings` (``section.key=value``) go before the base, and `change` (nested mappings by section) before both.
    """
    path = conf_directory() / "base.yaml"
    changes: dict[str, Any] = {}
    for text in settings:
        changes = merge(changes, setting(text))
    raw = _lay_over(merge(changes, dict(change or {})))
    return _build(name, raw.get(name), _origin(path, settings))


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


def _lay_over(change: dict[str, Any]) -> dict[str, Any]:
    """`change` over `conf/base.yaml`, with the ground preset that it names between them."""
    base = read(conf_directory() / "base.yaml")
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
    known = presets()
    if name not in known:
        raise ConfigError(
            "no such preset", where="ground.preset", expected=", ".join(known), got=name, do=nearest(name, known)
        )
    return known[name]


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
    _raise([*_faults(lambda: _check(config)), *(_faults(lambda: _check_learning(config)) if classifies else [])], where)
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
        fields = model.model_fields if len(error["loc"]) == 1 else {}
        return f"unknown key {key} ({nearest(str(error['loc'][-1]), fields)})" if fields else f"unknown key {key}"
    if error["type"] == "missing":
        return f"{key} is missing"
    if error["type"] == "value_error" and isinstance(error["input"], Mapping):
        return f"{key}: {error['msg'].removeprefix('Value error, ')}"  # several keys that do not fit one another
    if error["type"] == "too_long":
        return f"{key}: at most {error['ctx']['max_length']:,} are wanted (got {error['ctx']['actual_length']:,})"
    kind = "" if error["type"] in _RULES else error["type"].split("_")[0]
    wanted = _RULES.get(error["type"]) or _WANTED.get(kind, error["msg"].removeprefix("Value error, "))
    if name == "schedule" and error["loc"] and error["loc"][0] in SECRET:
        return f"{key}: {wanted}"
    return f"{key}: {wanted} (got {str(error['input'])[:80]!r})"


_RULES = {
    "too_short": "at least one is wanted",
    "string_too_short": "a text that is not empty is wanted",
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


def _check(config: Config) -> None:
    """What one section cannot see alone."""
    _ = config.features_asked  # a set is there and can be read
    where = config.path
    names = [c.name for c in config.survey.classes]
    used = [code for c in config.survey.classes for code in c.codes]
    codes = [c.code for c in config.survey.classes]
    groups: tuple[tuple[str, list[Any]], ...] = (("name", names), ("code", codes), ("reference code", used))
    for what, values in groups:
        twice = {v for v in values if values.count(v) > 1}
        if twice:
            raise ConfigError(f"a class {what} is given twice", where=f"{where}: survey.classes", got=sorted(twice))
    if not all(0 < c <= 255 for c in codes + used):
        raise ConfigError("class codes lie in 1 to 255", where=f"{where}: survey.classes", got=codes + used)
    if config.terrain.block > MOST_CELLS * config.publish.class_cell:
        raise ConfigError(
            "the cells of the class raster are too small",
            where=f"{where}: publish.class_cell",
            expected=f"at least {config.terrain.block / MOST_CELLS:g} m: {MOST_CELLS:,} in a block (terrain.block)",
            got=f"{config.publish.class_cell:g} m",
            do="make them larger, or the blocks smaller",
        )
    for which, cell in (("cell", config.quality.cell), ("planes.cell", config.quality.planes.cell)):
        if round(config.terrain.block * 1000) % max(1, round(cell * 1000)):
            raise ConfigError(
                "the cells of quality do not divide a block",
                where=f"{where}: quality.{which}",
                expected=f"a whole number of them in {config.terrain.block:g} m (terrain.block)",
                got=f"{cell:g} m",
                do="choose another edge, 2 or 4 m for example",
            )
    if config.ground.method == "auto" and (reach := largest_halo(config.ground, config.ground_auto)) > MAX_HALO:
        raise ConfigError(
            "the filter may read too far around a block",
            where=f"{where}: ground_auto",
            expected=f"at most {MAX_HALO:,.0f} m",
            got=f"{reach:,.0f} m",
            do="a smaller ground_auto.building_most, or candidates with smaller windows",
        )
    weights = config.train.class_weights
    weighted = weights if isinstance(weights, Mapping) else ()
    for key, called in (("classify.refine.between", config.classify.refine.between), ("train.class_weights", weighted)):
        for name in called:
            if name not in names:
                raise ConfigError(
                    f"no class is called {name!r}",
                    where=f"{where}: {key}",
                    expected=", ".join(names),
                    got=name,
                    do=nearest(name, names),
                )
    if config.stack.enabled and "water" in config.stack.surfaces and config.water.file is None:
        raise ConfigError(
            "weak echoes of water are looked for along the levels of its polygons, and there are none",
            where=f"{where}: stack.surfaces",
            expected="water.file: polygons of standing water",
            got="null",
            do="name a file in water.file, or leave water out of stack.surfaces",
        )
    if config.classify.refine.between and config.thin.rate < 1.0:
        raise ConfigError(
            "a thinned run has no second layer: the features at a boundary would be those of few echoes",
            where=f"{where}: classify.refine, thin.rate",
            got=f"thin.rate {config.thin.rate:g}",
            do="--set thin.rate=1, or --set classify.refine.between=[]",
        )
    if config.classify.context.cells:
        both = bool(config.classify.refine.between)
        if both or config.thin.rate < 1.0:
            raise ConfigError(
                "a layer that decides in context stands behind one first layer, of all echoes",
                where=f"{where}: classify.context, " + ("classify.refine" if both else "thin.rate"),
                got=f"refine.between {list(config.classify.refine.between)}"
                if both
                else f"thin.rate {config.thin.rate:g}",
                do="--set classify.context.cells=[], or without the other",
            )
    for kind in ("train", "test"):
        for box in getattr(config.areas, kind):
            if not all(map(math.isfinite, box)) or box[0] >= box[2] or box[1] >= box[3]:
                raise ConfigError(
                    "an area is [xmin, ymin, xmax, ymax] with min < max", where=f"{where}: areas.{kind}", got=box
                )


def _check_learning(config: Config) -> None:
    """By which classes echoes are classified, and by what they are learned: all that is missing at once."""
    survey, lacking = config.survey, []
    names = [c.name for c in survey.classes]
    if len(names) < 2 and (names or not (survey.model or survey.base_model)):  # a model knows its own
        lacking.append(f"at least two classes are needed (survey.classes has {', '.join(names) or 'none'})")
    if survey.model is not None and survey.base_model is not None:
        lacking.append("survey.model classifies as it is, and survey.base_model is learned from: one of them")
    if survey.base_model is not None and config.train.method != "forest":
        lacking.append(f"a forest learns from a base model's rows, and train.method is {config.train.method}")
    if survey.model is None:
        if survey.reference.kind == "none":
            kinds = "source, cloud, polygons, echoes or corrections"
            lacking.append(f"nothing to train on (survey.reference: {kinds}; or survey.model)")
        if not config.areas.train and config.areas.train_by is None and survey.reference.kind != "corrections":
            lacking.append("no training area (areas.train: at least one box [xmin, ymin, xmax, ymax])")
    if lacking:
        raise ConfigError(
            "; ".join(lacking),
            where=config.path,
            do="`fwclass init FILES` writes a configuration with all of them; `--workflow ground` needs none: it gives "
            "ground, terrain and heights",
        )
