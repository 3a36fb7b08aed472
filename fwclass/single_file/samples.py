"""The echoes of one file as a model sees them, block by block, so that the features of one block only are in memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass import conf
from fwclass.features.params import Asked, is_feature
from fwclass.features.stage import features
from fwclass.ground.blocks import blocks_of
from fwclass.model import Model, sample_matrix
from fwclass.schema import Table
from fwclass.stage import Chunk


@dataclass(frozen=True)
class Block:
    """A block of a file: `rows` int64, which rows of the file's table are its own, in the order of those of X, float32
    (rows, features) in the order of the model's; `chunk` has them as its core, and what lies around."""

    rows: NDArray[np.int64]
    chunk: Chunk
    X: NDArray[np.float32]


def samples(table: Table, model: Model, settings: tuple[str, ...], halo: float = 0.0) -> Iterator[Block]:
    """Blocks of `tile.size`, which changes no value, with all that lies as far around as the model's features reach,
    and at least `halo` [m]."""
    params, size = conf.section("features", settings), conf.section("tile", settings).size
    asked = Asked.of(n for n in model.features if is_feature(n))
    reach = max(halo, asked.halo(params) if asked.names else 0.0)
    for tile, rows, own in blocks_of(table["x"], table["y"], size, reach):
        rows = rows[order := np.lexsort((table["echo_number"][rows], table["pulse"][rows]))]
        chunk = Chunk(table.take(rows), np.flatnonzero(own[order]), tile)
        whole = chunk.table.take(chunk.core)
        if asked.names:
            whole = whole.with_columns(features(chunk, asked.names, params).select(asked.names))
        yield Block(rows[chunk.core], chunk, sample_matrix(whole, model.features, tile.key))
