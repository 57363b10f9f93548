"""Compiled loops: voxels a rounded corner cuts beyond the planned one, bone met along a path."""

from __future__ import annotations

import numpy as np

from study._compiled import inner, kernel
from study.planners.simulation._kernels import segment_overlaps_box


@inner
def _squared_to_box(x, y, z, i, j, k, h0, h1, h2):
    # Squared mm from (x, y, z) to the box of voxel (i, j, k) whose half sizes are h.
    a = max(abs(x - 2 * h0 * i) - h0, 0.0)
    b = max(abs(y - 2 * h1 * j) - h1, 0.0)
    c = max(abs(z - 2 * h2 * k) - h2, 0.0)
    return a * a + b * b + c * c


@inner
def _is_protected(labels, air, target, i, j, k):
    if not (0 <= i < labels.shape[0] and 0 <= j < labels.shape[1] and 0 <= k < labels.shape[2]):
        return True
    return labels[i, j, k] != air and labels[i, j, k] != target


@inner
def _only_arc(arc, legs, i, j, k, h0, h1, h2, outer, inner):
    # Overlapped from a sample of the arc and from none of the legs.
    cut = False
    for s in range(arc.shape[0]):
        if _squared_to_box(arc[s, 0], arc[s, 1], arc[s, 2], i, j, k, h0, h1, h2) < outer:
            cut = True
            break
    if not cut:
        return False
    for s in range(legs.shape[0]):
        if _squared_to_box(legs[s, 0], legs[s, 1], legs[s, 2], i, j, k, h0, h1, h2) < inner:
            return False
    return True


@inner
def _extra_voxels(start, u, n, w, reach, turn, spacing, radius, count, labels, air, target, at, alone, out):
    """Offsets the burr overlaps on the arc and not on the two legs it replaces; how many.

    `start` is the corner relative to the centre of its voxel; u, w the directions into and out of
    it, n the unit normal of u towards w; `reach` mm of each leg are replaced. If `alone`, only the
    protected voxels around the voxel `at` are looked at, which is quicker for a single corner.
    """
    h0, h1, h2 = spacing[0] / 2, spacing[1] / 2, spacing[2] / 2
    bend = reach / np.tan(turn / 2)
    gap = bend * turn / (count - 1)
    # Between two samples the ball bulges beyond the union of the sampled balls by no more than this.
    widened = np.sqrt(radius * radius + gap * gap / 4) + gap * gap / (8 * bend)
    outer = widened * widened
    inner = radius * radius * (1 - 1e-12)
    arc = np.empty((count, 3))
    legs = np.empty((2 * count, 3))
    for s in range(count):
        angle = turn * s / (count - 1)
        along, across = bend * np.sin(angle), bend * (1 - np.cos(angle))
        back = reach * s / (count - 1)
        for axis in range(3):
            arc[s, axis] = start[axis] + (along - reach) * u[axis] + across * n[axis]
            legs[s, axis] = start[axis] - back * u[axis]
            legs[count + s, axis] = start[axis] + back * w[axis]
    # No arc sample is further than `half` from the middle one, no extra voxel than widened + half.
    middle = count // 2
    half = 0.0
    for s in range(count):
        apart = 0.0
        for axis in range(3):
            apart += (arc[s, axis] - arc[middle, axis]) ** 2
        half = max(half, np.sqrt(apart))
    far = widened + half
    a, b, c = arc[middle, 0], arc[middle, 1], arc[middle, 2]
    found = 0
    for i in range(int(np.floor((a - far) / spacing[0])), int(np.ceil((a + far) / spacing[0])) + 1):
        across = max(abs(a - spacing[0] * i) - h0, 0.0) ** 2
        if across > far * far:
            continue
        for j in range(int(np.floor((b - far) / spacing[1])), int(np.ceil((b + far) / spacing[1])) + 1):
            rest = far * far - across - max(abs(b - spacing[1] * j) - h1, 0.0) ** 2
            if rest < 0.0:
                continue
            span = np.sqrt(rest) + h2
            for k in range(int(np.ceil((c - span) / spacing[2])), int(np.floor((c + span) / spacing[2])) + 1):
                if alone and not _is_protected(labels, air, target, at[0] + i, at[1] + j, at[2] + k):
                    continue
                if _squared_to_box(start[0], start[1], start[2], i, j, k, h0, h1, h2) < inner:
                    continue
                if _only_arc(arc, legs, i, j, k, h0, h1, h2, outer, inner):
                    if found == out.shape[0]:
                        return -1
                    out[found, 0], out[found, 1], out[found, 2] = i, j, k
                    found += 1
    return found


@kernel
def corners_are_safe(labels, air, target, voxels, kinds, order, starts, into, normals, out_of, reaches, turns,
                     spacing, radius, count):  # fmt: skip
    """Per corner, whether its arc cuts no protected voxel beyond those its legs cut.

    voxels (k, 3) of the corners; kinds (k,) the row of starts, into, ... that describes each; order
    (k,) sorts the corners by kind. Voxels outside the image count as protected.
    """
    safe = np.ones(voxels.shape[0], np.bool_)
    extra = np.empty((8192, 3), np.int64)
    current, found = -1, 0
    for position in range(order.size):
        corner = order[position]
        kind = kinds[corner]
        at = voxels[corner]
        if kind != current:
            current = kind
            alone = position + 1 == order.size or kinds[order[position + 1]] != kind
            found = _extra_voxels(starts[kind], into[kind], normals[kind], out_of[kind], reaches[kind],
                                  turns[kind], spacing, radius, count, labels, air, target, at, alone,
                                  extra)  # fmt: skip
        if found < 0:  # more than fits the table: refuse rather than guess
            safe[corner] = False
        for e in range(found):
            if _is_protected(
                labels, air, target, at[0] + extra[e, 0], at[1] + extra[e, 1], at[2] + extra[e, 2]
            ):
                safe[corner] = False
                break
    return safe


@kernel
def weight_removed(labels, target, weight, points, spacing, radius):
    """Sum of `weight` over the target voxels first overlapped by the burr on its way to each point.

    points (n, 3) in mm from the centre of voxel (0, 0, 0), along the grid; the burr moves straight.
    """
    h0, h1, h2 = spacing[0] / 2, spacing[1] / 2, spacing[2] / 2
    gone = np.zeros(labels.shape, np.bool_)
    total = np.zeros(points.shape[0])
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for p in range(points.shape[0]):
        a, b = points[max(p - 1, 0)], points[p]
        for axis in range(3):
            first, last = min(a[axis], b[axis]) - radius, max(a[axis], b[axis]) + radius
            low[axis] = max(int(np.ceil(first / spacing[axis] - 0.5)), 0)
            high[axis] = min(int(np.floor(last / spacing[axis] + 0.5)), labels.shape[axis] - 1)
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    if labels[i, j, k] != target or gone[i, j, k]:
                        continue
                    x, y, z = i * spacing[0], j * spacing[1], k * spacing[2]
                    if segment_overlaps_box(a[0] - x, a[1] - y, a[2] - z, b[0] - x, b[1] - y, b[2] - z,
                                            h0, h1, h2, radius):  # fmt: skip
                        gone[i, j, k] = True
                        total[p] += weight[i, j, k]
    return total
