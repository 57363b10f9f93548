"""Compiled: the band of voxels about a structure, and their smallest distance to its surface in a metric
that varies from place to place.

Lattice corner ``(a, b, c)`` touches the voxels ``a - 1 .. a`` and so on.
"""

from __future__ import annotations

from math import acos, cos, floor, sqrt

import numpy as np

from study._compiled import inlined, kernel

NO_CORNER = 32000  # farther than any


@kernel
def widen(mask, axis_reach, out):
    """Set `out` where a voxel of `mask` is at most `axis_reach[k]` voxels away along each axis k.

    Parameters
    ----------
    mask, out : (nx, ny, nz) uint8 arrays
        `out` must be all 0.
    axis_reach : (3,) int array
    """
    nx, ny, nz = mask.shape
    r = axis_reach[2]
    for i in range(nx):
        for j in range(ny):
            last = -r - 1
            for k in range(nz):
                if mask[i, j, k]:
                    for t in range(max(last + r + 1, k - r, 0), min(k + r + 1, nz)):
                        out[i, j, t] = 1
                    last = k
    r = axis_reach[1]
    far = np.empty(max(nx, ny), np.int64)
    line = np.empty(max(nx, ny), np.uint8)
    for i in range(nx):
        for k in range(nz):
            any_ = False
            for j in range(ny):
                line[j] = out[i, j, k]
                any_ = any_ or line[j] != 0
            if any_:
                _widen_line(line, ny, r, far)
                for j in range(ny):
                    out[i, j, k] = line[j]
    r = axis_reach[0]
    for j in range(ny):
        for k in range(nz):
            any_ = False
            for i in range(nx):
                line[i] = out[i, j, k]
                any_ = any_ or line[i] != 0
            if any_:
                _widen_line(line, nx, r, far)
                for i in range(nx):
                    out[i, j, k] = line[i]


@inlined
def _widen_line(line, n, r, far):
    last = -r - 1
    for t in range(n):
        if line[t]:
            last = t
        far[t] = t - last
    last = n + r + 1
    for t in range(n - 1, -1, -1):
        if line[t]:
            last = t
        if far[t] <= r or last - t <= r:
            far[t] = 0
    for t in range(n):
        line[t] = 1 if far[t] == 0 else 0


@kernel
def surface_corners(solid, out):
    """Set `out` at lattice corners that touch voxels inside and outside of `solid`.

    Voxels beyond the array do not exist: they are neither.

    Parameters
    ----------
    solid : (nx, ny, nz) uint8 array
    out : (nx + 1, ny + 1, nz + 1) uint8 array
    """
    nx, ny, nz = solid.shape
    for a in range(nx + 1):
        for b in range(ny + 1):
            for c in range(nz + 1):
                inside = False
                outside = False
                for i in range(max(a - 1, 0), min(a + 1, nx)):
                    for j in range(max(b - 1, 0), min(b + 1, ny)):
                        for k in range(max(c - 1, 0), min(c + 1, nz)):
                            if solid[i, j, k]:
                                inside = True
                            else:
                                outside = True
                out[a, b, c] = 1 if inside and outside else 0


@kernel
def next_along_lines(surface, above, below):
    """For every corner the nearest surface corner on its line along the last axis, itself included.

    Parameters
    ----------
    surface : (nx + 1, ny + 1, nz + 1) uint8 array
    above, below : int16 arrays of that shape
        Receive the index at or above and at or below; `NO_CORNER` and ``-NO_CORNER`` where there is none.
    """
    nx, ny, nz = surface.shape
    for a in range(nx):
        for b in range(ny):
            last = -NO_CORNER
            for c in range(nz):
                if surface[a, b, c]:
                    last = c
                below[a, b, c] = last
            last = NO_CORNER
            for c in range(nz - 1, -1, -1):
                if surface[a, b, c]:
                    last = c
                above[a, b, c] = last


@inlined
def _largest_eigenvalue(xx, yy, zz, xy, xz, yz):
    """Of a symmetric (3, 3) matrix, in closed form."""
    mean = (xx + yy + zz) / 3
    off = xy * xy + xz * xz + yz * yz
    p2 = (xx - mean) ** 2 + (yy - mean) ** 2 + (zz - mean) ** 2 + 2 * off
    p = sqrt(p2 / 6) + 1e-300
    ax, ay, az = (xx - mean) / p, (yy - mean) / p, (zz - mean) / p
    bxy, bxz, byz = xy / p, xz / p, yz / p
    half = 0.5 * (ax * (ay * az - byz * byz) - bxy * (bxy * az - byz * bxz) + bxz * (bxy * byz - ay * bxz))
    return mean + 2 * p * cos(acos(min(1.0, max(-1.0, half))) / 3)


