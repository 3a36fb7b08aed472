"""Selections as the page sends them."""

from __future__ import annotations

from typing import Any

import numpy as np

FROM_ABOVE = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1]
"""x and y as they are, whatever the height."""


def drawn(points: Any, about: Any = (0.0, 0.0, 0.0), **named: Any) -> dict[str, Any]:
    """What was drawn around `points`, from above unless `matrix` is given, and no filter unless named."""
    return {
        "about": [float(v) for v in about],
        "matrix": FROM_ABOVE,
        "depth": None,
        "points": np.asarray(points, float).tolist(),
        "radius": 0,
        "slab": None,
        "classes": list(range(256)),
        "confidence": None,
        "height": None,
    } | named


def box(x0: float, y0: float, x1: float, y1: float) -> list[list[float]]:
    """Corners of a rectangle."""
    return [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]
