"""What both layers of a model that decides in context say of the echoes of one file."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass import conf
from fwclass.classify.context import coarse_share_columns, context_of, halo_of, with_context
from fwclass.classify.stage import classify
from fwclass.model import Contextual
from fwclass.schema import Table
from fwclass.single_file.ground.steps import Tell
from fwclass.single_file.samples import samples


def answer_in_context(
    table: Table, shares: NDArray[np.uint8], model: Contextual, settings: tuple[str, ...], tell: Tell
) -> dict[str, NDArray]:
    """Columns of `classify` for every row of `table`, from the first layer's `shares` (rows, classes) in 255ths.

    Features are computed once more rather than kept: they take thirty times the room of the shares.
    """
    columns = coarse_share_columns(model.codes)
    table = table.with_columns(Table(dict(zip(columns, shares.T, strict=True))))
    probabilities = conf.section("classify", settings).probabilities
    results: dict[str, NDArray] = {}
    count = 0
    for block in samples(table, model.coarse, settings, halo_of(model.cells)):
        tell(f"context: {count:,} of {table.rows:,} echoes")
        context = context_of(block.chunk.table, block.chunk.core, columns, model.cells)
        for name, values in classify(with_context(block.X, context), model, probabilities).items():
            results.setdefault(name, np.empty(table.rows, values.dtype))[block.rows] = values
        count += len(block.rows)
    return results
