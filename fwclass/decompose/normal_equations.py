"""Normal equations of a level and `count` echoes of three parameters each, their solution, and its variances.

Parameters are packed as in `least_squares`; sums of a pair of echoes run over the samples that both reach.
"""

from __future__ import annotations

import math

from fwclass.kernel import inlined, kernel, vectorised


@vectorised
def _own(basis, residual, weight, length):  # type: ignore[no-untyped-def]
    """Products of (1, u, v, x, r) of one echo."""
    w1u, w1v, w1x, uu, uv, ux, vv, vx, xx = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    ru, rv, rx = 0.0, 0.0, 0.0
    for j in range(length):
        u, v, x, w = basis[0, j], basis[1, j], basis[2, j], weight[j]
        wu, wv, wx, wr = w * u, w * v, w * x, w * residual[j]
        w1u += wu
        w1v += wv
        w1x += wx
        uu += wu * u
        uv += wu * v
        ux += wu * x
        vv += wv * v
        vx += wv * x
        xx += wx * x
        ru += wr * u
        rv += wr * v
        rx += wr * x
    return w1u, w1v, w1x, uu, uv, ux, vv, vx, xx, ru, rv, rx


@vectorised
def _cross(one, two, weight, length):  # type: ignore[no-untyped-def]
    """Products of (u, v, x) of two echoes on the samples that both reach."""
    h00, h01, h02, h10, h11, h12, h20, h21, h22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(length):
        w = weight[j]
        u0, u1, u2 = w * one[0, j], w * one[1, j], w * one[2, j]
        v0, v1, v2 = two[0, j], two[1, j], two[2, j]
        h00 += u0 * v0
        h01 += u0 * v1
        h02 += u0 * v2
        h10 += u1 * v0
        h11 += u1 * v1
        h12 += u1 * v2
        h20 += u2 * v0
        h21 += u2 * v1
        h22 += u2 * v2
    return h00, h01, h02, h10, h11, h12, h20, h21, h22


@kernel
def normal_equations(p, count, weight, residual, basis, window, total, pull, hessian, gradient):  # type: ignore[no-untyped-def]
    """Upper triangle of J^T W J into `hessian` (size, size), and J^T W r into `gradient` (size,), after `evaluate` or
    `lay` at the same `p`.

    `total`, `pull` : sums of w and of w r."""
    size = 3 * count + 1
    for a in range(size):
        for b in range(a, size):
            hessian[a, b] = 0.0
    hessian[0, 0], gradient[0] = total, pull
    for k in range(count):
        a, h = 3 * k + 1, p[3 * k + 1]
        start, stop = window[k, 0], window[k, 1]
        w1u, w1v, w1x, uu, uv, ux, vv, vx, xx, ru, rv, rx = _own(
            basis[k], residual[start:stop], weight[start:stop], stop - start
        )
        gradient[a], gradient[a + 1], gradient[a + 2] = ru, h * rv, h * rx
        hessian[0, a], hessian[0, a + 1], hessian[0, a + 2] = w1u, h * w1v, h * w1x
        hessian[a, a], hessian[a, a + 1], hessian[a, a + 2] = uu, h * uv, h * ux
        hessian[a + 1, a + 1], hessian[a + 1, a + 2], hessian[a + 2, a + 2] = h * h * vv, h * h * vx, h * h * xx
        for m in range(k + 1, count):
            low, high = max(start, window[m, 0]), min(stop, window[m, 1])
            if high <= low:
                continue
            b, g = 3 * m + 1, p[3 * m + 1]
            h00, h01, h02, h10, h11, h12, h20, h21, h22 = _cross(
                basis[k, :, low - start :], basis[m, :, low - window[m, 0] :], weight[low:high], high - low
            )
            hessian[a, b], hessian[a, b + 1], hessian[a, b + 2] = h00, g * h01, g * h02
            hessian[a + 1, b], hessian[a + 1, b + 1], hessian[a + 1, b + 2] = h * h10, h * g * h11, h * g * h12
            hessian[a + 2, b], hessian[a + 2, b + 1], hessian[a + 2, b + 2] = h * h20, h * g * h21, h * g * h22


@inlined
def factorise(hessian, frozen, damping, size, upper):  # type: ignore[no-untyped-def]
    """Cholesky factor R (size, size), R^T R = `hessian` with its diagonal grown by `damping` and `frozen`.

    It goes into the upper triangle of `upper`, whose diagonal holds inverses; False if singular. Each row is taken off
    all below it at once: that runs several numbers at a time, without another order of sums."""
    for i in range(size):
        for j in range(i, size):
            upper[i, j] = hessian[i, j]
        upper[i, i] = hessian[i, i] * (1.0 + damping) + frozen[i] + 1e-12
    for k in range(size):
        row = upper[k, k:size]
        if not row[0] > 0.0:
            return False
        scale = 1.0 / math.sqrt(row[0])
        row[0] = scale
        for j in range(1, len(row)):
            row[j] *= scale
        for i in range(1, len(row)):
            share, other, below = row[i], row[i:], upper[k + i, k + i : size]
            for j in range(len(other)):
                below[j] -= share * other[j]
    return True


@inlined
def solve(upper, right, size, x):  # type: ignore[no-untyped-def]
    """Solve R^T R x = right into `x` (size,), R in the upper triangle of `upper` as `factorise` leaves it; the squared
    length of R^-T right."""
    expected = 0.0
    for i in range(size):
        s = right[i]
        for k in range(i):
            s -= upper[k, i] * x[k]
        x[i] = s * upper[i, i]
        expected += x[i] * x[i]
    for i in range(size - 1, -1, -1):
        s = x[i]
        for k in range(i + 1, size):
            s -= upper[i, k] * x[k]
        x[i] = s * upper[i, i]
    return expected


@inlined
def variances(upper, size, x, out):  # type: ignore[no-untyped-def]
    """Diagonal of (R^T R)^-1 into `out` (size,), for R in the upper triangle of `upper` as `factorise` leaves it."""
    for q in range(size):
        total = 0.0
        for i in range(q, size):
            v = 1.0 if i == q else 0.0
            for k in range(q, i):
                v -= upper[k, i] * x[k]
            x[i] = v * upper[i, i]
            total += x[i] * x[i]
        out[q] = total
