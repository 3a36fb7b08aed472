"""How rough a strip sees the smoothest places: the noise of its ranges, which nothing flat is smoother than."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

ROUGHEST = 10.0
"""m, above which a place is not flat in any sense."""

EDGES = 10.0 ** (np.arange(81) / 20.0)
"""mm, from 1 mm to 10 m, where classes of residuals begin; the first holds what is below too."""

LEAST = 50
"""Places from which on the smoothest tenth is told."""

ROUGH = 0.1
"""m of the smoothest tenth, from which it is said: 0.008 to 0.026 in seven public surveys, 0.05 to 0.1 with noise of
0.1 m added, 0.23 to 0.48 with 0.5 m. Where crowns hide all ground nothing is smooth either."""


def count_roughness(residual: NDArray[np.float64]) -> NDArray[np.int64]:
    """int64 (81,): planes by classes of their residual [mm], (planes,)."""
    kind = np.clip(np.searchsorted(EDGES, residual, "right") - 1, 0, len(EDGES) - 1)
    return np.bincount(kind, minlength=len(EDGES)).astype(np.int64)


def roughness_facts(counts: NDArray[np.int64]) -> dict[str, Any]:
    """``places`` that were looked at, and the root mean square residual of the ``smoothest`` tenth at most and of the
    ``median`` place [m], None for fewer than `LEAST`; `counts` as `count_roughness` gives them, of all blocks."""
    places = int(counts.sum())

    def quantile(share: float) -> float | None:
        if places < LEAST:
            return None
        kind = int(np.searchsorted(np.cumsum(counts), share * places))
        return float(EDGES[kind] * 10 ** (1 / 40)) / 1000

    return {"places": places, "smoothest": quantile(0.1), "median": quantile(0.5)}


def roughness_remarks(facts: dict[str, Any]) -> list[str]:
    """That not even the smoothest places are smooth."""
    if facts["smoothest"] is None or facts["smoothest"] < ROUGH:
        return []
    return [
        f"the smoothest tenth of {facts['places']:,} level places has a residual of up to {facts['smoothest']:.2f} m "
        "from its planes (roads and roofs of sound surveys: 0.01 to 0.03 m): heights are noisy or of several surfaces, "
        "or crowns hide all ground"
    ]
