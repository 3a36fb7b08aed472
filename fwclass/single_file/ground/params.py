"""Parameters of a ground filter as a user names them: ``--param name=value``, presets, and settings."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from fwclass import conf
from fwclass.conf.files import plain
from fwclass.errors import ConfigError, nearest
from fwclass.ground.filters import FILTERS
from fwclass.ground.methods.params import FilterParams
from fwclass.ground.params import GroundParams, section_of

SHARED = ("max_building_size", "last_returns", "block", "block_halo")
"""Parameters that all filters have in common."""

ALIASES: Mapping[str, Mapping[str, str]] = {
    "csf": {  # PDAL's filters.csf, lidR's csf
        "resolution": "cloth_resolution",
        "threshold": "class_threshold",
        "step": "time_step",
        "smooth": "slope_smooth",
        "sloop_smooth": "slope_smooth",
    },
    "smrf": {"elevation_threshold": "threshold", "elevation_scalar": "scalar"},  # the paper's own words
    "ptd": {"step": "res"},  # LAStools
    "iptd": {"step": "res"},
}
"""Other programs' names of parameters, by section."""

SECTIONS = ("ground", "ground_auto", "ground_search", "terrain", "publish", "label")
"""Sections of the configuration that the ground commands obey."""


@dataclass(frozen=True)
class FileJob:
    """What a command on one file, which may look for its ground, was asked for.

    Attributes
    ----------
    source, output : the files.
    method, preset, assignments, settings : see `ground_params`.
    crs : coordinate system instead of the file's own, as text.
    overwrite : outputs may replace files.
    """

    source: Path
    output: Path
    method: str | None = None
    preset: str | None = None
    assignments: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()
    crs: str | None = None
    overwrite: bool = False


def ground_params(
    method: str | None, preset: str | None = None, assignments: Iterable[str] = (), settings: tuple[str, ...] = ()
) -> GroundParams:
    """The base's parameters, changed by a preset, then by `settings`, then by `method` and `assignments`.

    `method`: filter; None takes the one that configuration or preset name. `assignments`: ``name=value``: a parameter
    of that filter, by its own or another program's name, or a shared one. `settings`: ``section.key=value``.

    `ConfigError`: an unknown filter, preset or parameter, or a value that does not fit.
    """
    conf.check_settings(settings, SECTIONS)
    _check_preset(preset)
    change: dict[str, Any] = {} if preset is None else {"preset": preset}
    if method is not None:
        change["method"] = method
    params: GroundParams = conf.section("ground", settings, {"ground": change})
    _check_method(params)
    return with_assignments(params, assignments)


def with_assignments(params: GroundParams, assignments: Iterable[str]) -> GroundParams:
    """`params` with values of ``name=value`` in place of their own; see `ground_params`."""
    words = tuple(assignments)
    if not words:
        return params
    values = params.model_dump()
    for text in words:
        name, value = _split(text)
        _put(values, _place(params, name, text), value)
    where = " ".join(f"--param {text}" for text in words)
    try:
        checked: GroundParams = conf.checked("ground", values, where)
    except ConfigError as fault:
        wanted, got = _in_words(fault.got)
        raise ConfigError(
            "a parameter has a value that does not fit",
            where=where,
            expected=wanted,
            got=got,
            do="give another value; conf/base.yaml has the unit and the source of every parameter",
        ) from fault
    return checked


def _in_words(faults: str) -> tuple[str, str]:
    """What is expected and what came, of faults ``section.key: message (got value)``."""
    matches = [re.fullmatch(r"ground\.(.+?): (.*) \(got (.*)\)", one, re.S) for one in faults.split("; ")]
    if not all(matches):
        return "", faults.removeprefix("ground: ")
    wanted = "; ".join(f"{m[1]}: {_plain_words(m[2])}" for m in matches if m)
    return wanted, "; ".join(m[3] for m in matches if m)


_PHRASES = (
    ("Input should be greater than or equal to ", "at least "),
    ("Input should be greater than ", "more than "),
    ("Input should be less than or equal to ", "at most "),
    ("Input should be less than ", "less than "),
    ("Input should be ", ""),
    ("Value error, ", ""),
    (" is wanted", ""),
)


def _plain_words(message: str) -> str:
    """A library's phrase as what is expected."""
    for phrase, ours in _PHRASES:
        message = message.replace(phrase, ours)
    return message


def _check_preset(name: str | None) -> None:
    presets = conf.presets()
    if name is not None and name not in presets:
        raise ConfigError(
            "no such preset", where="--preset", expected=", ".join(presets), got=name, do=closest(name, presets)
        )


def closest(name: str, known: Iterable[str]) -> str:
    """`did you mean …?`; without the list, which stands beside it."""
    return close if (close := nearest(name, known)).startswith("did") else "choose one of these"


