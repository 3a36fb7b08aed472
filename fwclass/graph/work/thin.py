"""Work of the parts of a thinned run: the sample, its features, and every echo's class from its nearest sampled one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.classify.stage import classify, filled
from fwclass.features.params import FeaturesParams
from fwclass.features.stage import features
from fwclass.graph.work.forest import model_of
from fwclass.grid import Tile
from fwclass.model import sample_matrix
from fwclass.run.inputs import TABLE, PartInputs
from fwclass.schema import Table, column
from fwclass.stage import Chunk
from fwclass.store.remote_file import Location
from fwclass.store.tables import write_table
from fwclass.thin.follow import follow
from fwclass.thin.params import ThinParams
from fwclass.thin.sample import thin

_PLACE = dict.fromkeys(("x", "y", "z"), "tile")


def thinned(
    tile: Tile, halo: float, present: tuple[str, ...], params: ThinParams, inputs: PartInputs, directory: Path
) -> dict[str, Any]:
    """Which echoes of a tile are sampled."""
    table = thin(inputs.chunk(tile, halo, _PLACE, present), params)
    write_table(directory / TABLE, table)
    return {"rows": table.rows, "sampled": int(table["sampled"].sum())}


def features_of_some(chunk: Chunk, sampled: NDArray[np.bool_], names: tuple[str, ...], params: FeaturesParams) -> Table:
    """Features of the sampled core rows in their whole neighbourhoods, NaN for the others; normals of all of them,
    which radiometry takes."""
    normals = features(chunk, (), params)
    some = features(Chunk(chunk.table, chunk.core[sampled], chunk.tile), names, params)
    made = {}
    for name in names:
        values = np.full(len(chunk.core), np.nan, column(name).dtype)
        values[sampled] = some[name]
        made[name] = values
    return Table({**made, **normals})


def classified(
    tile: Tile,
    columns: Mapping[str, str],
    present: tuple[str, ...],
    model: tuple[Location, str] | None,
    probabilities: bool,
    reach: float,
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """As `forest.classified`, for a thinned run: the model is asked about sampled echoes, in the halo too, and every
    other echo takes the answer to its nearest one."""
    chunk = inputs.chunk(tile, reach, {**_PLACE, **columns, "sampled": "thin"}, present)
    rows = np.flatnonzero(chunk.table["sampled"])
    some = chunk.table.take(rows)
    used = model_of(model, inputs)
    X = sample_matrix(some, used.features, tile.key)
    answer = classify(X, used, probabilities)
    core = chunk.table.take(chunk.core)
    own = core["sampled"]
    near = np.searchsorted(rows, chunk.core)
    others = tuple(core[n][~own] for n in _PLACE)
    near[~own] = follow((others[0], others[1], others[2]), (some["x"], some["y"], some["z"]), reach)
    table = answer.take(near)
    write_table(directory / TABLE, table)
    codes, counts = np.unique(table["classification"], return_counts=True)
    found = {str(c): int(n) for c, n in zip(codes.tolist(), counts.tolist(), strict=True)}
    return {"codes": found, "filled": filled(X, used), "asked": int(own.sum())}
