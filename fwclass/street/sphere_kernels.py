"""Spheres over the variable-scale grid: neighbours of a frame's returns among frames and beams, and their sums.

Cell (i, j) of the grid is beam j of frame i (Li 2018, 2.1). Coordinates are whole units, so that a sphere's members and
its sums are exact, whatever the order: equal for a ring of frames, for a chunk of a recording, on any processor.
"""

from __future__ import annotations

import math

import numpy as np

from fwclass.kernel import inlined, kernel, vectorised

UNIT = 1.0 / 1024.0
"""m, of the stored coordinates: scanners tell whole millimetres."""

FAR = 1 << 22
"""units, where a beam without return lies: 4 km, out of every sphere."""

LARGEST_RADIUS = 1.2
"""m; the squares of `RUN` offsets fit into 31 bits."""

RUN = 1024
"""Returns whose sums are taken in 32 bits."""

_PANEL = 10
"""Frames that are laid side by side, about: their returns are one run for a beam's window, and windows of frames aside
are narrower."""

_LANES = 16
"""Returns that are summed at a time: a run of whole ones has no rest that goes one by one."""

_EDGE = 2047
"""units that an offset is cut to: more than the largest radius, and two squares of it add up in 32 bits."""

_ROUNDING = 2.0
"""units, by which the distance of two returns may be off as coordinates are rounded: √2 at most."""

SUMS = 16
"""Count, sums (x, y, z, xx, yy, zz, xy, xz, yz), lowest and highest y, lowest and highest z, offsets in units; sums of
the intensities and of their squares, in levels."""

LEVELS = 1024
"""Of an intensity, 0 to full scale: squares of `RUN` of them add up in 31 bits."""


@vectorised
def _add_run(X, Y, Z, light, x0, y0, z0, most, sums):  # type: ignore[no-untyped-def]
    """Add count, sums and extremes of the offsets of up to `RUN` returns from the centre, and sums of `light`."""
    n = sx = sy = sz = sxx = syy = szz = sxy = sxz = syz = si = sii = np.int32(0)
    yl = yh = zl = zh = np.int32(0)
    edge, low = np.int32(_EDGE), np.int32(-_EDGE)
    for s in range(len(Y)):  # from 0: an index that may be negative for all numba knows is looked up one by one
        dx = min(max(np.int32(X[s] - x0), low), edge)
        dy = min(max(np.int32(Y[s] - y0), low), edge)
        dz = min(max(np.int32(Z[s] - z0), low), edge)
        inside = np.int32(np.int32(np.int32(dx * dx) + np.int32(dy * dy)) + np.int32(dz * dz)) <= most
        dx = dx if inside else np.int32(0)
        dy = dy if inside else np.int32(0)
        dz = dz if inside else np.int32(0)
        n = np.int32(n + np.int32(inside))
        sx = np.int32(sx + dx)
        sy = np.int32(sy + dy)
        sz = np.int32(sz + dz)
        sxx = np.int32(sxx + np.int32(dx * dx))
        syy = np.int32(syy + np.int32(dy * dy))
        szz = np.int32(szz + np.int32(dz * dz))
        sxy = np.int32(sxy + np.int32(dx * dy))
        sxz = np.int32(sxz + np.int32(dx * dz))
        syz = np.int32(syz + np.int32(dy * dz))
        if light is not None:
            level = light[s]  # read in any case: a read that depends on another value is not vectorised
            level = level if inside else np.int32(0)
            si = np.int32(si + level)
            sii = np.int32(sii + np.int32(level * level))
        yl, yh = min(yl, dy), max(yh, dy)  # the centre is a member: the zeros of others change nothing
        zl, zh = min(zl, dz), max(zh, dz)
    sums[0] += n
    sums[1] += sx
    sums[2] += sy
    sums[3] += sz
    sums[4] += sxx
    sums[5] += syy
    sums[6] += szz
    sums[7] += sxy
    sums[8] += sxz
    sums[9] += syz
    sums[10], sums[11] = min(sums[10], yl), max(sums[11], yh)
    sums[12], sums[13] = min(sums[12], zl), max(sums[13], zh)
    sums[14] += si
    sums[15] += sii


