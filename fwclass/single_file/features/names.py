"""Which features a command line asks for, and which there are."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from fwclass.columns import FEATURES
from fwclass.conf.sets import feature_set, listed_once
from fwclass.errors import ConfigError
from fwclass.features.names import NO_FEATURE, FeatureRequest, check_scale, is_feature, meant
from fwclass.ground.terrain.params import HEIGHTS
from fwclass.radiometry.params import RADIOMETRIC
from fwclass.waveforms import ECHO_COLUMNS

MEASURED = tuple(n for n in (*ECHO_COLUMNS, *HEIGHTS, *RADIOMETRIC) if n not in NO_FEATURE)
"""Columns of echoes that a set may name besides features of a neighbourhood."""

ENDS = {"r": "r100", "c": "c100", "k": "k20", "g": "g100", "o": "opt"}
"""How names over each kind of neighbourhood end, by example."""

DEFAULT = "default"
"""The set where none is named."""

FLAG_BITS = ("fit_flags", "radiometry_flags")
"""Of these, what is no quantity."""


@dataclass(frozen=True)
class FeatureList:
    """Names of the features in order, and what they are called together."""

    label: str
    names: tuple[str, ...]

    @property
    def around(self) -> FeatureRequest:
        """Those that are features of a neighbourhood."""
        return FeatureRequest.of(n for n in self.names if is_feature(n))


def sorted_settings(words: Iterable[str]) -> tuple[str | None, tuple[str, ...]]:
    """``--set`` as it came: the feature set that it names, if any, and the settings ``section.key=value``.

    `ConfigError`: two feature sets.
    """
    words = tuple(words)
    sets = [w for w in words if "=" not in w]
    if len(sets) > 1:
        raise ConfigError(
            "two feature sets are named",
            where="--set",
            expected="one, and settings section.key=value",
            got=", ".join(sets),
            do="join them in a file of your own: see docs/features.md",
        )
    return (sets[0] if sets else None), tuple(w for w in words if "=" in w)


def requested_features(named: str | None, listed: str | None) -> FeatureList:
    """The features of a set (name or file) or of a list ``a,b,c``; without both the set `DEFAULT`.

    `ConfigError`: no such set, both, a name that is no feature.
    """
    if named is not None and listed is not None:
        raise ConfigError("features are named twice", where="--set and --features", do="leave one of them out")
    if listed is not None:
        features = FeatureList(
            "--features", listed_once([n.strip() for n in listed.split(",") if n.strip()], "--features")
        )
    else:
        text = named if named is not None else DEFAULT
        features = FeatureList(text, feature_set(text).features)
    if not features.names:
        raise ConfigError(
            "no feature is named", where=features.label, expected="for example height_std_c200,planarity_k20"
        )
    for name in features.names:
        check_name(name, features.label)
    return features


def check_name(name: str, where: str) -> None:
    """`ConfigError` for a name that is no feature."""
    check_scale(name, where)
    if is_feature(name) or name in MEASURED:
        return
    base = re.sub(r"_([rckg]\d+|opt)$", "", name)
    scales = next((c.scales for c in FEATURES if c.name == base), None)
    if scales:
        raise ConfigError(
            f"{name!r} is not a feature: {base} is taken over other neighbourhoods"
            if base != name
            else f"{name!r} lacks its scale",
            where=where,
            expected=" or ".join(f"{base}_{ENDS[s]}" for s in scales),
            got=name,
            do="sizes are centimetres, with k echoes: `fwclass features --list` explains the letters",
        )
    raise ConfigError(
        f"{name!r} is not a feature",
        where=where,
        expected="a column of echoes, or a feature with its scale",
        got=name,
        do=f"{meant(name, MEASURED)} `fwclass features --list` shows all".strip(),
    )


def measured_names() -> tuple[str, ...]:
    """Columns of echoes that a list may name, as they are shown."""
    return tuple(n for n in MEASURED if n not in FLAG_BITS and not n.startswith("beam_"))
