"""Compiled: voxels near a structure, and their smallest distance to its surface in a metric that varies.

Lattice corner ``(a, b, c)`` touches the voxels ``a - 1 .. a`` and so on.
"""

from __future__ import annotations

from math import floor, sqrt

import numpy as np

from study._compiled import kernel, threaded

NO_CORNER = 32000  # farther than any


@kernel
def surface_along_lines(solid, above, below):
    """For every lattice corner the nearest surface corner on its line along the last axis, itself included.

    Surface corners touch voxels inside and outside of `solid`. Voxels beyond the array do not exist: they are
    neither.

    Parameters
    ----------
    solid : (nx, ny, nz) uint8 array
    above, below : (nx + 1, ny + 1, nz + 1) int16 arrays
        Receive the index at or above and at or below; `NO_CORNER` and ``-NO_CORNER`` where there is none.
    """
    nx, ny, nz = solid.shape
    for a in range(nx + 1):
        for b in range(ny + 1):
            x0, x1, y0, y1 = max(a - 1, 0), min(a + 1, nx), max(b - 1, 0), min(b + 1, ny)
            there = (x1 - x0) * (y1 - y0)
            inside_before = 0
            there_before = 0
            last = -NO_CORNER
            for c in range(nz + 1):
                inside = 0
                there_now = 0
                if c < nz:
                    there_now = there
                    for x in range(x0, x1):
                        for y in range(y0, y1):
                            inside += solid[x, y, c]
                if 0 < inside + inside_before < there_now + there_before:
                    last = c
                below[a, b, c] = last
                inside_before = inside
                there_before = there_now
            last = NO_CORNER
            for c in range(nz, -1, -1):
                if below[a, b, c] == c:
                    last = c
                above[a, b, c] = last


@kernel
def listed(marks, solid):
    """(n, 3) indices, in the order of memory, of voxels that are set in `marks` and not in `solid`."""
    count = 0
    for i in range(marks.shape[0]):
        for j in range(marks.shape[1]):
            for k in range(marks.shape[2]):
                if marks[i, j, k] > solid[i, j, k]:
                    count += 1
    out = np.empty((count, 3), np.int64)
    count = 0
    for i in range(marks.shape[0]):
        for j in range(marks.shape[1]):
            for k in range(marks.shape[2]):
                if marks[i, j, k] > solid[i, j, k]:
                    out[count, 0] = i
                    out[count, 1] = j
                    out[count, 2] = k
                    count += 1
    return out


@threaded
def smallest_distances(voxels, above, below, moments, least, columns, lengths, corners, cut, out):
    """Smallest Mahalanobis distance from voxel centres to surface corners.

    The covariance at a voxel's own centre is its metric. Lines of corners along the last axis are
    looked at one after the other, the nearest first. What the first two components of a displacement say of
    its square is their own Mahalanobis distance; given them, the third has a mean and a variance of its
    own, so that on a line the square is a parabola and only the surface corners on either side of its
    lowest point matter.

    Parameters
    ----------
    voxels : (n, 3) int array
        Indices in the lattice's box; fastest when neighbours along the last axis follow each other.
    above, below : int16 arrays
        See `surface_along_lines`.
    moments : (3, 4, 3, 4) float array
        Covariance of the displacement ``[G, u] (i, j, k, 1)`` at a voxel, in voxels.
    least : float
        Added to the variance along every axis, so that there is an inverse.
    columns : (m, 2) int array
        From a voxel to a line of corners, by increasing length.
    lengths : (m,) float array
        Squared voxels from the voxel's centre to that line.
    corners : (c, 3) int array
        All surface corners, to be gone through one by one instead; none for the lines.
    cut : float
        Distances of this and more do not matter.
    out : (n,) float array
        Receives distances, infinity for those that do not matter.
    """
    nx, ny, nz = above.shape
    p = np.empty(4)
    p[3] = 1.0
    flat = np.empty((3, 3))  # the covariance on a line along the last axis: flat + slope k + bend k^2
    slope = np.empty((3, 3))
    bend = np.empty((3, 3))
    last_i, last_j = -1, -1
    for n in range(voxels.shape[0]):
        i, j, k = voxels[n, 0], voxels[n, 1], voxels[n, 2]
        if i != last_i or j != last_j:
            last_i, last_j = i, j
            p[0], p[1], p[2] = i, j, 0.0
            for r in range(3):
                for c in range(r, 3):
                    flat[r, c] = least if r == c else 0.0
                    slope[r, c] = 0.0
                    for u in range(4):
                        for v in range(4):
                            flat[r, c] += p[u] * moments[r, u, c, v] * p[v]
                        slope[r, c] += (moments[r, u, c, 2] + moments[r, 2, c, u]) * p[u]
                    bend[r, c] = moments[r, 2, c, 2]
        xx = flat[0, 0] + k * (slope[0, 0] + k * bend[0, 0])
        yy = flat[1, 1] + k * (slope[1, 1] + k * bend[1, 1])
        zz = flat[2, 2] + k * (slope[2, 2] + k * bend[2, 2])
        xy = flat[0, 1] + k * (slope[0, 1] + k * bend[0, 1])
        xz = flat[0, 2] + k * (slope[0, 2] + k * bend[0, 2])
        yz = flat[1, 2] + k * (slope[1, 2] + k * bend[1, 2])
        det = xx * yy - xy * xy
        ixx, iyy, ixy = yy / det, xx / det, -xy / det
        gx, gy = ixx * xz + ixy * yz, ixy * xz + iyy * yz
        sharp = 1.0 / (zz - gx * xz - gy * yz)
        widest = (0.5 * (xx + yy) + sqrt(0.25 * (xx - yy) ** 2 + xy * xy)) * (1 + 1e-9)
        best = cut * cut
        for m in range(corners.shape[0]):
            s, t = corners[m, 0] - i - 0.5, corners[m, 1] - j - 0.5
            u = corners[m, 2] - k - 0.5 - gx * s - gy * t
            best = min(best, ixx * s * s + 2 * ixy * s * t + iyy * t * t + sharp * u * u)
        for m in range(columns.shape[0] if corners.shape[0] == 0 else 0):
            if lengths[m] >= best * widest:
                break
            a, b = i + columns[m, 0], j + columns[m, 1]
            if a < 0 or b < 0 or a >= nx or b >= ny:
                continue
            s, t = columns[m, 0] - 0.5, columns[m, 1] - 0.5
            base = ixx * s * s + 2 * ixy * s * t + iyy * t * t
            if base >= best:
                continue
            lowest = k + 0.5 + gx * s + gy * t
            c = min(max(int(floor(lowest)), -1), nz - 1)
            if c < nz - 1:
                u = above[a, b, c + 1] - lowest
                best = min(best, base + sharp * u * u)
            if c >= 0:
                u = below[a, b, c] - lowest
                best = min(best, base + sharp * u * u)
        out[n] = sqrt(best) if best < cut * cut else np.inf
