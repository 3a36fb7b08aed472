"""What sets of features cost: processor time per echo, measured on a tile of the survey."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from fwclass.features.names import FeatureRequest, is_feature
from fwclass.features.params import FeaturesParams
from fwclass.features.stage import FEATURE_COMPUTATION, features
from fwclass.graph.key_values import plain_values
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import StageInputs
from fwclass.grid import Tile
from fwclass.run.runner import Runner, require_all
from fwclass.select.score import Names
from fwclass.select.work import scale_of
from fwclass.stage import Chunk
from fwclass.store.atomic import digest_of

SINGLE = 30
"""Sets up to this size are timed without each of their features too; in a larger one a feature is lost in the noise."""


def computed_names(names: Sequence[str]) -> Names:
    """Those of `names` that are computed from a neighbourhood; the others are measured or made for all surveys."""
    return tuple(n for n in names if is_feature(n))


def costs(runner: Runner, plan: Plan, tile: Tile, sets: Sequence[Names]) -> dict[Names, float]:
    """Microseconds of processor time per echo for the computed features of every set, the normals included."""
    wanted = tuple(dict.fromkeys(computed_names(s) for s in sets))
    select = plan.config.select
    stage = on_tile(
        TIME_SETS,
        plan,
        tile,
        tuple(dict.fromkeys(n for s in wanted for n in s)),
        {"sets": wanted, "repeats": select.timing_repeats, "echoes": select.timing_echoes},
    )
    (task,) = stage.tasks(plan)
    meta = require_all(runner, [task])[task.name].meta
    by_set = dict(zip(wanted, meta["microseconds"], strict=True))
    return {s: by_set[computed_names(s)] for s in sets}


def on_tile(stage: Stage, plan: Plan, tile: Tile, names: Names, more: Mapping[str, Any]) -> Stage:
    """`stage`, which takes the time of features, of one part: on the echoes of `tile` and its neighbours, as far as
    `names` reach; the part is named by all that it is asked for."""
    around = _with_noise(plan)
    halo = FeatureRequest.of(names).halo(around)
    arguments = {"params": around, "tile": tile, "halo": halo, **more}
    near = plan.layout.around(tile.box.grown(halo), plan.layout.keys)
    return replace(
        stage,
        parts=lambda plan: (digest_of(plain_values(arguments, stage.silent))[:16],),
        number=None,
        arguments=lambda plan: arguments,
        reads=tuple(FeatureRequest.of(names).columns(around)),
        tiles=lambda plan: [t for t in plan.layout.tiles if t.key in near],
    )


def _with_noise(plan: Plan) -> FeaturesParams:
    """Settings of features that leave no echo out, as candidates may need no filter of noise."""
    params: FeaturesParams = plan.config.features
    return params.model_copy(update={"noise_counts": True})


def time_sets(
    here: StageInputs,
    params: FeaturesParams,
    tile: Tile,
    halo: float,
    sets: tuple[Names, ...],
    repeats: int,
    echoes: int,
) -> dict[str, Any]:
    """Processor time of every set [us per echo]."""
    whole = here.inputs.chunk(tile, halo, here.columns, here.present)
    chunk = Chunk(whole.table, whole.core[:echoes], tile)
    micro = microseconds([partial(features, chunk, names, params) for names in sets], repeats, len(chunk.core))
    return {"microseconds": micro, "echoes": len(chunk.core)}


def microseconds(works: Sequence[Callable[[], object]], repeats: int, echoes: int) -> list[float]:
    """Medians of the processor time per echo over `repeats` runs of `works`, in turn, after one that is not counted."""
    seconds = np.zeros((repeats + 1, len(works)))
    for turn in seconds:
        for k, work in enumerate(works):
            began = time.process_time()
            work()
            turn[k] = time.process_time() - began
    medians = np.median(seconds[1:], axis=0) / max(1, echoes) * 1e6
    return [round(v, 3) for v in medians.tolist()]


def parts_of(chosen: Names) -> tuple[dict[str, Names], dict[str, Names], dict[str, Names]]:
    """Sets to time for the cost of parts of `chosen`: without each scale, each scale alone, without each feature."""
    scales = {str(s): s for s in map(scale_of, computed_names(chosen)) if s is not None}
    without = {t: tuple(n for n in chosen if scale_of(n) != s) for t, s in scales.items()}
    alone = {t: tuple(n for n in chosen if scale_of(n) == s) for t, s in scales.items()}
    named = computed_names(chosen) if len(chosen) <= SINGLE else ()
    less = {name: tuple(n for n in chosen if n != name) for name in named}
    return without, alone, less


TIME_SETS = Stage(
    "select-cost",
    FEATURE_COMPUTATION.version,
    "survey",
    "part",
    time_sets,
    parts=lambda plan: (),
    number=lambda plan: 1,
    silent=frozenset({"also"}),
    reads=lambda plan: tuple(FeatureRequest.of(computed_names(plan.names)).columns(_with_noise(plan))),
)
"""See `on_tile`."""
