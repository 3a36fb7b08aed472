"""How the strips of blocks lie to each other, block by block: what a report tells of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Tile, Window
from fwclass.quality.block import BORDERS, LOWS, pairs_from, pieces_from
from fwclass.quality.offsets import slopes_from
from fwclass.quality.params import QualityParams
from fwclass.quality.pieces import Pieces, strips_of
from fwclass.quality.roughness import EDGES, roughness_facts
from fwclass.quality.steps import HeightSteps, told_steps
from fwclass.quality.strips import By, Comparison, lifted_strips, numbers_of, stepped_borders, strips_by

PIECES = tuple(Pieces.__dataclass_fields__)

Read = Callable[[str, tuple[str, ...] | None], Mapping[str, NDArray]]
"""Gives the arrays of `BlockQuality.arrays` of a block, by its key: those that are named, or all."""


def compare_strips(
    blocks: Sequence[Tile], read: Read, counts: tuple[int, ...], params: QualityParams, files: Mapping[int, str]
) -> tuple[dict[str, Any], dict[str, NDArray[np.int64]]]:
    """What the strips are like (``quality.strips`` of docs/report.schema.json; heights and steps [m], None where
    nothing tells), and the strip of every block's pieces, int64 (pieces,) by key.

    `counts`: pairs of planes of all blocks, those between files, and those between lines of one file. `files`: names
    by number.
    """
    pieces = [pieces_from(read(b.key, PIECES)) for b in blocks]
    by = strips_by(params.strips, *counts[1:])
    numbers = numbers_of(pieces, by)
    strips = strips_of(pieces, [(b.box.xmin, b.box.ymin) for b in blocks], numbers, params.line_gap)
    compared, borders, lows = Comparison(params.planes, counts[0]), [], []
    rough = np.zeros(len(EDGES), np.int64)
    by_files, by_lines, beside = (HeightSteps(params.planes.max_step) for _ in range(3))
    lines = numbers_of(pieces, "times")
    for b, piece, number, line in zip(blocks, pieces, numbers, lines, strict=True):
        window = Window.covering(b.box, params.planes.cell)
        arrays = read(b.key, None)
        pairs = pairs_from(arrays)
        by_files.add_pairs(pairs, piece.file)
        by_lines.add_pairs(pairs, line)
        compared.add(pairs, slopes_from(arrays), number, (window.col, window.row))
        borders.append([arrays[name] for name in BORDERS])
        lows.append((arrays[LOWS[0]], arrays[LOWS[1]], arrays[LOWS[2]]))
        rough += arrays["roughness"]
    first, second, step = (np.concatenate(some) for some in zip(*borders, strict=True))
    stepped = stepped_borders(first, second, step, files, params.planes.max_step)
    beside.add(first, second, step)
    named = {k: f"line {k + 1}" for k in range(1 + max((int(n.max()) for n in lines if len(n)), default=0))}
    steps = told_steps(
        {
            ("files", "overlap"): (by_files, files),
            ("files", "border"): (beside, files),
            ("times", "overlap"): (by_lines, named),
        }
    )
    ways: tuple[By, ...] = ("files", "times")
    lifted = [{"by": way, **one} for way in ways for one in lifted_strips(lows, numbers_of(pieces, way))]
    facts = compared.facts(strips, files, by) | {"borders": stepped, "lifted": lifted, "steps": steps}
    facts["roughness"] = roughness_facts(rough)
    return facts, {b.key: n for b, n in zip(blocks, numbers, strict=True)}
