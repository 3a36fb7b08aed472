"""What one section of a configuration cannot see alone."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NoReturn

from fwclass.classes import WIRES
from fwclass.conf.model import Config
from fwclass.errors import ConfigError, nearest
from fwclass.ground.methods.params import MAX_HALO
from fwclass.ground.terrain.params import MOST_CELLS
from fwclass.ground.tuning_params import largest_halo
from fwclass.voxels.params import MOST_NUMBERS


def _check_features(config: Config) -> None:
    _ = config.features_asked  # a set is there and can be read


def _check_classes(config: Config) -> None:
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
    strangers = sorted({*config.classify.lines.codes} - {*codes, *WIRES})
    if strangers and names:
        raise ConfigError(
            "no class has a code whose echoes are to lie on lines",
            where=f"{where}: classify.lines.codes",
            expected=", ".join(f"{c.code} {c.name}" for c in config.survey.classes),
            got=strangers,
            do="one of these, or leave it out: codes 13 and 14 are looked for where a class has them",
        )
    weights = config.train.class_weights
    weighted = weights if isinstance(weights, Mapping) else ()
    asked = (
        ("classify.refine.between", config.classify.refine.between),
        ("train.class_weights", weighted),
        ("assess.objects.classes", (config.assess.objects.classes or ()) if names else ()),
    )
    for key, called in asked:
        for name in called:
            if name not in names:
                raise ConfigError(
                    f"no class is called {name!r}",
                    where=f"{where}: {key}",
                    expected=", ".join(names),
                    got=name,
                    do=nearest(name, names),
                )


def _check_cells(config: Config) -> None:
    where = config.path
    if config.terrain.block > MOST_CELLS * config.publish.class_cell:
        raise ConfigError(
            "the cells of the class raster are too small",
            where=f"{where}: publish.class_cell",
            expected=f"at least {config.terrain.block / MOST_CELLS:g} m: {MOST_CELLS:,} in a block (terrain.block)",
            got=f"{config.publish.class_cell:g} m",
            do="make them larger, or the blocks smaller",
        )
    profile = config.profile
    numbers = (config.terrain.block / profile.cell + 1.0) ** 2 * profile.bins
    if profile.write and numbers > MOST_NUMBERS:
        raise ConfigError(
            "the profiles of a block are too many numbers",
            where=f"{where}: profile.cell, profile.bin",
            expected=f"at most {MOST_NUMBERS:,} in a block of {config.terrain.block:g} m (terrain.block)",
            got=f"{numbers:.3g}: {profile.bins:,} heights in cells of {profile.cell:g} m",
            do="larger cells or bins, a lower profile.highest, or smaller blocks",
        )
    layer = (config.terrain.block / config.voxels.size + 1.0) ** 2
    if config.voxels.write and layer > config.voxels.most:
        raise ConfigError(
            "one layer of voxels is too many for a block already",
            where=f"{where}: voxels.size",
            expected=f"at most {config.voxels.most:,} (voxels.most) in a block of {config.terrain.block:g} m "
            "(terrain.block)",
            got=f"{layer:.3g} of {config.voxels.size:g} m",
            do="larger voxels, or smaller blocks",
        )
    planes = config.quality.planes
    for which, cell in (
        ("cell", config.quality.cell),
        ("planes.cell", planes.cell),
        ("planes.slope_cell", planes.slope_cell),
    ):
        if round(config.terrain.block * 1000) % max(1, round(cell * 1000)):
            raise ConfigError(
                "the cells of quality do not divide a block",
                where=f"{where}: quality.{which}",
                expected=f"a whole number of them in {config.terrain.block:g} m (terrain.block)",
                got=f"{cell:g} m",
                do="choose another edge, 2 or 4 m for example",
            )


def _check_ground(config: Config) -> None:
    where = config.path
    if config.ground.method == "auto" and (reach := largest_halo(config.ground, config.ground_auto)) > MAX_HALO:
        raise ConfigError(
            "the filter may read too far around a block",
            where=f"{where}: ground_auto",
            expected=f"at most {MAX_HALO:,.0f} m",
            got=f"{reach:,.0f} m",
            do="a smaller ground_auto.building_most, or candidates with smaller windows",
        )
    if config.stack.enabled and "water" in config.stack.surfaces and config.water.file is None:
        raise ConfigError(
            "weak echoes of water are looked for along the levels of its polygons, and there are none",
            where=f"{where}: stack.surfaces",
            expected="water.file: polygons of standing water",
            got="null",
            do="name a file in water.file, or leave water out of stack.surfaces",
        )


def _check_layers(config: Config) -> None:
    """One layer behind the first, and only where all echoes are classified."""
    where = config.path
    if config.classify.refine.between and config.thin.rate < 1.0:
        raise ConfigError(
            "a thinned run has no second layer: the features at a boundary would be those of few echoes",
            where=f"{where}: classify.refine, thin.rate",
            got=f"thin.rate {config.thin.rate:g}",
            do="--set thin.rate=1, or --set classify.refine.between=[]",
        )
    if config.classify.context.cells not in (None, (), "auto"):
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

    if config.classify.regularize.strength > 0:
        both = bool(config.classify.refine.between)
        if both or config.thin.rate < 1.0:
            refuse_regularized(f"{where}: classify.regularize, " + ("classify.refine" if both else "thin.rate"))


def refuse_regularized(where: object) -> NoReturn:
    """Refuses a mean field behind a second layer of a pair, or over sampled echoes alone."""
    raise ConfigError(
        "neighbours agree by one model's shares of all echoes and all classes",
        where=where,
        got="a mean field (classify.regularize.strength above 0), and a thinned run or a second layer of two classes",
        do="--set classify.regularize.strength=0, or without the other",
    )


def _check_boxes(config: Config) -> None:
    where = config.path
    for kind in ("train", "test"):
        for box in getattr(config.areas, kind):
            if not all(map(math.isfinite, box)) or box[0] >= box[2] or box[1] >= box[3]:
                raise ConfigError(
                    "an area is [xmin, ymin, xmax, ymax] with min < max", where=f"{where}: areas.{kind}", got=box
                )


def check_learning(config: Config) -> None:
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


CHECKS = (_check_features, _check_classes, _check_cells, _check_ground, _check_layers, _check_boxes)
"""All but that of what a classifier learns by, which other workflows do without."""
