"""What sets of features cost: processor time per echo, measured on a tile of the survey."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fwclass.features.names import Asked, is_feature
from fwclass.features.params import FeaturesParams
from fwclass.features.stage import FEATURE_COMPUTATION, features
from fwclass.grid import Tile
from fwclass.run.inputs import PartInputs
from fwclass.run.part import Task
from fwclass.run.runner import Runner, require_all
from fwclass.select.score import Names
from fwclass.select.work import scale_of
from fwclass.stage import Chunk
from fwclass.store.atomic import digest_of
from fwclass.study.keys import needs_of, plain
from fwclass.survey.layout import Layout

SINGLE = 30
"""Sets up to this size are timed without each of their features too; in a larger one a feature is lost in the noise."""

COST = "select-cost"
"""Stage; the part is named by what it timed."""


def computed_names(names: Sequence[str]) -> Names:
    """Those of `names` that are computed from a neighbourhood; the others are measured or made for all surveys."""
    return tuple(n for n in names if is_feature(n))


def costs(runner: Runner, layout: Layout, tile: Tile, sets: Sequence[Names]) -> dict[Names, float]:
    """Microseconds of processor time per echo for the computed features of every set, the normals included."""
    wanted = tuple(dict.fromkeys(computed_names(s) for s in sets))
    config = layout.config
    asked = Asked.of(n for s in wanted for n in s)
    around = config.features.model_copy(update={"noise_counts": True})  # candidates may need no filter of it
    halo = asked.halo(around)
    columns = layout.columns(asked.columns(around))
    present = layout.around(tile.box.grown(halo), layout.keys)
    params = {
        **around.model_dump(mode="json", exclude={"also"}),
        "tile": tile.key,
        "sets": [list(s) for s in wanted],
        "repeats": config.select.timing_repeats,
        "echoes": config.select.timing_echoes,
    }
    work = partial(
        time_sets,
        tile,
        halo,
        columns,
        present,
        wanted,
        around,
        config.select.timing_repeats,
        config.select.timing_echoes,
    )
    name = digest_of(plain(config.select) | params)[:16]
    task = Task(COST, name, FEATURE_COMPUTATION.version, params, work, needs=needs_of(columns, present))
    meta = require_all(runner, [task])[task.name].meta
    by_set = dict(zip(wanted, meta["microseconds"], strict=True))
    return {s: by_set[computed_names(s)] for s in sets}


def time_sets(
    tile: Tile,
    halo: float,
    columns: Mapping[str, str],
    present: tuple[str, ...],
    sets: tuple[Names, ...],
    params: FeaturesParams,
    repeats: int,
    echoes: int,
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """Processor time of every set [us per echo]."""
    whole = inputs.chunk(tile, halo, columns, present)
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
