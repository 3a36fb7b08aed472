"""The whole road: waveforms (or echoes) to classified, GIS-ready tiles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fwclass.conf import Config
from fwclass.run import plan
from fwclass.run.report import write_report
from fwclass.run.road import Road, require_all
from fwclass.run.survey import gather
from fwclass.store.models import load_forest


def classification(config: Config, road: Road, tiles: frozenset[str] | None = None) -> dict[str, Any]:
    """Run all stages on `road` and write the report; return the report's dict.

    `tiles` restricts the work after decomposition to these tiles and what they need.
    """
    survey = gather(config, road)
    model = _given_model(config)
    names = load_forest(model[0]).features if model else config.survey.features

    indexed = require_all(road, plan.index_tasks(config, survey.strips))
    chunks = plan.chunk_tasks(config, survey.strips, indexed)
    splits = road.do(chunks + plan.cloud_tasks(config, survey.reference))
    tiled = road.do(plan.tile_tasks(config, splits, tiles))
    base = plan.Ground.of(config, tiled)

    labelled = config.survey.reference.kind != "none"
    tasks = plan.surface_tasks(base) + plan.ground_tasks(base) + plan.feature_tasks(base)
    tasks += plan.label_tasks(base) if labelled else []
    tasks += [] if model else plan.training_tasks(base)
    tasks += plan.classify_tasks(base, names, model)
    tasks += plan.assess_tasks(base, names) if labelled else []
    whole = tiles is None
    tasks += plan.output_tasks(base, names, survey.strips if whole else (), survey.crs, *plan.where(chunks, splits))
    road.do(tasks)
    return write_report(config, road, survey, base, names)


def _given_model(config: Config) -> tuple[Path, str] | None:
    """Path and digest of the model that the configuration names, None where it is to be trained."""
    if config.survey.model is None:
        return None
    path = Path(config.survey.model)
    path = path if path.is_absolute() else (config.path.parent / path).resolve()
    return path, plan.digest_of_model(path)
