"""The level of a body of water by the ground along its shore, and whether it has one."""

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
    """What the shore of a body of water tells.

    Attributes
    ----------
    echoes : ground echoes at its shore.
    level : [m]; None where they are too few.
    lowest, highest : levels of its pieces of shore, a tenth and nine tenths of them [m].
    level_enough : it is flattened.
    """

    echoes: int
    level: float | None
    lowest: float | None
    highest: float | None
    level_enough: bool

    def facts(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self)


def level_of(stretch: NDArray[np.int64], z: NDArray[np.float64], params: WaterParams) -> Body:
    """The level of one body from the pieces of shore and the heights [m] of its echoes, in any order.

    It is the lower quantile of all heights: banks rise behind the shoreline and nothing lies beneath it. A piece of
    shore with fewer than `params.least` echoes tells nothing of itself.
    """
    if len(z) < params.least:
        return Body(len(z), None, None, None, False)
    order = np.lexsort((z, stretch))
    pieces = np.split(z[order], np.flatnonzero(np.diff(stretch[order])) + 1)
    own = [float(np.quantile(piece, params.quantile)) for piece in pieces if len(piece) >= params.least]
    level = float(np.quantile(np.sort(z), params.quantile))
    low, high = (float(v) for v in np.quantile(own or [level], BETWEEN))
    return Body(len(z), level, low, high, high - low <= params.most_spread)
