"""Compiled exact test of the drill's cylinders against solid voxels; touching is not overlapping."""

from __future__ import annotations

from math import ceil, floor, hypot, sqrt

import numpy as np

from study._compiled import inner, kernel


@inner
def _distance_to_segment(x0, y0, x1, y1):
    dx, dy = x1 - x0, y1 - y0
    length = dx * dx + dy * dy
    t = 0.0
    if length > 0.0:
        t = min(1.0, max(0.0, -(x0 * dx + y0 * dy) / length))
    return hypot(x0 + t * dx, y0 + t * dy)


@inner
def _cross(a, b, out):
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@kernel
def cylinder_overlaps_box(centre, axis, radius, start, end, box_low, box_high):
    """Whether a solid cylinder and a box overlap, exactly (touching is not overlapping).

    The cylinder has its axis through `centre` along the unit vector `axis`, from `start` to `end` mm.
    The box, cut by the planes of the two end caps, is projected along the axis; what is left is the
    distance from a point to a convex polygon.
    """
    # Does the axis itself pass through the box between the caps?
    enter, leave = start, end
    for n in range(3):
        if axis[n] == 0.0:
            if not box_low[n] < centre[n] < box_high[n]:
                enter, leave = 1.0, 0.0
                break
        else:
            a = (box_low[n] - centre[n]) / axis[n]
            z = (box_high[n] - centre[n]) / axis[n]
            enter, leave = max(enter, min(a, z)), min(leave, max(a, z))
    if enter < leave:
        return True
    # Vertices of the box between the caps, and where its edges cross them, seen along the axis.
    small = 0
    for n in range(3):
        if abs(axis[n]) < abs(axis[small]):
            small = n
    helper = np.zeros(3)
    helper[small] = 1.0
    e1, e2 = np.empty(3), np.empty(3)
    _cross(axis, helper, e1)
    length = sqrt(e1[0] ** 2 + e1[1] ** 2 + e1[2] ** 2)
    for n in range(3):
        e1[n] /= length
    _cross(axis, e1, e2)
    x = np.empty(8)
    y = np.empty(8)
    t = np.empty(8)
    for v in range(8):
        p0 = (box_high[0] if v & 1 else box_low[0]) - centre[0]
        p1 = (box_high[1] if v & 2 else box_low[1]) - centre[1]
        p2 = (box_high[2] if v & 4 else box_low[2]) - centre[2]
        t[v] = p0 * axis[0] + p1 * axis[1] + p2 * axis[2]
        x[v] = p0 * e1[0] + p1 * e1[1] + p2 * e1[2]
        y[v] = p0 * e2[0] + p1 * e2[1] + p2 * e2[2]
    if not (min(t) < end and max(t) > start):
        return False  # at most touching a cap's plane
    hull_x = np.empty(32)
    hull_y = np.empty(32)
    n_hull = 0
    for v in range(8):
        if start <= t[v] <= end:
            hull_x[n_hull], hull_y[n_hull] = x[v], y[v]
            n_hull += 1
        for bit in (1, 2, 4):
            o = v | bit
            if o == v:
                continue
            for cap in (start, end):
                if (t[v] - cap) * (t[o] - cap) < 0.0:
                    f = (cap - t[v]) / (t[o] - t[v])
                    hull_x[n_hull] = x[v] + f * (x[o] - x[v])
                    hull_y[n_hull] = y[v] + f * (y[o] - y[v])
                    n_hull += 1
    limit = radius * (1 - 1e-12)
    for a in range(n_hull):
        for z in range(a, n_hull):
            if _distance_to_segment(hull_x[a], hull_y[a], hull_x[z], hull_y[z]) < limit:
                return True
    return False


@kernel
def drill_overlaps_voxels(solid, spacing, position, axis, cylinders, hit):
    """Whether the drill's shaft at a pose overlaps a solid voxel; `hit` receives the voxel's index.

    `position` is in mm of the index frame (voxel centre = index x spacing). Exact: every solid voxel
    near a cylinder is tested by `cylinder_overlaps_box`.
    """
    shape = solid.shape
    low = np.empty(3)
    high = np.empty(3)
    for c in range(cylinders.shape[0]):
        radius, start, end = cylinders[c, 0], cylinders[c, 1], cylinders[c, 2]
        first = np.empty(3, np.int64)
        last = np.empty(3, np.int64)
        for n in range(3):
            a = position[n] + axis[n] * start
            z = position[n] + axis[n] * end
            m, o = (n + 1) % 3, (n + 2) % 3  # not 1 - axis[n]^2, which rounds a slight tilt away
            reach = radius * sqrt(axis[m] * axis[m] + axis[o] * axis[o]) + spacing[n] / 2
            first[n] = max(0, ceil((min(a, z) - reach) / spacing[n]))
            last[n] = min(shape[n] - 1, floor((max(a, z) + reach) / spacing[n]))
        bound = radius + 0.5 * sqrt(spacing[0] ** 2 + spacing[1] ** 2 + spacing[2] ** 2)
        for i in range(first[0], last[0] + 1):
            p0 = i * spacing[0] - position[0]
            for j in range(first[1], last[1] + 1):
                p1 = j * spacing[1] - position[1]
                # Voxels of this column whose centres are within `bound` of the axis: a k interval.
                c0, c1 = p0 * axis[0] + p1 * axis[1], p0 * p0 + p1 * p1
                k0, k1 = first[2], last[2]
                square = axis[0] * axis[0] + axis[1] * axis[1]
                if square > 1e-9:
                    middle = c0 * axis[2] / square
                    rest = middle * middle - (c1 - c0 * c0 - bound * bound) / square
                    if rest < 0.0:
                        continue
                    rest = sqrt(rest)
                    k0 = max(k0, floor((position[2] + middle - rest) / spacing[2]))
                    k1 = min(k1, ceil((position[2] + middle + rest) / spacing[2]))
                elif c1 > (bound + sqrt(square) * end) ** 2:
                    continue
                for k in range(k0, k1 + 1):
                    if solid[i, j, k] == 0:
                        continue
                    low[0], high[0] = (i - 0.5) * spacing[0], (i + 0.5) * spacing[0]
                    low[1], high[1] = (j - 0.5) * spacing[1], (j + 0.5) * spacing[1]
                    low[2], high[2] = (k - 0.5) * spacing[2], (k + 0.5) * spacing[2]
                    if cylinder_overlaps_box(position, axis, radius, start, end, low, high):
                        hit[0], hit[1], hit[2] = i, j, k
                        return True
    return False
