"""A dry run: the files that the fullest tiles and the training areas lie in, and these tiles to their reports."""

from __future__ import annotations

import glob
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fwclass.conf import Config
from fwclass.errors import ConfigError, InputError
from fwclass.graph.stages import STAGES
from fwclass.grid import Box
from fwclass.operate.estimate.forecast import Forecast
from fwclass.read.source import open_source
from fwclass.run.runner import Runner
from fwclass.store.remote_file import local
from fwclass.store.url import Url
from fwclass.survey.files import find_files, joint_bounds
from fwclass.survey.gather import directory_of
from fwclass.walk.steps import plan_with_features, until_report, until_tiles
from fwclass.walk.workflow import after_tiles
from fwclass.workflows import workflow_of


@dataclass(frozen=True)
class TrialSurvey:
    """A survey cut down to what a dry run needs.

    Attributes
    ----------
    config : its configuration, the whole survey's with fewer files.
    boxes : the fullest tiles by the headers [m].
    left : bounds of the files left out [m]: a tile near one of them is not whole.
    files : sources that remain.
    """

    config: Config
    boxes: tuple[Box, ...]
    left: tuple[Box, ...]
    files: int


def trial_of(forecast: Forecast, count: int, root: Path) -> TrialSurvey:
    """The files that hold the `count` fullest tiles with all that is read around them, and the training areas.

    `ConfigError`: the survey is not simulated yet: there is no file to run.
    """
    if forecast.facts.simulated:
        raise ConfigError(
            "a dry run needs the survey's files, and they are still to be simulated",
            where="--dry-run",
            do="fwclass simulate CONF --out DIR, then plan with --set survey.directory=DIR",
        )
    config = forecast.config
    boxes = tuple(t.box for t in forecast.tiles.heaviest(count))
    areas = [b.grown(reach(forecast)) for b in (*boxes, *(_training(config)))]
    sources = forecast.facts.sources
    touching = [s for s in sources if any(s.bounds.touches(b) for b in areas)]
    left = tuple(s.bounds for s in sources if s not in touching)
    directory = directory_of(config, root)
    if isinstance(directory, Url):
        raise ConfigError(
            "a dry run takes files of this host",
            where="--dry-run",
            got=directory,
            do="plan without --dry-run, or copy the survey to a disk first",
        )
    names = tuple(glob.escape(str(s.path)) for s in touching)
    change: dict[str, Any] = {"directory": str(directory), "sources": names, "exclude": ()}
    reference = config.survey.reference
    if reference.kind == "cloud":
        change["reference"] = reference.model_copy(update={"files": _clouds(config, directory, areas)})
    cut = replace(
        config,
        survey=config.survey.model_copy(update=change),
        simulate=None,
        areas=config.areas.model_copy(update={"test": ()}),  # they may lie in files left out, and nothing is assessed
    )
    return TrialSurvey(cut, boxes, left, len(touching))


def reach(forecast: Forecast) -> float:
    """The furthest that the road to a tile's classes reads around it [m]: its own halo, and its blocks with theirs."""
    begun = forecast.begun
    blocks = (s.edge(begun) + s.reach(begun) for s in STAGES if s.edge is not None and s.unit == "echo")
    return forecast.halo + max(blocks)


def whole_tiles(keys: Sequence[str], boxes: Sequence[Box], left: Sequence[Box], halo: float) -> list[str]:
    """The tiles, as `keys` with their `boxes`, that no file that was `left` out comes nearer than `halo` [m]."""
    return [k for k, box in zip(keys, boxes, strict=True) if not any(b.touches(box.grown(halo)) for b in left)]


def _training(config: Config) -> tuple[Box, ...]:
    return () if config.survey.model is not None else config.areas.boxes("train")


def _clouds(config: Config, directory: Path, wanted: Sequence[Box]) -> tuple[str, ...]:
    files = find_files(config.survey.reference.files, directory, "survey.reference.files", config.path, config.store)
    near = [
        p
        for p in files
        if any(joint_bounds([open_source(local(p)).bounds]).grown(config.label.max_distance).touches(b) for b in wanted)
    ]
    return tuple(glob.escape(str(p)) for p in near or files)


def run_trial(job: TrialSurvey, runner: Runner, count: int, halo: float) -> tuple[str, ...]:
    """Run the `count` tiles with most echoes of those that are whole; return their keys, the fullest first."""
    config: Config = job.config
    plan = until_tiles(plan_with_features(config), runner)
    tiles = plan.layout.tiles
    whole = whole_tiles([t.key for t in tiles], [t.box for t in tiles], job.left, halo)
    if not whole:
        raise InputError(
            "no tile of the dry run is whole",
            where="--dry-run",
            got=f"{len(tiles)} tiles at the edges of its files",
            do="--dry-run with more tiles, or smaller tile.size",
        )
    chosen = tuple(sorted(whole, key=lambda key: (-runner.store.rows("tile", key), key))[:count])
    until_report(plan, runner, after_tiles(workflow_of("classification").stages), frozenset(chosen))
    return chosen
