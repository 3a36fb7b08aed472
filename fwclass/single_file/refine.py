"""The second layer's answers for the echoes of one file."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.classify.refine import BOUNDARY, COARSE, at_boundary, refine_boundary
from fwclass.classify.stage import count_filled, probability_columns
from fwclass.features.params import Asked, FeaturesParams, is_feature
from fwclass.features.stage import features
from fwclass.ground.blocks import blocks_of
from fwclass.model import TwoLayer, sample_matrix
from fwclass.schema import Table
from fwclass.single_file.ground.steps import Tell
from fwclass.stage import Chunk

Answers = dict[str, NDArray]


def refine(
    table: Table, coarse: Answers, model: TwoLayer, params: FeaturesParams, size: float, tell: Tell
) -> tuple[Answers, dict[str, Any]]:
    """What both layers say of every echo, from what the first one said (`coarse`, columns of `classify`); and how many
    echoes are at the boundary, and of how many values the medians stand for.

    Block by block of edge `size` [m], as the first layer.
    """
    columns = dict(zip(COARSE, (coarse[n] for n in ("classification", "confidence", "entropy")), strict=True))
    table = table.with_columns(Table(columns))
    asked = Asked.of(n for n in model.fine.features if is_feature(n))
    answers = {name: values.copy() for name, values in coarse.items()}
    shares = probability_columns(model.codes)
    count = gaps = 0
    for tile, rows, own in blocks_of(table["x"], table["y"], size, max(model.within, asked.halo(params))):
        tell(f"boundary: {count:,} echoes")
        rows = rows[order := np.lexsort((table["echo_number"][rows], table["pulse"][rows]))]
        near, core = table.take(rows), np.flatnonzero(own[order])
        at = at_boundary(Chunk(near, core, tile), model.pair, model.within)
        if not at.any():
            continue
        core = core[at]
        some = near.take(core)
        if asked.names:
            some = some.with_columns(features(Chunk(near, core, tile), asked.names, params).select(asked.names))
        X = sample_matrix(some, model.fine.features, tile.key)
        some = some.with_columns(Table({BOUNDARY: np.ones(len(core), bool)}))
        before = Table({n: coarse[n][rows[core]] for n in shares}) if shares[0] in coarse else None
        for name, values in refine_boundary(some, X, model, before).items():
            answers[name][rows[core]] = values
        count, gaps = count + len(core), gaps + count_filled(X, model.fine)
    return answers, {"boundary": count, "filled": gaps}
