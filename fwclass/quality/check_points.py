"""A survey's heights against check points that were surveyed on the ground, as mapping standards ask."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from fwclass.grid import millimetres
from fwclass.units import SIGMA_PER_MAD

Floats = NDArray[np.float64]

VEGETATED = (3, 4, 5)
"""Class codes of check points under plants (LAS 1.4: low, medium, high vegetation)."""

CHECKED = ("given", "repeated", "blunders", "nearest_echo", "all", "open", "vegetated")
"""Figures of `facts_of`."""

FAR_OFF = 1.0
"""m, least distance of a blunder from the others' median: ten times what surveys of any class are off."""

LISTED = 10
"""Blunders that are told one by one."""

FEWEST = 30
"""Check points that a statement of accuracy stands on (ASPRS Positional Accuracy Standards 2023, 7.11)."""

SHIFTED = 3.0
"""Standard errors of the mean above which all heights are shifted, and are said to be."""

NEAREST = 32
"""Ground echoes around a point that are triangulated first: its triangle is nearly always among theirs."""

ANOTHER_DATUM = 1.0
"""m; no survey is so far off in the mean, but heights above an ellipsoid or in feet are."""


def ground_heights(
    points: tuple[Floats, Floats], ground: tuple[Floats, Floats, Floats], reach: float
) -> tuple[Floats, Floats]:
    """Height of the ground at points in plan, and how far the nearest ground echo is, both (n,) in m.

    The height is that of the Delaunay triangle of the ground echoes within `reach` [m] around the point, by a straight
    plane; NaN where no triangle holds it. Of echoes at one place the lowest counts, so that the order of the
    echoes, and what lies beyond, changes nothing.

    Parameters
    ----------
    points : x and y of the points, each (n,) [m].
    ground : x, y and z of the ground echoes, each (m,) [m].
    """
    height, near = np.full(len(points[0]), np.nan), np.full(len(points[0]), np.nan)
    x, y = (millimetres(c) for c in ground[:2])
    order = np.lexsort((ground[2], y, x))
    x, y, z = x[order], y[order], ground[2][order]
    lowest = np.ones(len(x), bool)
    lowest[1:] = (np.diff(x) != 0) | (np.diff(y) != 0)
    x, y, z = x[lowest], y[lowest], z[lowest]
    far = round(1000.0 * reach)
    for k, (px, py) in enumerate(zip(*(millimetres(c).tolist() for c in points), strict=True)):
        first, last = np.searchsorted(x, (px - far, px + far + 1))
        dx, dy = x[first:last] - px, y[first:last] - py
        square = dx * dx + dy * dy
        inside = np.flatnonzero(square <= far * far)
        if len(inside):
            near[k] = math.sqrt(int(square[inside].min())) / 1000.0
            height[k] = _of_triangle(dx[inside], dy[inside], z[first:last][inside])
    return height, near


def _of_triangle(dx: NDArray[np.int64], dy: NDArray[np.int64], z: Floats) -> float:
    """Height at the origin of the Delaunay triangle of places [mm] that holds it; NaN where none does.

    The nearest are triangulated first: a triangle whose circumcircle lies within what they fill is one of all.
    """
    square = dx * dx + dy * dy
    order = np.lexsort((dy, dx, square))
    dx, dy, z, square = dx[order], dy[order], z[order], square[order]
    if square[0] == 0:
        return float(z[0])
    for count in (NEAREST, 4 * NEAREST, len(z)):
        some = min(count, len(z))
        corners = _holding(dx[:some], dy[:some])
        if some == len(z) or (corners is not None and _circle(dx[corners], dy[corners]) < math.sqrt(square[some])):
            break
    return math.nan if corners is None else _plane(dx[corners], dy[corners], z[corners])


