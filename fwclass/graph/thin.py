"""The stage of a thinned run (Xiong 2018): which echoes are sampled, and features of those alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.conf import Config
from fwclass.features.params import FeaturesParams
from fwclass.features.stage import features
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.schema import Table, column
from fwclass.stage import Chunk
from fwclass.thin.params import ThinParams
from fwclass.thin.sample import THIN, thin


def thins(config: Config) -> bool:
    """Whether only a share of the echoes is classified."""
    return config.thin.rate < 1.0


def sampled_columns(plan: Plan) -> tuple[str, ...]:
    """The column that says which echoes count; nothing where all do."""
    return THIN.writes if thins(plan.config) else ()


def sample_tile(here: StageInputs, params: ThinParams) -> Result:
    """Which echoes of a tile are sampled."""
    table = thin(here.chunk(), params)
    return table, {"rows": table.rows, "sampled": int(table["sampled"].sum())}


def features_of_some(chunk: Chunk, sampled: NDArray[np.bool_], names: tuple[str, ...], params: FeaturesParams) -> Table:
    """Features of the sampled core rows in their whole neighbourhoods, NaN for the others; normals of all of them,
    which radiometry takes."""
    normals = features(chunk, (), params)
    some = features(Chunk(chunk.table, chunk.core[sampled], chunk.tile), names, params)
    columns = {}
    for name in names:
        values = np.full(len(chunk.core), np.nan, column(name).dtype)
        values[sampled] = some[name]
        columns[name] = values
    return Table({**columns, **normals})


THIN_ECHOES = Stage(
    THIN.name,
    THIN.version,
    "tile",
    "echo",
    sample_tile,
    when=lambda plan: thins(plan.config),
    arguments=lambda plan: {"params": plan.config.thin},
    reads=THIN.reads,
    writes=THIN.writes,
    halo=lambda plan: THIN.halo(plan.config.thin),
)
