"""Compiled replay of a plan in the volume's own order: sweep the burr, then the shaft, by segments."""

from __future__ import annotations

from math import acos, ceil, floor, sin, sqrt

import numpy as np

from study._compiled import inner, kernel
from study.collision.exact._kernels import drill_overlaps_voxels
from study.planners.simulation._kernels import segment_overlaps_box

FINE, CUT_PROTECTED, LEFT_IMAGE, SHAFT_HIT, WRONG_REMOVAL = 0, 1, 2, 3, 4


@inner
def _sweep_ball(solid, spacing, a, b, radius, hit):
    """Remove what a ball moving from a to b overlaps. Returns (status, voxels removed)."""
    first = np.empty(3, np.int64)
    last = np.empty(3, np.int64)
    for n in range(3):
        first[n] = floor((min(a[n], b[n]) - radius) / spacing[n] + 0.5)
        last[n] = ceil((max(a[n], b[n]) + radius) / spacing[n] - 0.5)
    removed = 0
    for i in range(first[0], last[0] + 1):
        for j in range(first[1], last[1] + 1):
            for k in range(first[2], last[2] + 1):
                inside = 0 <= i < solid.shape[0] and 0 <= j < solid.shape[1] and 0 <= k < solid.shape[2]
                if inside and solid[i, j, k] == 0:
                    continue
                x, y, z = i * spacing[0], j * spacing[1], k * spacing[2]
                if not segment_overlaps_box(
                    a[0] - x, a[1] - y, a[2] - z, b[0] - x, b[1] - y, b[2] - z,
                    spacing[0] / 2, spacing[1] / 2, spacing[2] / 2, radius,
                ):  # fmt: skip
                    continue
                hit[0], hit[1], hit[2] = i, j, k
                if not inside:
                    return LEFT_IMAGE, removed
                if solid[i, j, k] == 1:
                    return CUT_PROTECTED, removed
                solid[i, j, k] = 0
                removed += 1
    return FINE, removed


@kernel
def replay(solid, spacing, points, axes, removed, radius, cylinders, lever, hit):
    """Replay a plan on `solid` (1 protected, 2 target), which is changed.

    `points` are mm of the index frame (index x spacing), `axes` unit vectors in it, `removed` voxels
    claimed per point, `lever` the longest distance in mm from the burr to anything the shaft can meet.
    Returns (status, row, voxels removed there, poses checked).

    Within a segment the burr goes first. Between two poses a step h apart every point of the shaft
    stays within the union of both ends when these are widened to sqrt(R^2 + (h/2)^2) and h longer
    (the mean of the squared distances to both axes, weighted by the way gone, exceeds R^2 by at most
    h^2/4), so checking widened ends is checking the sweep.
    """
    poses = 0
    voxel = sqrt(spacing[0] ** 2 + spacing[1] ** 2 + spacing[2] ** 2)
    wide = cylinders.copy()
    at = np.empty(3)
    axis = np.empty(3)
    for row in range(points.shape[0]):
        before = row - 1 if row > 0 else 0
        a, b = points[before], points[row]
        u, v = axes[before], axes[row]
        length = sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2)
        angle = acos(min(1.0, max(-1.0, u[0] * v[0] + u[1] * v[1] + u[2] * v[2])))
        status, n = _sweep_ball(solid, spacing, a, b, radius, hit)
        if status != FINE:
            return status, row, n, poses
        if abs(n - removed[row]) > 1e-3:
            return WRONG_REMOVAL, row, n, poses
        if angle < 1e-7:  # rounding of a file's digits is no turn
            angle = 0.0
        parts = max(1, ceil(length / voxel - 1e-6), ceil(lever * angle / (0.72 * voxel)))
        h = (length + lever * angle) / parts
        for c in range(cylinders.shape[0]):
            wide[c, 0] = sqrt(cylinders[c, 0] ** 2 + 0.25 * h * h)
            wide[c, 1] = max(0.0, cylinders[c, 1] - h)
            wide[c, 2] = cylinders[c, 2] + h
        for part in range(1, parts + 1):
            f = part / parts
            for n_axis in range(3):
                at[n_axis] = a[n_axis] + f * (b[n_axis] - a[n_axis])
            if angle > 0.0:
                p, q = sin((1.0 - f) * angle) / sin(angle), sin(f * angle) / sin(angle)
            else:
                p, q = 0.0, 1.0
            for n_axis in range(3):
                axis[n_axis] = p * u[n_axis] + q * v[n_axis]
            poses += 1
            if drill_overlaps_voxels(solid, spacing, at, axis, wide, hit):
                return SHAFT_HIT, row, n, poses
    return FINE, points.shape[0], 0, poses
