"""Work of the parts of tiles between ground and training: labels, features."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.features.dense import Crowd, crowd_facts
from fwclass.features.params import FeaturesParams
from fwclass.features.stage import features
from fwclass.graph.work.thin import features_of_some
from fwclass.grid import Tile
from fwclass.label.stage import LabelParams, from_cloud, from_source
from fwclass.run.inputs import TABLE, PartInputs
from fwclass.schema import Table
from fwclass.stage import Chunk
from fwclass.store.cells import CELLS, by_place
from fwclass.store.tables import write_table

_CLOUD = ("x", "y", "z", "gps_time", "source_class")


def featured(
    tile: Tile,
    halo: float,
    columns: Mapping[str, str],
    present: tuple[str, ...],
    names: tuple[str, ...],
    params: FeaturesParams,
    thins: bool,
    inputs: PartInputs,
    directory: Path,
) -> dict[str, Any]:
    """Neighbourhood features of a tile's echoes; of a thinned run's, of the sampled ones."""
    sampled = inputs.rows(tile.key, {"sampled": "thin"})["sampled"] if thins else None
    tables, places, rows, crowds = [], [], [], []
    for these, chunk in inputs.chunks(tile, halo, columns, present):
        some = None if sampled is None else sampled[these]
        made = features(chunk, names, params) if some is None else features_of_some(chunk, some, names, params)
        tables.append(made)
        places.append(chunk.table.select(("x", "y")).take(chunk.core))
        rows.append(these)
        crowds.append(crowd_facts(chunk, params))
    made, place = (_joined(pieces, rows) for pieces in (tables, places))
    write_table(directory / TABLE, made)
    crowded = Crowd.of_parts(crowds)
    return {CELLS: by_place(made, place["x"], place["y"])} | ({"dense": crowded.told()} if crowded else {})


def _joined(pieces: list[Table], rows: list[NDArray[np.int64]]) -> Table:
    """A tile's rows in their order, from pieces of which each has `rows`."""
    if len(pieces) == 1:
        return pieces[0]
    return Table.concat(pieces).take(np.argsort(np.concatenate(rows), kind="stable"))


def labelled_by_source(tile: Tile, params: LabelParams, inputs: PartInputs, directory: Path) -> dict[str, Any]:
    """Reference classes from the source's own classification."""
    chunk = inputs.chunk(tile, 0.0, {"source_class": "tile"}, (tile.key,))
    return write_labels(from_source(chunk, params), directory)


def labelled_by_cloud(
    tile: Tile, clouds: tuple[str, ...], params: LabelParams, inputs: PartInputs, directory: Path
) -> dict[str, Any]:
    """Reference classes from the nearest point of another cloud."""
    chunk: Chunk = inputs.chunk(tile, 0.0, dict.fromkeys(("x", "y", "z", "gps_time"), "tile"), (tile.key,))
    box = tile.box.grown(params.max_distance)
    cloud = inputs.inside(box, tile.size, dict.fromkeys(_CLOUD, "reference"), clouds, base="reference")
    order = np.lexsort(tuple(cloud[n] for n in ("source_class", "gps_time", "z", "y", "x")))
    return write_labels(from_cloud(chunk, cloud.take(order), params), directory)


def write_labels(table: Table, directory: Path) -> dict[str, Any]:
    write_table(directory / TABLE, table)
    codes, counts = np.unique(table["reference"], return_counts=True)
    return {"codes": {str(c): int(n) for c, n in zip(codes.tolist(), counts.tolist(), strict=True)}}
