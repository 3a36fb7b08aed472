"""Where the sub-rays of a pulse end: terrain, convex solids, and leaves met by chance on the way."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fwclass.kernel import kernel
from fwclass.simulate.foliage import HERB_ALBEDO, herb, leaf
from fwclass.simulate.noise import NORMAL_SHIFT, draw, uniform
from fwclass.simulate.scene import GROUND, HIGH, LOW, MEDIUM, WATER, terrain

MAX_CANDIDATES = 96
"""Things that one pulse can be tested against; more are ignored."""

PER_RAY = 256
"""Random numbers set aside for one sub-ray: one per candidate, then those of the surface."""

FOOTPRINT = 0.45
"""Half-width by which boxes grow in the search along the central ray; more than any footprint's radius [m]."""


def footprint(rings: tuple[int, ...]) -> NDArray[np.float64]:
    """Sub-rays of a Gaussian beam: (rays, 3) as offset x, y in units of the 1/e² radius, and weight (sum 1).

    Ring k holds ``rings[k]`` rays; a ray stands for its share of the ring's area times exp(−2 r²).
    """
    reach = 1.15
    radii = np.linspace(0.0, reach, len(rings)) if len(rings) > 1 else np.zeros(1)
    middles = (radii[1:] + radii[:-1]) / 2.0
    edges = (
        np.concatenate([[0.0], middles, [reach + (reach - middles[-1])]]) if len(rings) > 1 else np.array([0.0, 1.0])
    )
    rays = []
    for k, count in enumerate(rings):
        weight = (edges[k + 1] ** 2 - edges[k] ** 2) / count * math.exp(-2.0 * radii[k] ** 2)
        for a in range(count):
            turn = 2.0 * math.pi * a / count + 0.4 * k
            rays.append((radii[k] * math.cos(turn), radii[k] * math.sin(turn), weight))
    table: NDArray[np.float64] = np.array(rays, np.float64)
    table[:, 2] /= table[:, 2].sum()
    return table


@kernel
def to_ground(height, margin, step, ox, oy, oz, dx, dy, dz, t, rounds):  # type: ignore[no-untyped-def]
    """Distance along a downward ray to the terrain, from a guess `t`, by fixed-point steps [m]."""
    for _ in range(rounds):
        change = (oz + t * dz - terrain(height, margin, step, ox + t * dx, oy + t * dy)) / -dz
        t += change
        if abs(change) < 5e-4:
            break
    return t


@kernel
def _slab(low, high, origin, direction, t0, t1):  # type: ignore[no-untyped-def]
    """The part of [t0, t1] in which a coordinate lies between `low` and `high`; empty if t0 > t1."""
    if abs(direction) < 1e-12:
        if low <= origin <= high:
            return t0, t1
        return 1.0, 0.0
    a, b = (low - origin) / direction, (high - origin) / direction
    if a > b:
        a, b = b, a
    return max(t0, a), min(t1, b)


@kernel
def _through(box, b, pad, ox, oy, oz, dx, dy, dz, far):  # type: ignore[no-untyped-def]
    """The part of [0, far] in which the ray is in box `b` grown by `pad`."""
    t0, t1 = _slab(box[b, 0] - pad, box[b, 3] + pad, ox, dx, 0.0, far)
    t0, t1 = _slab(box[b, 1] - pad, box[b, 4] + pad, oy, dy, t0, t1)
    return _slab(box[b, 2] - pad, box[b, 5] + pad, oz, dz, t0, t1)


