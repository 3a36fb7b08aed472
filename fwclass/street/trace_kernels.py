"""Beams of a scanner through a simulated street."""

from __future__ import annotations

import math

import numpy as np

from fwclass.kernel import inlined, kernel

BOX, PILLAR, CLUMP, CAPSULE = 0, 1, 2, 3
"""Kinds of solids. A row is kind, class, first and last x, then: box y, y, z, z, share of beams it stops; pillar x, y,
radius, z, z; clump x, y, z, radius, mean free path; capsule x, y, z, x, y, z, radius."""

PART = 11
GROUND_CLASS, ROAD_CLASS = 2, 11


@inlined
def _next(state):  # type: ignore[no-untyped-def]
    """Xorshift64*, Vigna 2016."""
    state ^= state >> np.uint64(12)
    state ^= state << np.uint64(25)
    state ^= state >> np.uint64(27)
    return state


@inlined
def _share(state):  # type: ignore[no-untyped-def]
    """A number in (0, 1) from the generator's state."""
    return (np.float64((state * np.uint64(2685821657736338717)) >> np.uint64(11)) + 0.5) / 9007199254740992.0


@kernel
def _box(s, ox, oy, oz, dx, dy, dz, most):  # type: ignore[no-untyped-def]
    low, high = 1e-3, most
    for at, way, a, b in ((ox, dx, s[2], s[3]), (oy, dy, s[4], s[5]), (oz, dz, s[6], s[7])):
        if abs(way) < 1e-12:
            if at < a or at > b:
                return most
            continue
        first, last = (a - at) / way, (b - at) / way
        if first > last:
            first, last = last, first
        low, high = max(low, first), min(high, last)
        if low > high:
            return most
    return low


@kernel
def _pillar(s, ox, oy, oz, dx, dy, dz, most):  # type: ignore[no-untyped-def]
    px, py = ox - s[4], oy - s[5]
    a, b, c = dx * dx + dy * dy, px * dx + py * dy, px * px + py * py - s[6] * s[6]
    if a < 1e-12:
        return most
    inner = b * b - a * c
    if inner <= 0:
        return most
    t = (-b - math.sqrt(inner)) / a
    z = oz + t * dz
    return t if 1e-3 < t < most and s[7] <= z <= s[8] else most


@kernel
def _capsule(s, ox, oy, oz, dx, dy, dz, most):  # type: ignore[no-untyped-def]
    """Nearest approach of beam and axis; good for thin ones."""
    ux, uy, uz = s[7] - s[4], s[8] - s[5], s[9] - s[6]
    wx, wy, wz = ox - s[4], oy - s[5], oz - s[6]
    b, c = dx * ux + dy * uy + dz * uz, ux * ux + uy * uy + uz * uz
    d, e = dx * wx + dy * wy + dz * wz, ux * wx + uy * wy + uz * wz
    under = c - b * b
    along = min(max((e - b * d) / under if under > 1e-12 else 0.0, 0.0), 1.0)
    t = along * b - d
    gx, gy, gz = wx + t * dx - along * ux, wy + t * dy - along * uy, wz + t * dz - along * uz
    apart = s[10] * s[10] - (gx * gx + gy * gy + gz * gz)
    t -= math.sqrt(max(apart, 0.0))
    return t if apart >= 0 and 1e-3 < t < most else most


@kernel
def _beam(solids, near, ox, oy, oz, dx, dy, dz, lean, kerb, rise, most, state):  # type: ignore[no-untyped-def]
    """(range, class) of what a beam meets first; `most` and 0 where it meets nothing."""
    best, label = most, 0
    level = dz - lean * dy
    if abs(level) > 1e-9:  # the road, then the ground behind the kerb
        t = -(oz - lean * oy) / level
        if 1e-3 < t < best and abs(oy + t * dy) < kerb:
            best, label = t, ROAD_CLASS
        t = (rise - (oz - lean * oy)) / level
        if 1e-3 < t < best and abs(oy + t * dy) >= kerb:
            best, label = t, GROUND_CLASS
        if abs(dy) > 1e-9:
            t = ((kerb if dy > 0 else -kerb) - oy) / dy
            z = oz + t * dz - lean * (oy + t * dy)
            if 1e-3 < t < best and 0 <= z <= rise:
                best, label = t, GROUND_CLASS
    for k in near:
        s = solids[k]
        kind = int(s[0])
        if kind == CLUMP:
            px, py, pz = ox - s[4], oy - s[5], oz - s[6]
            b = px * dx + py * dy + pz * dz
            inner = b * b - (px * px + py * py + pz * pz - s[7] * s[7])
            if inner <= 0 or -b - math.sqrt(inner) >= best or -b + math.sqrt(inner) <= 0:
                continue
            state = _next(state)
            t = max(-b - math.sqrt(inner), 0.0) - s[8] * math.log(_share(state))
            if t < min(best, -b + math.sqrt(inner)):
                best, label = t, int(s[1])
            continue
        if kind == BOX:
            t = _box(s, ox, oy, oz, dx, dy, dz, best)
            if t < best and s[8] < 1:
                state = _next(state)
                if _share(state) > s[8]:
                    continue
        elif kind == PILLAR:
            t = _pillar(s, ox, oy, oz, dx, dy, dz, best)
        else:
            t = _capsule(s, ox, oy, oz, dx, dy, dz, best)
        if t < best:
            best, label = t, int(s[1])
    return best, label


@kernel
def trace(  # type: ignore[no-untyped-def]
    solids,
    near,
    x,
    height,
    angles,
    side,
    roll,
    pitch,
    lean,
    kerb,
    rise,
    spot,
    noise,
    missing,
    most,
    seeds,
    ranges,
    labels,
):
    """Ranges and labels of one scan of the street.

    Parameters
    ----------
    solids : float64 (n, PART). near : int64, those that the scan may meet.
    x, height : of the scanner [m]. angles : float64 (beams,) [rad]; side : 1 looks left, −1 right.
    roll, pitch : of the vehicle [rad]. lean, kerb, rise : of the ground across the road, see `_beam`.
    spot : width of a beam [rad]. noise : of a range [m]. missing : share of lost returns. most : range [m].
    seeds : uint64 (beams,), not 0. ranges : float32, labels : uint8 (beams,), filled; NaN and 0 without a return.
    """
    for j in range(len(angles)):
        state = _next(seeds[j])
        hit, kind = most, 0
        other, besides = most, 0
        for look in range(2):  # the middle of the spot, and a place near its rim
            turn = angles[j] + roll + (0.5 * spot * (2.0 * _share(state) - 1.0) if look else 0.0)
            dy, dz = side * math.cos(turn), math.sin(turn)
            dx, dz = math.sin(pitch) * dz, math.cos(pitch) * dz
            state = _next(state)
            t, label = _beam(solids, near, x, 0.0, height, dx, dy, dz, lean, kerb, rise, most, state)
            if look:
                other, besides = t, label
            else:
                hit, kind = t, label
        state = _next(_next(state))
        if kind and besides and 0.05 < abs(hit - other) < 2.0 and _share(state) < 0.3:  # a mixed pixel
            state = _next(state)
            weight = _share(state)
            mixed = weight * hit + (1.0 - weight) * other
            kind = kind if weight >= 0.5 else besides
            hit = mixed
        state = _next(state)
        lost = _share(state) < missing
        state = _next(state)
        far = math.sqrt(-2.0 * math.log(_share(state)))
        state = _next(state)
        if kind == 0 or lost:
            ranges[j], labels[j] = np.nan, 0
        else:
            ranges[j] = hit + noise * far * math.cos(2.0 * math.pi * _share(state))
            labels[j] = kind
