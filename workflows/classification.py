"""All stages: waveforms (or echoes) to classified, GIS-ready tiles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from fwclass.conf import Config
from fwclass.errors import ConfigError
from fwclass.graph import forest, ground, outputs, sites
from fwclass.graph import tiles as of_tiles
from fwclass.graph.area_of_interest import Area
from fwclass.graph.layout import Layout, check_features
from fwclass.graph.model_fit import check_model
from fwclass.graph.report import write_report
from fwclass.graph.sampling import sampling_tasks
from fwclass.graph.walk import Tiled, until_labels, until_tiles
from fwclass.run.part import Task
from fwclass.run.runner import Runner, ancestors
from fwclass.run.tasks import Tasks
from fwclass.store.models import load_model
from fwclass.store.remote_file import Location, directory_outside, local
from fwclass.store.url import is_url, url_of


def classification(config: Config, runner: Runner, tiles: frozenset[str] | Area | None = None) -> dict[str, Any]:
    """Run all stages on `runner` and write the report; return the report's dict.

    `tiles`: deliver only these tiles, or those in an area; what they need (their neighbours' echoes, the training
    areas) is made too, so that they come out as in a whole run.
    """
    names, model = features_of(config)
    tiled = until_tiles(config, runner, names, load_model(local(model[0])).card if model else None)
    keys = tiles.tiles(tiled.layout, tiled.survey.crs) if isinstance(tiles, Area) else tiles
    return from_tiles(config, runner, tiled, names, until_labels(tiled, (*names, *config.features.also)), model, keys)


def features_of(config: Config) -> tuple[tuple[str, ...], tuple[Location, str] | None]:
    """Names of the features that will be decided by, and the model that is given; `ConfigError` for what is none."""
    model = given_model(config)
    names = load_model(local(model[0])).features if model else config.features_asked
    check_features(config, names, model[0] if model else f"{config.path}: survey.features")
    check_features(config, config.features.also, f"{config.path}: features.also")
    return names, model


def from_tiles(
    config: Config,
    runner: Runner,
    tiled: Tiled,
    names: tuple[str, ...],
    labelling: Sequence[Task],
    model: tuple[Location, str] | None = None,
    tiles: frozenset[str] | None = None,
) -> dict[str, Any]:
    """The stages from tiles to the report: a classifier by `names`, trained under `config` unless there is a `model`.

    `labelling` are the tasks until labels, with all features that anything asks for.
    """
    survey, layout = tiled.survey, replace(tiled.layout, config=config)
    labelled = config.survey.reference.kind != "none"
    tasks = Tasks.held(labelling) + ground.seam_tasks(layout)  # long, and one part: not at the end
    tasks += [] if model else Tasks.held(forest.training_tasks(layout)) + sampling_tasks(layout)
    tasks += forest.classify_tasks(layout, names, model)
    tasks += forest.assess_tasks(layout, names) if labelled else []
    tasks += outputs.output_tasks(layout, names, survey, *tiled.where)
    for words in (sites.told(sites.sites(layout), survey.strips, tiled.where[1]), of_tiles.small_tiles(layout)):
        if words:
            runner.display.say(words)
    if tiles is not None:
        tasks = Tasks.held(ancestors(tasks, _wanted(layout, tiles)))
    runner.do(tasks)
    runner.finish(whole=tiles is None)
    return runner.tell(lambda: write_report(config, runner, survey, layout, names))


def _wanted(layout: Layout, tiles: frozenset[str]) -> list[tuple[str, str]]:
    unknown = sorted(tiles - layout.keys)
    if unknown:
        raise ConfigError(
            "no such tile in this survey",
            where="--tiles",
            expected="keys of tiles with echoes, for example " + ", ".join(t.key for t in layout.tiles[:3]),
            got=", ".join(unknown),
            do="the keys are the names of the files in laz/tiles",
        )
    return [("publish-tile", key) for key in sorted(tiles)]


def given_model(config: Config) -> tuple[Location, str] | None:
    """Location and digest of the model that the configuration names, None where it is to be trained."""
    if config.survey.model is None:
        return None
    place: Location = (config.path.parent / config.survey.model).resolve()
    if is_url(config.survey.model):
        place = directory_outside(url_of(config.survey.model, f"{config.path}: survey.model"), config.store)
    path = local(place)
    check_model(load_model(path), config, path)
    return place, forest.digest_of_model(path)