def _holding(dx: NDArray[np.int64], dy: NDArray[np.int64]) -> NDArray[np.int64] | None:
    """Rows of the corners of the Delaunay triangle that holds the origin, decided in whole numbers; None for none."""
    if len(dx) < 3:
        return None
    try:
        triangles = scipy.spatial.Delaunay(np.stack([dx, dy], axis=1).astype(np.float64)).simplices
    except scipy.spatial.QhullError:  # all on one line
        return None
    x, y = dx[triangles], dy[triangles]
    side = x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y  # twice the area with the origin, by edge
    holds = ((side >= 0).all(axis=1) | (side <= 0).all(axis=1)) & (side.sum(axis=1) != 0)
    rows = np.flatnonzero(holds)
    return np.asarray(triangles[rows[0]], np.int64) if len(rows) else None


def _circle(x: NDArray[np.int64], y: NDArray[np.int64]) -> float:
    """How far from the origin the circumcircle of a triangle reaches."""
    ax, ay, bx, by = (float(v) for v in (x[1] - x[0], y[1] - y[0], x[2] - x[0], y[2] - y[0]))
    twice, a, b = 2.0 * (ax * by - ay * bx), ax * ax + ay * ay, bx * bx + by * by
    cx, cy = (by * a - ay * b) / twice, (ax * b - bx * a) / twice
    return math.hypot(cx + float(x[0]), cy + float(y[0])) + math.hypot(cx, cy)


def _plane(x: NDArray[np.int64], y: NDArray[np.int64], z: Floats) -> float:
    """Height at the origin of the plane through three points."""
    side = (x * np.roll(y, -1) - np.roll(x, -1) * y).astype(np.float64)
    return float(side @ np.roll(z, 1) / side.sum())


def height_facts(dz: Floats, code: NDArray[np.integer]) -> dict[str, Any]:
    """Figures of the differences in height, survey less check point (n,) [m], NaN where there is none: of ``all``, of
    ``open`` land and of what is ``vegetated`` by its class `code` (n,), -1 for none. None without a point."""
    known, plants = np.isfinite(dz), np.isin(code, VEGETATED)
    return {
        name: _figures(dz[known & which]) if (known & which).any() else None
        for name, which in (("all", np.ones(len(dz), bool)), ("open", ~plants), ("vegetated", plants))
    }


def _figures(dz: Floats) -> dict[str, Any]:
    n, rmse = len(dz), math.sqrt(float((dz**2).mean()))
    low, high = (rmse * math.sqrt(n / float(scipy.special.chdtri(n, p))) for p in (0.025, 0.975))
    return {
        "count": n,
        "mean": float(dz.mean()),
        "sd": float(dz.std(ddof=1)) if n > 1 else None,
        "rmse": rmse,
        "rmse_interval": [low, high],
        "accuracy_95": 1.96 * rmse,
        "percentile_95": float(np.quantile(np.abs(dz), 0.95)),
        "lowest": float(dz.min()),
        "highest": float(dz.max()),
    }


def check_remarks(facts: Mapping[str, Any], reach: float) -> list[str]:
    """What a reader has to know of ``check_points``, as `deliver` writes them; ground counts within `reach` [m]."""
    lines, figures, given = list[str](), facts["all"], facts["given"]
    compared = 0 if figures is None else figures["count"]
    if compared < given:
        lines.append(
            f"{given - compared} of {given} check points are not compared: no ground echoes around them within "
            f"quality.check_points.reach ({reach:g} m)"
        )
    if figures is None:
        return lines
    if compared < FEWEST:
        lines.append(
            f"{compared} check points tell little of a survey's accuracy: the ASPRS standards ask for {FEWEST}"
        )
    if facts["repeated"]:
        lines.append(
            f"{facts['repeated']} of {given} check points are there twice: they count twice, and intervals are too "
            "narrow"
        )
    if blunders := facts["blunders"]["points"]:
        x, y, z, dz = blunders[0]
        lines.append(
            f"{facts['blunders']['count']} check points lie far off the others, as that of height {z:g} m at "
            f"{x:.3f}, {y:.3f} ({dz:+.2f} m): they are in all figures; look for wrong heights or codes of no data"
        )
    if shifted := _shifted(figures):
        lines.append(shifted)
    return lines


