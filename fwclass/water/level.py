"""The level of a body of water by its own echoes or by the ground along its shore, and whether it has one."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.water.params import WaterParams

BETWEEN = (0.1, 0.9)
"""Shares of the pieces of a shore that are held against each other; a mole or a weir is not the lake."""


@dataclass(frozen=True)
class Body:
    """What the shore and the echoes of a body of water tell.

    Attributes
    ----------
    echoes : ground echoes at its shore.
    inside : ground echoes in it, further from its shore.
    level : [m]; of its own echoes where they are enough, else of the shore; None where neither are.
    shore_level, inside_level : by either [m]; None where the echoes are too few.
    lowest, highest : levels of its pieces of shore, a tenth and nine tenths of them [m]; of its own echoes where no
        shore tells; None where neither do.
    level_enough : it is flattened.
    """

    echoes: int
    inside: int
    level: float | None
    shore_level: float | None
    inside_level: float | None
    lowest: float | None
    highest: float | None
    level_enough: bool

    def facts(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self)


def level_of(
    stretch: NDArray[np.int64],
    z: NDArray[np.float64],
    heights: NDArray[np.int64],
    counts: NDArray[np.int64],
    params: WaterParams,
) -> Body:
    """The level of one body, from the pieces of shore and the heights `z` [m] of the echoes there, and how many echoes
    in it (`counts`) lie at which `heights` [mm]; all in any order.

    Its own echoes tell by their median, and without a shore by their spread whether it is level. A shore
    tells by the lower quantile of its heights: banks rise behind the shoreline. A piece of shore with fewer than
    `params.least` echoes tells nothing of itself. What is higher inside than at its shore, by more than
    `params.most_spread`, is no water.
    """
    inside, own_level = int(counts.sum()), None
    low = high = None
    if inside >= params.least:
        order = np.argsort(heights, kind="stable")
        ranks = np.ceil(inside * np.array([BETWEEN[0], 0.5, BETWEEN[1]]))
        at = order[np.searchsorted(np.cumsum(counts[order]), ranks)]
        low, own_level, high = (heights[at] / 1000).tolist()
    if len(z) < params.least:
        flat = low is not None and high is not None and high - low <= params.most_spread
        return Body(len(z), inside, own_level, None, own_level, low, high, flat)
    order = np.lexsort((z, stretch))
    pieces = np.split(z[order], np.flatnonzero(np.diff(stretch[order])) + 1)
    own = [float(np.quantile(piece, params.quantile)) for piece in pieces if len(piece) >= params.least]
    shore = float(np.quantile(np.sort(z), params.quantile))
    low, high = (float(v) for v in np.quantile(own or [shore], BETWEEN))
    flat = high - low <= params.most_spread and (own_level is None or own_level - shore <= params.most_spread)
    return Body(len(z), inside, shore if own_level is None else own_level, shore, own_level, low, high, flat)
