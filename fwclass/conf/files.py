"""Configuration files: where they are, how they are read, and how one is laid over another."""

from __future__ import annotations

import os
import re
from collections import Counter
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from fwclass.errors import ConfigError, nearest
from fwclass.paths import open_regular
from fwclass.redact import redacted_setting

_SIZE_LIMIT = 1 << 18
"""Bytes of a file; `conf/base.yaml`, the longest there is, has an eighth of it."""

_MOST_VALUES = 100_000
"""Keys and values of a file, each counted as often as an alias repeats it."""

_MOST_DIGITS = 100
"""Of a whole number."""

_DEEPEST = 50
"""Levels of nested keys and lists."""

PUBLIC, VARIABLE = "data:", "FWCLASS_DATA"
"""What a directory of public data begins with, and the environment variable that names where all of it lies."""

_UNDER_WAY = (0, 0)


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
    names = [p.stem for p in shipped.glob("*.yaml")]
    raise ConfigError(
        "no such configuration",
        where=path,
        expected="a YAML file, or the name of one that comes with fwclass",
        got=nearest(path.stem, names),
        do="give its path",
    )


def public_data(named: str, where: Path, origin: str | None) -> Path:
    """The directory of public data that ``data:NAME`` names, below the one of the environment variable FWCLASS_DATA."""
    name, path = named.removeprefix(PUBLIC), os.environ.get(VARIABLE)
    if path:
        return Path(path).absolute() / name
    raise ConfigError(
        "the files of this survey do not come with fwclass",
        where=f"{where}: survey.directory",
        expected=origin or "public data",
        got=f"no environment variable {VARIABLE}",
        do=f"get the files, and --set survey.directory=DIR; or put them into DIR/{name}, and set {VARIABLE}=DIR",
    )


class _Strict(yaml.composer.Composer):
    """Composing that refuses every tag, and depth."""

    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event = self.peek_event()  # type: ignore[attr-defined]  # the parser has it
        tag = getattr(event, "tag", None)
        if tag is not None:
            raise yaml.composer.ComposerError(
                None, None, f"a tag ({tag[:80]}): a configuration is plain data", event.start_mark
            )
        if self.depth > _DEEPEST:
            raise yaml.composer.ComposerError(None, None, f"nested more than {_DEEPEST} levels deep", event.start_mark)
        self.depth += 1
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


class _Loader(_Strict, yaml.SafeLoader):
    """Safe loading that besides refuses a key given twice (plain YAML keeps the last one silently)."""


def _mapping(loader: yaml.SafeLoader, node: yaml.MappingNode) -> dict[Any, Any]:
    keys = [loader.construct_object(k, deep=True) for k, _ in node.value]
    twice = {str(k) for k, count in Counter(keys).items() if count > 1}
    if twice:
        raise yaml.constructor.ConstructorError(
            None, None, f"key given twice: {', '.join(sorted(twice))}", node.start_mark
        )
    return {k: loader.construct_object(v, deep=True) for k, (_, v) in zip(keys, node.value, strict=True)}


_Loader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _mapping)