@kernel
def _add(X, Y, Z, light, first, last, x0, y0, z0, most, sums):  # type: ignore[no-untyped-def]
    """Add the returns `first` to `last` of a panel, those of them that are in the sphere."""
    for begin in range(first, last, RUN):
        end = min(begin + RUN, last)
        lit = None if light is None else light[begin:end]
        _add_run(X[begin:end], Y[begin:end], Z[begin:end], lit, x0, y0, z0, most, sums)


@kernel
def frame_sums(X, Y, Z, light, R, place, rows, middle, radius, step, lean, wraps, narrow, sums):  # type: ignore[no-untyped-def]
    """Sums over the sphere of every return of one frame.

    Parameters
    ----------
    X, Y, Z : int32 (rows, beams), coordinates from the scanner [units], `FAR` in y and z without a return; X has no
        rows where the scan plane is at right angles to the road.
    light : int32 (rows, beams), intensity of every return [levels, 0 to `LEVELS` - 1]; or None.
    R : float32 (rows, beams), range [m], NaN without a return.
    place : int64 (rows,), of the frames along the road [units].
    rows : int64, rows of the frames that may have members, the middle one among them.
    radius : of the sphere [m]; step : between beams [rad].
    lean : length along the scan plane of one unit along the road, 0 where X has no rows.
    wraps : the beams go full circle. narrow : the paper's window δ / (r Δα) instead of the exact one.
    sums : int64 (beams, `SUMS`), filled; the count is 0 without a return.
    """
    beams = Y.shape[1]
    reach = radius / UNIT
    most = np.int32(math.floor(reach * reach))
    tilted = len(X) > 0
    near = np.empty(len(rows), np.int64)
    frames = 0
    for k in rows:
        if tilted or (place[k] - place[middle]) ** 2 <= most:
            near[frames] = k
            frames += 1
    # Frames side by side in panels, beam by beam; y beyond every sphere where a panel is not full, and behind it.
    panels = max(1, round(frames / _PANEL))
    width = (frames + panels - 1) // panels
    length = beams * width
    x, z = np.zeros((panels, length + _LANES), np.int32), np.zeros((panels, length + _LANES), np.int32)
    y = np.full((panels, length + _LANES), FAR, np.int32)
    lit = None if light is None else np.zeros((panels, length + _LANES), np.int32)
    wide = np.zeros(panels)
    for q in range(frames):
        k, p, column = near[q], q // width, q % width
        dx = place[k] - place[middle]
        inner = math.sqrt(max(reach * reach - (dx * dx if not tilted else 0), 0.0))
        wide[p] = max(wide[p], inner + _ROUNDING + abs(dx) * lean)
        for j in range(beams):
            s = j * width + column
            x[p, s] = X[k, j] + dx if tilted else dx
            y[p, s], z[p, s] = Y[k, j], Z[k, j]
            if light is not None and lit is not None:
                lit[p, s] = light[k, j]
    widest = wide.max()
    for j in range(beams):
        sums[j, :] = 0
        r = np.float64(R[middle, j])
        if not r > 0:
            continue
        x0 = X[middle, j] if tilted else np.int32(0)
        y0, z0 = Y[middle, j], Z[middle, j]
        around = r <= (radius if narrow else widest * UNIT)
        angle = 0.0 if around or narrow else math.asin(widest * UNIT / r)
        for p in range(panels):
            if around:
                half = beams
            elif narrow:
                half = min(int(radius / (r * step)), beams)
            else:  # asin(t s) <= t asin(s): the circle in which the sphere cuts frames aside is smaller
                half = min(int(wide[p] / widest * angle / step) + 1, beams)
            first, last = j - half, j + half + 1
            if wraps and last - first >= beams:
                first, last = 0, beams
            before, after = (max(-first, 0), max(last - beams, 0)) if wraps else (0, 0)
            first, last = max(first, 0) * width, min(last, beams) * width
            if not narrow and before + after == 0:  # what is beyond the window is in no sphere
                last = first + (last - first + _LANES - 1) // _LANES * _LANES
            shone = None if lit is None else lit[p]
            _add(x[p], y[p], z[p], shone, first, last, x0, y0, z0, most, sums[j])
            if before:
                _add(x[p], y[p], z[p], shone, length - before * width, length, x0, y0, z0, most, sums[j])
            if after:
                _add(x[p], y[p], z[p], shone, 0, after * width, x0, y0, z0, most, sums[j])