def of_another_datum(facts: Mapping[str, Any] | None) -> list[str]:
    """That the heights of ``check_points`` are of another system than the survey's; nothing where they are not."""
    figures = facts and facts["all"]
    return [_shifted(figures)] if figures and abs(figures["mean"]) > ANOTHER_DATUM and _shifted(figures) else []


def check_words(facts: Mapping[str, Any]) -> str:
    """How many check points were compared, and how far the survey is off, in a line."""
    figures = facts["all"]
    if figures is None:
        return f"none of {facts['given']:,} has ground echoes around it"
    low, high = figures["rmse_interval"]
    return (
        f"{figures['count']:,} of {facts['given']:,}: RMSEz {figures['rmse']:.3f} m ({low:.3f} to {high:.3f}), "
        f"mean {figures['mean']:+.3f} m"
    )


def _shifted(figures: Mapping[str, Any]) -> str:
    """That the survey lies above or below the check points by more than chance explains; "" where it does not."""
    mean, sd, compared = figures["mean"], figures["sd"] or 0.0, figures["count"]
    if compared <= 2 or abs(mean) <= max(SHIFTED * sd / math.sqrt(compared), 0.5 * figures["rmse"]):
        return ""
    side = "above" if mean > 0.0 else "below"
    kind = ": are both heights of one kind (geoid or ellipsoid, metres)?" if abs(mean) > ANOTHER_DATUM else ""
    return f"the survey lies {abs(mean):.2f} m {side} the check points on average, more than chance explains{kind}"


def compared_points(points: Mapping[str, NDArray]) -> dict[str, NDArray | list[str]]:
    """Columns of a layer of check points: heights of point and ground, their difference, and the distance to the
    nearest ground echo, each (n,) [m] and NaN where there is none, the class code, -1 for none, and names if points
    have any, uint8 (n, bytes)."""
    names = [row.tobytes().rstrip(b"\0").decode(errors="ignore") for row in points.get("name", ())]
    return {
        **({"name": names} if names else {}),
        "z": points["z"],
        "ground_z": points["height"],
        "dz": points["height"] - points["z"],
        "nearest_echo": points["near"],
        "class_code": points["code"],
    }


def facts_of(points: Sequence[Floats], height: Floats, near: Floats, code: NDArray[np.integer]) -> dict[str, Any]:
    """The part ``check_points`` of the survey's quality: how many are `given`, how many of them ``repeated``, and their
    figures; ``blunders`` are [x, y, z, difference] of those far off the others, the furthest first."""
    dz = height - points[2]
    xyz = np.stack(points, axis=1)
    repeated = len(dz) - len(np.unique(xyz, axis=0))
    off = np.flatnonzero(_far_off(dz))
    off = off[np.argsort(-np.abs(dz[off]), kind="stable")]
    blunders = [[*xyz[k].tolist(), float(dz[k])] for k in off[:LISTED].tolist()]
    facts = {"given": len(dz), "repeated": repeated, "blunders": {"count": len(off), "points": blunders}}
    return {**facts, "nearest_echo": _median(near), **height_facts(dz, code)}


def _far_off(dz: Floats) -> NDArray[np.bool_]:
    """bool (n,): the difference [m] is further from the median than `FAR_OFF`, and than six robust standard deviations
    of all."""
    finite = dz[np.isfinite(dz)]
    if len(finite) < 3:
        return np.zeros(len(dz), bool)
    middle = np.median(finite)
    spread = SIGMA_PER_MAD * float(np.median(np.abs(finite - middle)))
    return np.isfinite(dz) & (np.abs(dz - middle) > max(FAR_OFF, 6.0 * spread))


def _median(values: Floats) -> float | None:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if len(finite) else None
