"""The whole road: waveforms (or echoes) to classified, GIS-ready tiles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fwclass.conf import Config
from fwclass.errors import ConfigError
from fwclass.run.plan import forest, ground, outputs, sources
from fwclass.run.plan import tiles as of_tiles
from fwclass.run.plan.layout import Layout, check_features
from fwclass.run.plan.radiometry import radiometry_tasks
from fwclass.run.report import write_report
from fwclass.run.road import Road, ancestors, require_all, stop_if_nothing
from fwclass.run.survey import check_widths, gather
from fwclass.store.models import load_forest


def classification(config: Config, road: Road, tiles: frozenset[str] | None = None) -> dict[str, Any]:
    """Run all stages on `road` and write the report; return the report's dict.

    `tiles`: deliver only these tiles; what they need (their neighbours' echoes, the training areas) is made too, so
    that they come out as in a whole run.
    """
    model = _given_model(config)
    names = load_forest(model[0]).features if model else config.survey.features
    check_features(config, names, model[0] if model else f"{config.path}: survey.features")
    survey = gather(config, road)

    indexed = require_all(road, sources.index_tasks(config, survey.strips))
    chunks = sources.chunk_tasks(config, survey.strips, indexed)
    splits = road.do(chunks + sources.cloud_tasks(config, survey.reference))
    check_widths(config, names, splits, road.store)
    tiled = road.do(sources.tile_tasks(config, splits))
    stop_if_nothing(road, {name: receipt for name, receipt in tiled.items() if name[0] == "tile"})
    layout = Layout.of(config, tiled)

    labelled = config.survey.reference.kind != "none"
    tasks = ground.ground_tasks(layout) + of_tiles.feature_tasks(layout)
    tasks += radiometry_tasks(layout, survey)
    tasks += of_tiles.label_tasks(layout) if labelled else []
    tasks += [] if model else forest.training_tasks(layout)
    tasks += forest.classify_tasks(layout, names, model)
    tasks += forest.assess_tasks(layout, names) if labelled else []
    tasks += outputs.output_tasks(layout, names, survey, *sources.where(chunks, splits))
    tasks += ground.seam_tasks(layout)
    if tiles is not None:
        tasks = ancestors(tasks, _wanted(layout, tiles))
    road.do(tasks)
    if tiles is None and not road.failures:
        road.retire()
    return write_report(config, road, survey, layout, names)


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


def _given_model(config: Config) -> tuple[Path, str] | None:
    """Path and digest of the model that the configuration names, None where it is to be trained."""
    if config.survey.model is None:
        return None
    path = Path(config.survey.model)
    path = path if path.is_absolute() else (config.path.parent / path).resolve()
    return path, forest.digest_of_model(path)
