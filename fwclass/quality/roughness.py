"""Ranging noise of a strip: the spread of its heights about a plane, at the smoothest places that it sees."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import refuse_unsound

ROUGHEST = 10.0
"""m, above which a place is not flat in any sense."""

EDGES = 10.0 ** (np.arange(81) / 20.0)
"""mm, from 1 mm to 10 m, where classes of residuals begin; the first holds what is below too."""

LEAST = 50
"""Places from which on the smoothest tenth is told."""

ROUGH = 0.045
"""m of the smoothest tenth, from which it is said: 0.008 to 0.026 in seven public surveys, 0.038 at most in their woods
and without their buildings; 0.047 to 0.06 with noise of 0.05 m added, by which a ready model loses 2 to 4 points, 0.09
to 0.11 with 0.1 m, by which it loses 21 to 25. Where crowns hide all ground nothing is smooth either."""


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


def roughness_remarks(facts: Mapping[str, Any]) -> list[str]:
    """That not even the smoothest places are smooth."""
    if facts["smoothest"] is None or facts["smoothest"] < ROUGH:
        return []
    return [
        f"the smoothest tenth of {facts['places']:,} level places has a residual of up to {facts['smoothest']:.2f} m "
        "from its planes (roads and roofs of sound surveys: 0.01 to 0.03 m): heights are noisy or of several surfaces, "
        "or plants hide all ground; a model that learned from smoother heights takes ground for plants"
    ]


def judge_roughness(facts: Mapping[str, Any], most: float, accepted: bool, where: object) -> None:
    """`QualityError` where the smoothest places are rougher than `most` [m]; nothing where the user accepts it."""
    smoothest = facts["smoothest"] or 0.0
    refuse_unsound(
        [f"{smoothest:.3g} m in the smoothest tenth of {facts['places']:,} places"] if smoothest > most else [],
        accepted,
        "heights are too noisy for a model that learned elsewhere",
        where,
        expected=f"at most {most:g} m in the smoothest tenth of the level places (classify.max_rough)",
        do="mend ranges or trajectory, or train on labels of this survey",
        accept="--accept-drift (classify.accept_drift=true) takes the classes as they are",
    )