@kernel
def gather(size, cell, start, item, ceiling, box, ox, oy, oz, dx, dy, dz, ground, out):  # type: ignore[no-untyped-def]
    """Write to `out` (room,) the things near the central ray above its ground hit, at `ground` [m] from (ox, oy, oz)
    [m]; returns how many."""
    side = int(math.ceil(size / cell))
    gx, gy, gz = ox + ground * dx, oy + ground * dy, oz + ground * dz
    i = min(max(int(gy / cell), 0), side - 1)
    j = min(max(int(gx / cell), 0), side - 1)
    top = ceiling[i * side + j]
    if top < gz - 0.5:
        return 0
    back = (top - gz + 1.0) / -dz
    sx, sy = gx - back * dx, gy - back * dy
    j0 = min(max(int((min(gx, sx) - FOOTPRINT) / cell), 0), side - 1)
    j1 = min(max(int((max(gx, sx) + FOOTPRINT) / cell), 0), side - 1)
    i0 = min(max(int((min(gy, sy) - FOOTPRINT) / cell), 0), side - 1)
    i1 = min(max(int((max(gy, sy) + FOOTPRINT) / cell), 0), side - 1)
    count = 0
    for i in range(i0, i1 + 1):
        for j in range(j0, j1 + 1):
            for k in range(start[i * side + j], start[i * side + j + 1]):
                thing = item[k]
                t0, t1 = _through(box, thing, FOOTPRINT, ox, oy, oz, dx, dy, dz, ground + 2.0)
                if t0 > t1:
                    continue
                known = count == MAX_CANDIDATES
                for c in range(count):
                    known = known or out[c] == thing
                if not known:
                    out[count] = thing
                    count += 1
    return count


@kernel
def _solid(plane_start, planes, s, ox, oy, oz, dx, dy, dz, far):  # type: ignore[no-untyped-def]
    """Distance to solid `s` and cosine of incidence there; `far` and 0 if the ray does not meet it before."""
    enter, leave, cosine = 0.0, far, 0.0
    for p in range(plane_start[s], plane_start[s + 1]):
        nx, ny, nz, d = planes[p, 0], planes[p, 1], planes[p, 2], planes[p, 3]
        slope = nx * dx + ny * dy + nz * dz
        above = d - (nx * ox + ny * oy + nz * oz)
        if abs(slope) < 1e-12:
            if above < 0.0:
                return far, 0.0
            continue
        t = above / slope
        if slope < 0.0:
            if t > enter:
                enter, cosine = t, -slope
        elif t < leave:
            leave = t
        if enter >= leave:
            return far, 0.0
    return (enter, cosine) if cosine > 0.0 else (far, 0.0)


@kernel
def _ray(  # type: ignore[no-untyped-def]
    plane_start,
    planes,
    solid_open,
    crown,
    clump,
    stream,
    box,
    key,
    first,
    candidates,
    count,
    ox,
    oy,
    oz,
    dx,
    dy,
    dz,
    far,
):
    """First thing that one sub-ray meets before `far`: (distance, thing or -1, cosine)."""
    solids = len(solid_open)
    best, what, cosine = far, -1, 0.0
    for c in range(count):
        thing = candidates[c]
        if thing < solids:
            t, cos = _solid(plane_start, planes, thing, ox, oy, oz, dx, dy, dz, best)
            if t < best and not uniform(key, first + c) < solid_open[thing]:
                best, what, cosine = t, thing, cos
    for c in range(count):
        thing = candidates[c]
        if thing >= solids:
            t0, t1 = _through(box, thing, 0.0, ox, oy, oz, dx, dy, dz, best)
            if t0 < t1:
                depth = -math.log(uniform(key, first + c))
                t = leaf(crown, clump, stream, thing - solids, ox, oy, oz, dx, dy, dz, t0, t1, depth)
                if t < t1:
                    best, what = t, thing
                    cosine = math.sqrt(0.05 + 0.95 * uniform(key, first + MAX_CANDIDATES + c))
    return best, what, cosine


@kernel
def _frame(dx, dy, dz):  # type: ignore[no-untyped-def]
    """Two unit vectors that stand on the beam and on each other."""
    length = math.sqrt(1.0 - dx * dx)
    ax, ay, az = length, -dx * dy / length, -dx * dz / length
    return ax, ay, az, dy * az - dz * ay, dz * ax - dx * az, dx * ay - dy * ax