@kernel
def smallest_distances(voxels, above, below, matrix, corner, moments, floor_mm2, columns, lengths, cut, out):
    """Smallest Mahalanobis distance from voxel centres to surface corners.

    The covariance at a voxel's own centre is its metric. Lines of corners along the last axis are
    looked at one after the other, the nearest first: on a line the squared distance is a parabola, so that
    only the surface corners on either side of its lowest point matter.

    Parameters
    ----------
    voxels : (n, 3) int array
        Indices in the lattice's box.
    above, below : int16 arrays
        See `next_along_lines`.
    matrix : (3, 3) float array
        Voxel steps to mm.
    corner : (3,) float array
        mm from the centre of the moments to the centre of voxel (0, 0, 0).
    moments : (3, 4, 3, 4) float array
        Covariance of the displacement's parameters, see `DisplacementMoments`.
    floor_mm2 : float
        Added to the diagonal of every covariance, mm^2, so that it can be inverted.
    columns : (m, 2) int array
        From a voxel to a line of corners, by increasing length.
    lengths : (m,) float array
        Squared mm from the voxel's centre to that line.
    cut : float
        Distances of this and more do not matter.
    out : (n,) float array
        Receives distances, infinity for those that do not matter.
    """
    p = np.empty(4)
    p[3] = 1.0
    cov = np.empty((3, 3))
    inv = np.empty((3, 3))
    q = np.empty((3, 3))
    nx, ny, nz = above.shape
    for n in range(voxels.shape[0]):
        i, j, k = voxels[n, 0], voxels[n, 1], voxels[n, 2]
        for r in range(3):
            p[r] = corner[r] + matrix[r, 0] * i + matrix[r, 1] * j + matrix[r, 2] * k
        for r in range(3):
            for c in range(r, 3):
                value = 0.0
                for u in range(4):
                    for v in range(4):
                        value += p[u] * moments[r, u, c, v] * p[v]
                cov[r, c] = value
        xx, yy, zz = cov[0, 0] + floor_mm2, cov[1, 1] + floor_mm2, cov[2, 2] + floor_mm2
        xy, xz, yz = cov[0, 1], cov[0, 2], cov[1, 2]
        widest = _largest_eigenvalue(xx, yy, zz, xy, xz, yz) * (1 + 1e-9)
        inv[0, 0], inv[1, 1], inv[2, 2] = yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy
        inv[0, 1], inv[0, 2], inv[1, 2] = xz * yz - xy * zz, xy * yz - xz * yy, xy * xz - xx * yz
        inv[1, 0], inv[2, 0], inv[2, 1] = inv[0, 1], inv[0, 2], inv[1, 2]
        det = xx * inv[0, 0] + xy * inv[0, 1] + xz * inv[0, 2]
        for r in range(3):  # the metric in voxel steps
            for c in range(r, 3):
                value = 0.0
                for u in range(3):
                    for v in range(3):
                        value += matrix[u, r] * inv[u, v] * matrix[v, c]
                q[r, c] = value / det
        best = cut * cut
        for m in range(columns.shape[0]):
            if lengths[m] >= best * widest:
                break
            a, b = i + columns[m, 0], j + columns[m, 1]
            if a < 0 or b < 0 or a >= nx or b >= ny:
                continue
            s, t = columns[m, 0] - 0.5, columns[m, 1] - 0.5
            lean = -(q[0, 2] * s + q[1, 2] * t) / q[2, 2]  # where on the line the parabola is lowest
            base = q[0, 0] * s * s + 2 * q[0, 1] * s * t + q[1, 1] * t * t - q[2, 2] * lean * lean
            if base >= best:
                continue
            lowest = k + 0.5 + lean
            c = int(floor(lowest))
            if c < nz - 1:
                u = above[a, b, max(c + 1, 0)] - lowest
                best = min(best, base + q[2, 2] * u * u)
            if c >= 0:
                u = below[a, b, min(c, nz - 1)] - lowest
                best = min(best, base + q[2, 2] * u * u)
        out[n] = sqrt(best) if best < cut * cut else np.inf
