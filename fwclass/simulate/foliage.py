"""Where a ray ends in leaves: crowns as leaf density voxels, and the herb layer on the ground."""

from __future__ import annotations

import math

import numpy as np

from fwclass.kernel import kernel
from fwclass.simulate.noise import mix, uniform
from fwclass.simulate.scene import BOX, CONE

_VOXEL = 0.35
"""Edge of a leaf density voxel [m]: a clump of leaves, somewhat larger than a footprint."""

_HERB_EXTINCTION, HERB_ALBEDO = 5.0, 0.27
"""Of the herb layer: extinction per metre of way, and reflectance times mean cosine."""

_LOW = 4.0
"""A crown lower than this is a shrub [m]: closed, where a tree is in clumps and hollow."""

_HOLLOW = 0.3
"""Share of the foliage in the inner half of a crown, where little light comes."""

_PX, _PY, _PZ = np.uint64(0x8DA6B343D8163841), np.uint64(0xCB1AB31F8B2FC3D5), np.uint64(0x165667919E3779F9)
_S8, _S56, _BYTE = np.uint64(8), np.uint64(56), np.uint64(255)


@kernel
def _foliage(crown, clump, stream, c, x, y, z):  # type: ignore[no-untyped-def]
    """Leaf area density of crown `c` at a point [m²/m³]: its mean times its voxel's share, 0 outside.

    The outline is ragged by voxel, too.
    """
    if z <= crown[c, 3] or z >= crown[c, 4]:
        return 0.0
    vx, vy, vz = int(x / _VOXEL), int(y / _VOXEL), int((z + 1000.0) / _VOXEL)
    bits = mix(stream ^ (np.uint64(vx) * _PX) ^ (np.uint64(vy) * _PY) ^ (np.uint64(vz) * _PZ))
    ragged = 1.0 - 0.5 * np.float64((bits >> _S8) & _BYTE) / 255.0
    dx, dy, share = x - crown[c, 1], y - crown[c, 2], 1.0
    if crown[c, 0] == BOX:
        u, v = abs(dx * crown[c, 7] + dy * crown[c, 8]), abs(dy * crown[c, 7] - dx * crown[c, 8])
        inside = u < crown[c, 5] and v < crown[c, 6] * (0.5 + 0.5 * ragged)
    elif crown[c, 0] == CONE:
        reach = crown[c, 5] * (crown[c, 4] - z) / (crown[c, 4] - crown[c, 3])
        inside = dx * dx + dy * dy < reach * reach * ragged
    else:
        half = (crown[c, 4] - crown[c, 3]) / 2.0
        dz = (z - crown[c, 3] - half) / half
        q = (dx * dx + dy * dy) / (crown[c, 5] * crown[c, 5]) + dz * dz
        inside = q < ragged
        if q < 0.25 and half > _LOW / 2.0:
            share = _HOLLOW
    if not inside:
        return 0.0
    if crown[c, 4] - crown[c, 3] < _LOW:
        return crown[c, 9] * (0.5 + 0.5 * clump[bits >> _S56])
    return crown[c, 9] * share * clump[bits >> _S56]


@kernel
def leaf(crown, clump, stream, c, ox, oy, oz, dx, dy, dz, t0, t1, depth):  # type: ignore[no-untyped-def]
    """Distance in [t0, t1] at which the ray has met the optical depth `depth` in crown `c`; t1 if it has not.

    Leaves are turned every way (projection 1/2).
    """
    step = min(max((crown[c, 4] - crown[c, 3]) / 12.0, 0.06), 0.15)
    t = t0
    while t < t1:
        m = t + 0.5 * step
        met = 0.5 * _foliage(crown, clump, stream, c, ox + m * dx, oy + m * dy, oz + m * dz) * step
        if met >= depth:
            return min(t + step * depth / met, t1)
        depth -= met
        t += step
    return t1


@kernel
def herb(stream, key, number, tall, x, y, far, rz):  # type: ignore[no-untyped-def]
    """Distance [m] at which a ray bound for the ground at `far` [m] ends in a ragged herb layer of mean height `tall`
    [m], by random number `number` of the stream `key`."""
    vx, vy = int(x / _VOXEL), int(y / _VOXEL)
    bits = mix(stream ^ (np.uint64(vx) * _PY) ^ (np.uint64(vy) * _PX))
    way = tall * (0.3 + 1.4 * np.float64(bits >> _S56) / 255.0) / -rz
    return min(far - way - math.log(uniform(key, number)) / _HERB_EXTINCTION, far)