@kernel
def trace(scene, rays, radius, normal, key, o, d, candidates, hit_range, hit_energy, hit_class):  # type: ignore[no-untyped-def]
    """Hits of one pulse from `o` along the unit vector `d`; returns their number.

    `rays` is a `footprint`, `radius` the 1/e² half-angle of the beam [rad]. An energy is weight × reflectance ×
    cosine / range²; a class is a code of the reference. Water gives nothing.
    """
    ox, oy, oz, dx, dy, dz = o[0], o[1], o[2], d[0], d[1], d[2]
    height, margin, step = scene.height, scene.margin, scene.step
    ground = to_ground(height, margin, step, ox, oy, oz, dx, dy, dz, oz / -dz, 25)
    count = gather(
        scene.size,
        scene.cell,
        scene.start,
        scene.item,
        scene.ceiling,
        scene.box,
        ox,
        oy,
        oz,
        dx,
        dy,
        dz,
        ground,
        candidates,
    )
    plane_start, planes, solid_open, box = scene.plane_start, scene.planes, scene.solid_open, scene.box
    crown, clump, stream = scene.crown, scene.clump, scene.key
    covers, albedo, herbs, roughness = scene.cover, scene.albedo, scene.herbs, scene.roughness
    gx, gy = ox + ground * dx, oy + ground * dy
    sx = 2.0 * (terrain(height, margin, step, gx + 0.25, gy) - terrain(height, margin, step, gx - 0.25, gy))
    sy = 2.0 * (terrain(height, margin, step, gx, gy + 0.25) - terrain(height, margin, step, gx, gy - 0.25))
    ground_cosine = max(-(dz - sx * dx - sy * dy) / math.sqrt(1.0 + sx * sx + sy * sy), 0.05)
    ax, ay, az, bx, by, bz = _frame(dx, dy, dz)
    solids = len(scene.solid_class)
    hits = 0
    for k in range(len(rays)):
        u, v = rays[k, 0] * radius, rays[k, 1] * radius
        rx, ry, rz = dx + u * ax + v * bx, dy + u * ay + v * by, dz + u * az + v * bz
        long = math.sqrt(rx * rx + ry * ry + rz * rz)
        rx, ry, rz = rx / long, ry / long, rz / long
        far = to_ground(height, margin, step, ox, oy, oz, rx, ry, rz, ground, 6)
        first = k * PER_RAY
        best, what, cosine = far, -1, 0.0
        if count:
            best, what, cosine = _ray(
                plane_start,
                planes,
                solid_open,
                crown,
                clump,
                stream,
                box,
                key,
                first,
                candidates,
                count,
                ox,
                oy,
                oz,
                rx,
                ry,
                rz,
                far,
            )
        if what < 0:
            i = min(max(int(oy + far * ry + margin), 0), covers.shape[0] - 1)
            j = min(max(int(ox + far * rx + margin), 0), covers.shape[1] - 1)
            cover = covers[i, j]
            if cover == WATER:
                continue
            bump = normal[draw(key, first + PER_RAY - 1) >> NORMAL_SHIFT] * roughness[cover]
            cosine, reflectance, code = ground_cosine, float(albedo[i, j]), GROUND
            if herbs[i, j] > 0.0:
                best = herb(stream, key, first + PER_RAY - 2, herbs[i, j], ox + far * rx, oy + far * ry, far, rz)
                if best < far:
                    cosine, reflectance, code = 1.0, HERB_ALBEDO, HIGH
            best += bump
        elif what < solids:
            reflectance, code = scene.solid_albedo[what], int(scene.solid_class[what])
        else:
            reflectance, code = scene.crown_albedo[what - solids], HIGH
        if code == HIGH:
            x, y = ox + best * rx, oy + best * ry
            above = oz + best * rz - terrain(height, margin, step, x, y)
            code = LOW if above < 0.5 else (MEDIUM if above < 2.0 else HIGH)
        hit_range[hits] = best
        hit_energy[hits] = rays[k, 2] * reflectance * cosine / (best * best)
        hit_class[hits] = code
        hits += 1
    return hits
