"""Whether a model fits the data and the configuration that it is used with."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from fwclass.conf import Config
from fwclass.errors import ConfigError, set_words
from fwclass.features.names import FeatureRequest, is_feature
from fwclass.features.params import FeaturesParams
from fwclass.features.pulses import MEASURED
from fwclass.graph.quantities import quantities_by_feature
from fwclass.model import ClassDef, Model
from fwclass.radiometry.stage import RADIOMETRY
from fwclass.read.quantities import Quantities

SAID_LATER = ("noise_counts", "pulse_reach")
"""Parameters that older models' cards do not name: where one is missing, any value is accepted."""


def feature_parameters(
    names: Iterable[str],
    params: FeaturesParams,
    ground: str | None = None,
    height: str | None = None,
    quantities: Quantities | None = None,
) -> dict[str, Any]:
    """Of the section `features` what the values of `names` depend on, besides their own scales; plain data.

    The parameters ``dense_*`` are left out: they change values only where echoes are denser than those of any survey.
    With height above ground among them also the `ground` filter that made it and what it is the `height` above
    (`terrain.height`), and with features of amplitudes or echo
    widths which `quantities` these are, where it is known.
    """
    names = tuple(names)
    request = FeatureRequest.of(n for n in names if is_feature(n))
    kinds = {scale.kind for scale, _ in request.scales}
    needed: dict[str, bool] = {
        "cell_x": "zc" in request.plain,
        "cell_y": "zc" in request.plain,
        "nearest_reach": "k" in kinds,
        "optimal_radii": "o" in kinds or "optimal_radius" in request.plain,
        "orientation_rounds": "oriented_inclination" in request.bases,
        "normal_radius": any(n in RADIOMETRY.writes for n in names),
        "pulse_reach": any(n in MEASURED for n in request.plain),
        "noise_counts": bool(request.names),
    }
    plain = params.model_dump(mode="json")
    parameters = {name: plain[name] for name, yes in needed.items() if yes}
    above = {"ground": ground, "height": height} if "height_above_ground" in names else {}
    parameters |= {name: value for name, value in above.items() if value}
    by_feature = quantities_by_feature(names, quantities) if quantities else {}
    return {**parameters, "quantities": by_feature} if by_feature else parameters


def check_computed(model: Model, params: FeaturesParams, where: object) -> None:
    """`ConfigError` if the model learned from features that were computed in another way."""
    ours = feature_parameters(model.features, params)
    theirs = model.card.get("computed", {})
    for name, value in ours.items():
        if name in SAID_LATER and name not in theirs:
            continue
        if name not in theirs or theirs[name] != value:
            setting = shlex.quote(f"features.{name}={theirs.get(name)}".replace(" ", ""))
            raise ConfigError(
                f"the model's features were computed with another {name}",
                where=where,
                expected=theirs.get(name, "a model whose card says what it was"),
                got=value,
                do=f"--set {setting}" if name in theirs else "train it again",
            )


def ground_notes(card: Mapping[str, Any], method: str | None, height: str, in_run: bool = False) -> list[str]:
    """What to tell where heights decide that are of another ground filter (None: the file's own ground) than the
    model's (`card`), or above it in another way (`height`, of `terrain.height`). A run's filter is a
    setting, a file's an option."""
    computed, notes = card.get("computed", {}), list[str]()
    learned = computed.get("ground")
    if learned not in (None, method):
        here = "the file's own ground" if method is None else method
        how = set_words("ground.method", learned) if in_run else f"--method {shlex.quote(str(learned))}"
        if learned == "auto" and not in_run:
            how = "`fwclass ground --auto` first, then --own-ground"
        notes.append(f"the model learned from heights above the ground of {learned}, here it is that of {here}: {how}")
    above = computed.get("height")
    if above not in (None, height):
        notes.append(
            f"the model learned from heights above ground by {above}, here they are by {height}: "
            + set_words("terrain.height", above)
        )
    return notes


def check_classes(model: Model, classes: Sequence[ClassDef], where: object) -> None:
    """`ConfigError` if the model tells other classes than the survey has."""
    ours, theirs = sorted(c.code for c in classes), sorted(int(c) for c in model.codes)
    if ours != theirs:
        raise ConfigError(
            "the model tells other classes than the survey has",
            where=where,
            expected=", ".join(f"{c.name} {c.code}" for c in model.classes),
            got=", ".join(f"{c.name} {c.code}" for c in classes),
            do="give survey.classes the model's codes, or train a model for these classes",
        )


def check_model(model: Model, config: Config, where: object) -> None:
    """`ConfigError` unless `model` fits a survey's configuration, which may leave the classes to it."""
    if config.classes:
        check_classes(model, config.classes, where)
    check_computed(model, config.features, where)


def check_names(model: Model, known: Mapping[str, Any], where: object) -> None:
    """`ConfigError` for a feature of the model that this data or program has not; `known` are columns there are."""
    lacking = [n for n in model.features if n not in known and not is_feature(n)]
    if lacking:
        raise ConfigError(
            f"the model decides by {lacking[0]!r}, which there is not",
            where=where,
            expected=", ".join(model.features),
            got=f"nothing called {', '.join(lacking)}",
            do="use data that has it, or train a model without it",
        )
