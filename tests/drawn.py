"""Selections as the page sends them, and blocks and marks as it reads them."""

from __future__ import annotations

import zlib
from typing import Any

import numpy as np

from fwclass.view.blocks import HEAD, MARKS
from fwclass.view.scene import ECHOES

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


def marked(data: bytes) -> dict[tuple[int, int, int], dict[int, int]]:
    """By node: row in its block, and the byte."""
    at, out = 0, {}
    while at < len(data):
        *node, count = MARKS.unpack_from(data, at)
        rows = np.frombuffer(data, "<u4", count, at + 16)
        values = np.frombuffer(data, np.uint8, count, at + 16 + 4 * count)
        out.setdefault(tuple(node), {}).update(zip(rows.tolist(), values.tolist(), strict=True))
        at += 16 + 4 * count + -(-count // 4) * 4
    assert at == len(data)
    return out


def drawn_classes(scene: Any) -> dict[tuple[int, int, int], list[int]]:
    """Classes in every block, as the page gets them."""
    out = {}
    for level in scene.pyramid.levels():
        data, at = scene.level(ECHOES, level), 0
        while at < len(data):
            size, a, b, c, n, *_ = HEAD.unpack_from(data, at)
            planes = zlib.decompress(data[at + HEAD.size : at + HEAD.size + size])
            out[a, b, c], at = list(planes[10 * n : 11 * n]), at + HEAD.size + size
    return out
