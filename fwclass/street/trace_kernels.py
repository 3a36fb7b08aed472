"""Beams of a scanner through a simulated street."""

from __future__ import annotations

import math

import numpy as np

from fwclass.kernel import inlined, kernel

BOX, PILLAR, CLUMP, CAPSULE = 0, 1, 2, 3
"""Kinds of solids. A row is kind, class, first and last x, then: box y, y, z, z, share of beams it stops; pillar x, y,
radius, z, z; clump x, y, z, radius, mean free path; capsule x, y, z, x, y, z, radius. Last stands the reflectance."""

PART = 12
GROUND_CLASS, ROAD_CLASS = 2, 11
_ROAD, _GROUND, _KERB = -1, -2, -3
"""In place of a solid's row."""

ROAD_SHINE, GROUND_SHINE = 0.15, 0.3
"""Reflectances of asphalt and of paving, about, in the near infrared."""

LEAF = 0.3
"""Share of a spot that a leaf fills at least; the rest of the beam goes on."""

GRAIN = 0.1
"""An intensity is off by as much at most: speckle, and the scanner's own."""


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
    """(range, class, row of the solid) of what a beam meets first; `most`, 0 and 0 where it meets nothing."""
    best, label, row = most, 0, 0
    level = dz - lean * dy
    if abs(level) > 1e-9:  # the road, then the ground behind the kerb
        t = -(oz - lean * oy) / level
        if 1e-3 < t < best and abs(oy + t * dy) < kerb:
            best, label, row = t, ROAD_CLASS, _ROAD
        t = (rise - (oz - lean * oy)) / level
        if 1e-3 < t < best and abs(oy + t * dy) >= kerb:
            best, label, row = t, GROUND_CLASS, _GROUND
        if abs(dy) > 1e-9:
            t = ((kerb if dy > 0 else -kerb) - oy) / dy
            z = oz + t * dz - lean * (oy + t * dy)
            if 1e-3 < t < best and 0 <= z <= rise:
                best, label, row = t, GROUND_CLASS, _KERB
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
                best, label, row = t, int(s[1]), k
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
            best, label, row = t, int(s[1]), k
    return best, label, row


@kernel
def _face(s, x, y, z, dx, dy, dz):  # type: ignore[no-untyped-def]
    """Cosine of incidence on the face of a box that (x, y, z) lies on."""
    off, cosine = 1e9, 1.0
    for at, way, a, b in ((x, dx, s[2], s[3]), (y, dy, s[4], s[5]), (z, dz, s[6], s[7])):
        away = min(abs(at - a), abs(at - b))
        if away < off:
            off, cosine = away, abs(way)
    return cosine


@kernel
def _shine(solids, row, x, y, z, dx, dy, dz, lean, state):  # type: ignore[no-untyped-def]
    """Share of what a white wall sends back from (x, y, z) in the direction (dx, dy, dz), seen head on: reflectance
    times cosine of incidence (Lambert), of a leaf that hangs anyhow and fills a part of the spot."""
    if row < 0:
        flat = abs(dz - lean * dy) / math.sqrt(1.0 + lean * lean)
        return (ROAD_SHINE if row == _ROAD else GROUND_SHINE) * (abs(dy) if row == _KERB else flat)
    s = solids[row]
    kind = int(s[0])
    if kind == CLUMP:
        state = _next(state)
        cosine = math.sqrt(_share(state))  # what faces the beam is met more often
        state = _next(state)
        cosine *= LEAF + (1.0 - LEAF) * _share(state)
    elif kind == BOX:
        cosine = _face(s, x, y, z, dx, dy, dz)
    elif kind == PILLAR:
        cosine = abs(dx * (x - s[4]) + dy * (y - s[5])) / s[6]
    else:
        ux, uy, uz = s[7] - s[4], s[8] - s[5], s[9] - s[6]
        px, py, pz = x - s[4], y - s[5], z - s[6]
        along = min(max((px * ux + py * uy + pz * uz) / max(ux * ux + uy * uy + uz * uz, 1e-12), 0.0), 1.0)
        px, py, pz = px - along * ux, py - along * uy, pz - along * uz  # away from the axis
        cosine = abs(dx * px + dy * py + dz * pz) / max(math.sqrt(px * px + py * py + pz * pz), 1e-9)
    return s[PART - 1] * min(cosine, 1.0)


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
    light,
):
    """Ranges and labels of one scan of the street.

    Parameters
    ----------
    solids : float64 (n, PART). near : int64, those that the scan may meet.
    x, height : of the scanner [m]. angles : float64 (beams,) [rad]; side : 1 looks left, −1 right.
    roll, pitch : of the vehicle [rad]. lean, kerb, rise : of the ground across the road, see `_beam`.
    spot : width of a beam [rad]. noise : of a range [m]. missing : share of lost returns. most : range [m].
    seeds : uint64 (beams,), not 0. ranges : float32, labels : uint8 (beams,), filled; NaN and 0 without a return.
    light : float32 (beams,), filled with shares of what a white wall would send back, NaN without a return; range does
        not matter, as scanners make up for it. Or None; ranges and labels are the same.
    """
    for j in range(len(angles)):
        state = _next(seeds[j])
        glow = seeds[j] ^ np.uint64(0x9E3779B97F4A7C15)  # numbers of their own
        hit, kind, shine = most, 0, 0.0
        other, besides, beyond = most, 0, 0.0
        for look in range(2):  # the middle of the spot, and a place near its rim
            turn = angles[j] + roll + (0.5 * spot * (2.0 * _share(state) - 1.0) if look else 0.0)
            dy, dz = side * math.cos(turn), math.sin(turn)
            dx, dz = math.sin(pitch) * dz, math.cos(pitch) * dz
            state = _next(state)
            t, label, row = _beam(solids, near, x, 0.0, height, dx, dy, dz, lean, kerb, rise, most, state)
            sent = 0.0
            if light is not None:
                glow = _next(_next(_next(glow)))
                if label:
                    sent = _shine(solids, row, x + t * dx, t * dy, height + t * dz, dx, dy, dz, lean, glow)
            if look:
                other, besides, beyond = t, label, sent
            else:
                hit, kind, shine = t, label, sent
        state = _next(_next(state))
        if kind and besides and 0.05 < abs(hit - other) < 2.0 and _share(state) < 0.3:  # a mixed pixel
            state = _next(state)
            weight = _share(state)
            mixed = weight * hit + (1.0 - weight) * other
            kind = kind if weight >= 0.5 else besides
            hit, shine = mixed, weight * shine + (1.0 - weight) * beyond
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
        if light is not None:
            glow = _next(glow)
            light[j] = ranges[j] if kind == 0 or lost else shine * (1.0 + GRAIN * (2.0 * _share(glow) - 1.0))
