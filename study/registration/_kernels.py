"""Compiled closed form of rigid point registration, many at once.

The rotation is the unit quaternion that maximises a quadratic form, that is, the eigenvector of the
largest eigenvalue of a symmetric (4, 4) matrix (Horn 1987). Jacobi rotations find it to round-off also
for three points and for points in one plane, where a decomposition of the (3, 3) matrix needs care.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from study._compiled import inner, kernel, threaded

SWEEPS = 30  # of Jacobi rotations; six are enough in practice


@inner
def _largest_eigenvector(a, v, q):
    """Write into `q` the eigenvector of the largest eigenvalue of the symmetric `a`; uses up `a` and `v`."""
    for r in range(4):
        for c in range(4):
            v[r, c] = 1.0 if r == c else 0.0
    for _ in range(SWEEPS):
        off = 0.0
        whole = 0.0
        for r in range(4):
            whole += a[r, r] * a[r, r]
            for c in range(r + 1, 4):
                off += a[r, c] * a[r, c]
        if off <= 1e-32 * whole:
            break
        for p in range(3):
            for s in range(p + 1, 4):
                if a[p, s] == 0.0:
                    continue
                theta = 0.5 * (a[s, s] - a[p, p]) / a[p, s]
                if abs(theta) > 1e150:
                    t = 0.5 / theta
                else:
                    t = 1.0 / (abs(theta) + sqrt(theta * theta + 1.0))
                    if theta < 0.0:
                        t = -t
                cos = 1.0 / sqrt(t * t + 1.0)
                sin = t * cos
                shift = t * a[p, s]
                a[p, p] -= shift
                a[s, s] += shift
                a[p, s] = 0.0
                a[s, p] = 0.0
                for k in range(4):
                    if k not in (p, s):
                        x = a[k, p]
                        y = a[k, s]
                        a[k, p] = cos * x - sin * y
                        a[p, k] = a[k, p]
                        a[k, s] = sin * x + cos * y
                        a[s, k] = a[k, s]
                    x = v[k, p]
                    y = v[k, s]
                    v[k, p] = cos * x - sin * y
                    v[k, s] = sin * x + cos * y
    best = 0
    for k in range(1, 4):
        if a[k, k] > a[best, best]:
            best = k
    for k in range(4):
        q[k] = v[k, best]


@inner
def rotation_of_sums(s, h, v, q, turn):
    """Rotation that brings centred points closest to those they are matched with.

    Parameters
    ----------
    s : (3, 3) float array
        Sums of the products of moving (rows) and fixed (columns) coordinates, one set centred.
    h, v, q : (4, 4), (4, 4) and (4,) float arrays
        Used up.
    turn : (3, 3) float array
        Receives the rotation.

    Returns
    -------
    float
        By how much the largest eigenvalue exceeds the next: 0 where another rotation fits as well.
    """
    h[0, 0] = s[0, 0] + s[1, 1] + s[2, 2]
    h[1, 1] = s[0, 0] - s[1, 1] - s[2, 2]
    h[2, 2] = s[1, 1] - s[0, 0] - s[2, 2]
    h[3, 3] = s[2, 2] - s[0, 0] - s[1, 1]
    h[0, 1] = s[1, 2] - s[2, 1]
    h[0, 2] = s[2, 0] - s[0, 2]
    h[0, 3] = s[0, 1] - s[1, 0]
    h[1, 2] = s[0, 1] + s[1, 0]
    h[1, 3] = s[2, 0] + s[0, 2]
    h[2, 3] = s[1, 2] + s[2, 1]
    for r in range(4):
        for c in range(r):
            h[r, c] = h[c, r]
    _largest_eigenvector(h, v, q)
    w, x, y, z = q[0], q[1], q[2], q[3]
    turn[0, 0] = w * w + x * x - y * y - z * z
    turn[1, 1] = w * w - x * x + y * y - z * z
    turn[2, 2] = w * w - x * x - y * y + z * z
    turn[0, 1] = 2 * (x * y - w * z)
    turn[1, 0] = 2 * (x * y + w * z)
    turn[0, 2] = 2 * (x * z + w * y)
    turn[2, 0] = 2 * (x * z - w * y)
    turn[1, 2] = 2 * (y * z - w * x)
    turn[2, 1] = 2 * (y * z + w * x)
    first = max(max(h[0, 0], h[1, 1]), max(h[2, 2], h[3, 3]))
    gap = np.inf
    seen = False
    for k in range(4):
        if h[k, k] == first and not seen:
            seen = True
        else:
            gap = min(gap, first - h[k, k])
    return gap


@threaded
def register_many(moving, fixed, weights, out):
    """Fit ``fixed ~ R moving + t`` for each of many sets of points.

    Parameters
    ----------
    moving, fixed : (m, n, 3) float arrays
        mm.
    weights : (n,) float array
        Of the squared distances; sum above 0.
    out : (m, 4, 4) float array
        Receives the transforms.
    """
    total = 0.0
    for i in range(weights.shape[0]):
        total += weights[i]
    h = np.empty((4, 4))
    v = np.empty((4, 4))
    q = np.empty(4)
    s = np.empty((3, 3))
    turn = np.empty((3, 3))
    from_ = np.empty(3)
    to = np.empty(3)
    for m in range(moving.shape[0]):
        for r in range(3):
            from_[r] = 0.0
            to[r] = 0.0
            for i in range(weights.shape[0]):
                from_[r] += weights[i] * moving[m, i, r]
                to[r] += weights[i] * fixed[m, i, r]
            from_[r] /= total
            to[r] /= total
        for r in range(3):
            for c in range(3):
                s[r, c] = 0.0
                for i in range(weights.shape[0]):
                    s[r, c] += weights[i] * (moving[m, i, r] - from_[r]) * (fixed[m, i, c] - to[c])
        rotation_of_sums(s, h, v, q, turn)
        for r in range(3):
            out[m, r, 3] = to[r]
            for c in range(3):
                out[m, r, c] = turn[r, c]
                out[m, r, 3] -= turn[r, c] * from_[c]
            out[m, 3, r] = 0.0
        out[m, 3, 3] = 1.0


@kernel
def scatter(points, roots, white, out):
    """Add an error of its own to every point of many copies of a set.

    Parameters
    ----------
    points : (n, 3) float array
    roots : (n, 3, 3) float array
        Lower triangular roots of the errors' covariances.
    white : (m, n, 3) float array
        Independent standard normal numbers.
    out : (m, n, 3) float array
        Receives the points; may be `white`.
    """
    for m in range(white.shape[0]):
        for i in range(points.shape[0]):
            x, y, z = white[m, i, 0], white[m, i, 1], white[m, i, 2]
            out[m, i, 0] = points[i, 0] + roots[i, 0, 0] * x
            out[m, i, 1] = points[i, 1] + roots[i, 1, 0] * x + roots[i, 1, 1] * y
            out[m, i, 2] = points[i, 2] + roots[i, 2, 0] * x + roots[i, 2, 1] * y + roots[i, 2, 2] * z
