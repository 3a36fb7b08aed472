"""Feature sets: named lists of features, one file each in `conf/features`, or a user's own."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fwclass.conf.files import conf_directory, read
from fwclass.errors import ConfigError, first_few, nearest

NAMED = 20
"""Features that a message names."""

MOST_FEATURES = 10_000
"""Of a set, or of a survey; each is a column of every echo."""


class EachSection(BaseModel):
    """Every base over every scale (as names end, ``r100``), scale by scale."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    bases: tuple[str, ...]
    scales: tuple[str, ...]

    @property
    def count(self) -> int:
        """How many features these are."""
        return len(self.bases) * len(self.scales)


class SelectionStep(BaseModel):
    """A set of `size` features, and how accurate a forest with it was in the folds (0 to 1, mean and spread)."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    size: int = Field(ge=0, le=100_000)
    accuracy: float = Field(ge=0, le=1)
    accuracy_std: float | None = Field(ge=0, le=1)


class Selection(BaseModel):
    """What `fwclass select` wrote about how a set was found; it changes nothing."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    method: str = Field(max_length=100)
    pick: str = Field(max_length=100)
    survey: str = Field(max_length=1000)
    steps: tuple[SelectionStep, ...] = Field(min_length=2, max_length=10_000)


class _File(BaseModel):
    """What a feature set's file holds."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    about: str = ""
    source: str = ""
    features: tuple[str, ...] = ()
    each: tuple[EachSection, ...] = ()
    selection: dict[str, object] | None = None


@dataclass(frozen=True)
class FeatureSet:
    """`features`: names in order, each once; `selection`: how they were chosen, where the file tells."""

    name: str
    about: str
    source: str
    features: tuple[str, ...]
    selection: Selection | None = None


def shipped_sets() -> tuple[str, ...]:
    """Names of the sets that come with fwclass."""
    return tuple(sorted(p.stem for p in (conf_directory() / "features").glob("*.yaml")))


def feature_set(name: str, beside: Path | None = None, where: object = "--set") -> FeatureSet:
    """The set of that name, or in the file of that path: relative to the directory `beside`, or else to here.

    `where` tells in an error who asked for it.
    """
    known = shipped_sets()
    if name in known:
        return _read(conf_directory() / "features" / f"{name}.yaml")
    for path in (*([beside / name] if beside else []), Path(name)):
        if path.is_file():
            return _read(path)
    raise ConfigError(
        "no such feature set",
        where=where,
        expected=f"one of {', '.join(known)}, the file of one, or a list of columns [zc, ...]",
        got=name,
        do=f"{nearest(name, known)}; `fwclass features --list` shows the sets",
    )


def _read(path: Path) -> FeatureSet:
    try:
        file = _File.model_validate(read(path))
    except ValidationError as fault:
        faults = "; ".join(f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in fault.errors()[:3])
        raise ConfigError(
            "this is not a feature set", where=path, expected="about, source, features, each", got=faults
        ) from fault
    number = len(file.features) + sum(each.count for each in file.each)
    if number > MOST_FEATURES:
        raise ConfigError(
            "a feature set with too many features",
            where=path,
            expected=f"at most {MOST_FEATURES:,}",
            got=f"{number:,}",
            do="leave some bases or scales out",
        )
    names = [*file.features, *(f"{b}_{s}" for each in file.each for s in each.scales for b in each.bases)]
    if not names:
        raise ConfigError("a feature set without features", where=path, do="list some under `features:`")
    return FeatureSet(path.stem, file.about, file.source, listed_once(names, path), _selection(file.selection))


def _selection(written: dict[str, object] | None) -> Selection | None:
    try:
        return None if written is None else Selection.model_validate(written)
    except ValidationError:
        return None  # of another version, or by hand: it is shown, and decides nothing


def listed_once(names: Sequence[str], where: object) -> tuple[str, ...]:
    """`names`, or a `ConfigError` where one stands twice."""
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice:
        raise ConfigError("a feature is listed twice", where=where, got=first_few(twice, NAMED), do="take one out")
    return tuple(names)