@inlined
def _eigenvalues(a, b, c, d, e, f):  # type: ignore[no-untyped-def]
    """Eigenvalues of [[a, d, e], [d, b, f], [e, f, c]], falling, none below 0 (trigonometric form)."""
    q = (a + b + c) / 3.0
    p2 = (a - q) ** 2 + (b - q) ** 2 + (c - q) ** 2 + 2.0 * (d * d + e * e + f * f)
    if p2 <= 1e-24 * q * q or p2 == 0.0:
        return max(q, 0.0), max(q, 0.0), max(q, 0.0)
    p = math.sqrt(p2 / 6.0)
    A, B, C, D, E, F = (a - q) / p, (b - q) / p, (c - q) / p, d / p, e / p, f / p
    half = 0.5 * (A * (B * C - F * F) - D * (D * C - F * E) + E * (D * F - B * E))
    angle = math.acos(min(1.0, max(-1.0, half))) / 3.0
    first = q + 2.0 * p * math.cos(angle)
    third = q + 2.0 * p * math.cos(angle + 2.0 * math.pi / 3.0)
    return max(first, 0.0), max(3.0 * q - first - third, 0.0), max(third, 0.0)


@kernel
def features_of(sums, y, z, road, from_road, out):  # type: ignore[no-untyped-def]
    """The eleven features of Li 2018 from `frame_sums`, and mean and deviation of the intensities where `out` has room
    for them; NaN without a return.

    Parameters
    ----------
    sums : int64 (beams, `SUMS`). y, z : int32 (beams,), of the centres [units].
    road : height of the road beside the vehicle above the scanner [m]; taken from the mean height if `from_road`.
    out : float32 (beams, 11 or 13), filled, in the paper's order; intensities as shares of full scale.
    """
    for j in range(len(sums)):
        n = np.float64(sums[j, 0])
        if n == 0:
            out[j, :] = np.nan
            continue
        s, per = sums[j], UNIT * UNIT / (n * n)
        side = 1.0 if y[j] >= 0 else -1.0
        xx = (n * s[4] - np.float64(s[1]) * s[1]) * per
        yy = (n * s[5] - np.float64(s[2]) * s[2]) * per
        zz = (n * s[6] - np.float64(s[3]) * s[3]) * per
        xy = (n * s[7] - np.float64(s[1]) * s[2]) * per
        xz = (n * s[8] - np.float64(s[1]) * s[3]) * per
        yz = (n * s[9] - np.float64(s[2]) * s[3]) * per
        l1, l2, l3 = _eigenvalues(xx, yy, zz, xy, xz, yz)
        out[j, 0] = (z[j] + s[3] / n) * UNIT - (road if from_road else 0.0)
        out[j, 1] = zz
        out[j, 2] = (s[13] - s[12]) * UNIT
        out[j, 3] = side * (y[j] + s[2] / n) * UNIT
        out[j, 4] = yy
        out[j, 5] = (s[11] - s[10]) * UNIT
        out[j, 6] = n
        out[j, 7] = (l1 * l2 * l3) ** (1.0 / 3.0)
        if l1 > 0.0:
            g1, g2, g3 = math.sqrt(l1), math.sqrt(l2), math.sqrt(l3)
            out[j, 8], out[j, 9], out[j, 10] = (g1 - g2) / g1, (g2 - g3) / g1, g3 / g1
        else:
            out[j, 8], out[j, 9], out[j, 10] = 0.0, 0.0, 0.0
        if out.shape[1] > 11:
            full = LEVELS - 1.0
            out[j, 11] = s[14] / n / full
            out[j, 12] = math.sqrt(np.float64(s[0] * s[15] - s[14] * s[14])) / n / full
