"""Exact geometric predicates on whole millimetres, as kernels without Python numbers.

Coordinates are whole numbers held in float64, at most 2^25 mm (33 km) apart (`SPAN`). Then every difference,
every product of two differences and every sum of two such products is a whole number up to 2^53: exact.
"""

from __future__ import annotations

import numpy as np

from fwclass.kernel import kernel

SPAN = 1 << 25
"""Greatest difference of two coordinates [mm] for which the predicates are exact."""

_EXACT = float(1 << 53)
_ROUNDING = 4.0 * 2.0**-53
_LIMB = 27
_LOW = (1 << _LIMB) - 1


@kernel
def orientation(ax, ay, bx, by, cx, cy):  # type: ignore[no-untyped-def]
    """Twice the signed area of a triangle [mm²]: positive where a, b, c turn left; exact, also for c in half mm."""
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


@kernel
def _exact_sign(l0, c0, l1, c1, l2, c2):  # type: ignore[no-untyped-def]
    """Sign of l0·c0 + l1·c1 + l2·c2, whole numbers up to 2^53, in limbs of 27 bits."""
    high = middle = low = np.int64(0)
    for lift, cross in ((l0, c0), (l1, c1), (l2, c2)):
        a, b = np.int64(lift), np.int64(cross)
        ah, al, bh, bl = a >> _LIMB, a & _LOW, b >> _LIMB, b & _LOW
        high += ah * bh
        middle += ah * bl + al * bh
        low += al * bl
    middle += low >> _LIMB
    high += middle >> _LIMB
    if high != 0:
        return np.int64(1) if high > 0 else np.int64(-1)
    return np.int64(1) if (middle & _LOW) | (low & _LOW) else np.int64(0)


@kernel
def circle_sign(ax, ay, bx, by, cx, cy, px, py):  # type: ignore[no-untyped-def]
    """1 where p [mm, whole] lies inside the circle through a, b, c (turning left), -1 outside, 0 on it.

    Only the three products and the two sums of the last step round, each by at most 2^-53 of the sum of
    magnitudes; below 2^53 they do not round at all. What is left is decided in whole numbers.
    """
    adx, ady, bdx, bdy, cdx, cdy = ax - px, ay - py, bx - px, by - py, cx - px, cy - py
    lift_a, lift_b, lift_c = adx * adx + ady * ady, bdx * bdx + bdy * bdy, cdx * cdx + cdy * cdy
    of_a, of_b, of_c = bdx * cdy - bdy * cdx, cdx * ady - cdy * adx, adx * bdy - ady * bdx
    ta, tb, tc = lift_a * of_a, lift_b * of_b, lift_c * of_c
    det = ta + tb + tc
    size = abs(ta) + abs(tb) + abs(tc)
    if abs(det) > _ROUNDING * size or size < _EXACT:
        return np.int64(det > 0.0) - np.int64(det < 0.0)
    return _exact_sign(lift_a, of_a, lift_b, of_b, lift_c, of_c)


@kernel
def _after(ax, ay, bx, by):  # type: ignore[no-untyped-def]
    return ax > bx or (ax == bx and ay > by)


@kernel
def in_circle(ax, ay, bx, by, cx, cy, px, py):  # type: ignore[no-untyped-def]
    """bool: p lies in the circle of the left-turning a, b, c; four points on one circle are decided too.
    Coordinates are whole millimetres.

    As if every point were lifted from the paraboloid by an amount that grows beyond all bounds with its
    place in the order by x, then y (Devillers and Teillaud 2011): the triangulation is unique, and the same
    wherever the origin is and whatever else is triangulated.
    """
    sign = circle_sign(ax, ay, bx, by, cx, cy, px, py)
    if sign != 0:
        return sign > 0
    last, lx, ly = 3, px, py
    if _after(ax, ay, lx, ly):
        last, lx, ly = 0, ax, ay
    if _after(bx, by, lx, ly):
        last, lx, ly = 1, bx, by
    if _after(cx, cy, lx, ly):
        last = 2
    if last == 3:
        return False
    if last == 2:
        return orientation(ax, ay, bx, by, px, py) > 0.0
    if last == 1:
        return orientation(cx, cy, ax, ay, px, py) > 0.0
    return orientation(bx, by, cx, cy, px, py) > 0.0