def _check_method(params: GroundParams) -> None:
    if params.method == "auto":
        raise ConfigError(
            "a survey chooses filters by squares, and this is a file",
            where="ground.method",
            expected=", ".join(FILTERS),
            got="auto",
            do="`fwclass ground IN OUT --auto` looks at the points first",
        )
    missing = [m for m in params.filters if m not in FILTERS]
    if missing:
        raise ConfigError(
            "there is no such filter",
            where="ground.method",
            expected=", ".join(FILTERS),
            got=", ".join(missing),
            do=closest(missing[0], FILTERS),
        )


def _split(text: str) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    if not equals or not name.strip():
        raise ConfigError("--param wants name=value", where="--param", expected="for example slope=0.2", got=text)
    try:
        return name.strip(), plain(value)
    except yaml.YAMLError as fault:
        raise ConfigError("the value of --param cannot be read", where=f"--param {text}", got=fault) from fault


def _put(change: dict[str, Any], path: tuple[str, ...], value: Any) -> None:
    for key in path[:-1]:
        change = change.setdefault(key, {})
    change[path[-1]] = value


def _place(params: GroundParams, name: str, text: str) -> tuple[str, ...]:
    """Where in the section `ground` a parameter stands."""
    places_of = names_of(params)
    plain = name.replace("-", "_").lower()
    places = places_of.get(plain, ())
    if len(places) == 1:
        return places[0]
    if places:
        choices = [".".join(p[1:] if params.method == "csf+smrf" else p) + f"={text.partition('=')[2]}" for p in places]
        raise ConfigError(
            f"several filters of {params.method} have a parameter {name!r}",
            where=f"--param {text}",
            expected=" or ".join(choices),
            got=name,
            do="say which one",
        )
    raise ConfigError(
        f"{params.method} has no parameter {name!r}",
        where=f"--param {text}",
        expected=", ".join([*_listed(places_of), "noise.<name>"]),
        got=name,
        do=closest(plain, places_of),
    )


def _listed(known: Mapping[str, list[tuple[str, ...]]]) -> list[str]:
    """Names that mean one parameter, the shortest of each."""
    plain = [n for n, places in known.items() if "." not in n and len(places) == 1]
    return plain + [n for n in known if len(known.get(n.partition(".")[2], ())) > 1]


def names_of(params: GroundParams) -> dict[str, list[tuple[str, ...]]]:
    """Every name that ``--param`` takes for the method of `params`, with the places that it may mean."""
    known: dict[str, list[tuple[str, ...]]] = {}
    for section, own, short in _sections(params):
        aliases = ALIASES.get(short, {})
        for name in _fields(own):
            _know(known, (*section, *name.split(".")), name, short)
        for alias, name in aliases.items():
            if name in type(own).model_fields and alias not in type(own).model_fields:
                _know(known, (*section, name), alias, short)
    known |= {n: [(n,)] for n in SHARED}
    for name in _fields(params.noise):
        known[f"noise.{name}"] = [("noise", name)]
    return known


def _know(known: dict[str, list[tuple[str, ...]]], place: tuple[str, ...], name: str, short: str) -> None:
    known.setdefault(name, [])
    if place not in known[name] and not ("." in name and known[name]):
        known[name].append(place)
    if short:
        known[f"{short}.{name}"] = [place]


def _sections(params: GroundParams) -> list[tuple[tuple[str, ...], FilterParams, str]]:
    """(place, parameters, short name) of every filter section that the method of `params` uses."""
    if params.method == "consensus":
        inner = [(section_of(m), m) for m in params.consensus.methods]
        return [(("consensus",), params.consensus, ""), *(((s,), getattr(params, s), s) for s, _ in inner)]
    if params.method == "csf+smrf":
        both = params.csf_smrf
        return [(("csf_smrf", "csf"), both.csf, "csf"), (("csf_smrf", "smrf"), both.smrf, "smrf")]
    section = section_of(params.method)
    return [((section,), getattr(params, section), section)]


def _fields(own: Any) -> list[str]:
    """Names of parameters; those of a section inside with its name before them."""
    out = []
    for name in type(own).model_fields:
        value = getattr(own, name)
        out += [f"{name}.{inner}" for inner in _fields(value)] if isinstance(value, FilterParams) else [name]
    return out


def used_params(params: GroundParams) -> dict[str, Any]:
    """What the filter works with, as plain data: shared parameters, and its own with every derived length."""
    plain: dict[str, Any] = {name: getattr(params, name) for name in SHARED}
    plain["noise"] = params.noise.model_dump(mode="json")
    if params.method == "consensus":
        plain |= params.consensus.model_dump(mode="json")
        plain |= {m: params.of(m).model_dump(mode="json") for m in params.consensus.methods}
        return plain
    return plain | params.of(params.method).model_dump(mode="json")