def _integer(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> int:
    """Python refuses to print a number of thousands of digits, however it was written (hexadecimal, by sixties)."""
    if len(node.value) > _MOST_DIGITS:
        raise yaml.constructor.ConstructorError(None, None, "a number too long", node.start_mark)
    if ":" in node.value or re.match(r"[-+]?0[0-7_]", node.value):
        raise yaml.constructor.ConstructorError(None, None, f"{node.value}: {_OTHER_BASE}", node.start_mark)
    return int(loader.construct_yaml_int(node))


def _float(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> float:
    if ":" in node.value:
        raise yaml.constructor.ConstructorError(None, None, f"{node.value}: {_OTHER_BASE}", node.start_mark)
    return float(loader.construct_yaml_float(node))


_OTHER_BASE = "YAML takes this for a number in sixties or in eights; write it in tens, or in quotes as a text"

_Loader.add_constructor("tag:yaml.org,2002:int", _integer)
_Loader.add_constructor("tag:yaml.org,2002:float", _float)

_Shipped = _Loader
"""As `_Loader`, for files that come with fwclass: parsed in C where PyYAML has that, three times as fast."""

if yaml.__with_libyaml__:

    class _Shipped(_Strict, yaml.CSafeLoader):  # type: ignore[no-redef]
        """Nobody else's text goes through C."""

        def __init__(self, text: str) -> None:
            yaml.CSafeLoader.__init__(self, text)
            yaml.composer.Composer.__init__(self)

    _Shipped.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _mapping)


def plain(text: str, shipped: bool = False) -> Any:
    """The plain data that `text` (YAML) holds: numbers, texts, lists and mappings. `shipped`: it comes with fwclass.

    `yaml.YAMLError`: no YAML, a tag (`!…`) or a key twice, too deep, or aliases that would repeat too much.
    """
    loader = (_Shipped if shipped else _Loader)(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return None
        _count(node, {}, 0)
        return loader.construct_document(node)
    except (ValueError, TypeError, OverflowError) as fault:  # a date that is none, a list as a key, a number too long
        raise yaml.YAMLError(f"a value cannot be read: {fault}") from fault
    except RecursionError as fault:
        raise yaml.YAMLError(f"nested more than {_DEEPEST} levels deep") from fault
    finally:
        loader.dispose()


def _shipped(text: str, section: str | None) -> Any:
    """As `plain`, of a file that comes with fwclass: read again and again, and parsed once; of a `section` alone."""
    value = _parse(text)
    return _copy(value if section is None else {section: value.get(section)})


def _copy(value: Any) -> Any:
    """Plain data once more; copy.deepcopy takes ten times as long."""
    if isinstance(value, dict):
        return {key: _copy(one) for key, one in value.items()}
    return [_copy(one) for one in value] if isinstance(value, list) else value


@lru_cache(maxsize=8)
def _parse(text: str) -> Any:
    return plain(text, shipped=True)


def _count(node: yaml.Node, known: dict[int, tuple[int, int]], depth: int) -> tuple[int, int]:
    """Values below `node` and their levels, those of an alias each time; `known` holds what was counted before."""
    if id(node) not in known:
        known[id(node)] = _UNDER_WAY
        below: list[yaml.Node] = []
        if isinstance(node, yaml.SequenceNode):
            below = node.value
        elif isinstance(node, yaml.MappingNode):
            below = [part for pair in node.value for part in pair]
        counts = [_count(part, known, depth + 1) for part in below]
        known[id(node)] = 1 + sum(n for n, _ in counts), 1 + max((levels for _, levels in counts), default=0)
    values, levels = known[id(node)]
    if not values:
        raise yaml.YAMLError("an alias (*…) stands inside of what it repeats")
    if depth + levels > _DEEPEST:
        raise yaml.YAMLError(f"nested more than {_DEEPEST} levels deep")
    if values > _MOST_VALUES:
        raise yaml.YAMLError(f"more than {_MOST_VALUES} values, with what aliases (*…) repeat")
    return values, levels


def read(path: Path, section: str | None = None) -> dict[str, Any]:
    """The mapping in a YAML file; `ConfigError` where there is none, or a file that could not have been meant.

    `section`: of a file that comes with fwclass only what is below this key.
    """
    try:
        if path.stat().st_size > _SIZE_LIMIT:
            raise ConfigError(
                "a configuration this large is not one",
                where=path,
                expected=f"at most {_SIZE_LIMIT} bytes",
                got=f"{path.stat().st_size} bytes",
                do="check the path",
            )
        with open_regular(path) as file:
            text = file.read().decode("utf-8")
        value = _shipped(text, section) if path.resolve().is_relative_to(conf_directory()) else plain(text)
    except (OSError, yaml.YAMLError, UnicodeDecodeError) as fault:
        message = _message(fault, path.name)
        tabs = "indent with spaces: YAML knows no tabs" if "\\t" in message else "mend the YAML at the place named"
        raise ConfigError("a configuration cannot be read", where=path, got=message[:1000], do=tabs) from fault
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise ConfigError("a configuration is a mapping of sections", where=path, got=type(value).__name__)
    return value


def _message(fault: Exception, name: str) -> str:
    """What is wrong and where; the lines themselves, which the fault's own text quotes, may hold a secret."""
    if not isinstance(fault, yaml.MarkedYAMLError):
        return " ".join(str(fault).split()).replace('"<unicode string>"', name)
    mark = fault.problem_mark or fault.context_mark
    position = f" in {name}, line {mark.line + 1}, column {mark.column + 1}" if mark else ""
    return ", ".join(text for text in (fault.context, fault.problem) if text) + position


def merge(base: Any, change: Any) -> Any:
    """`change` laid over `base`: mappings merge, everything else is replaced."""
    if isinstance(base, dict) and isinstance(change, dict):
        return {k: merge(base.get(k), change[k]) if k in change else base[k] for k in {**base, **change}}
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
        result: Any = plain(value)
    except yaml.YAMLError as fault:
        message = _message(fault, "the value")
        raise ConfigError(
            "the value of --set cannot be read", where=f"--set {redacted_setting(text)}", got=message
        ) from fault
    for name in reversed(names):
        result = {name: result}
    return dict(result)
