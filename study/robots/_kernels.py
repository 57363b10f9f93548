"""Compiled loops: voxels a rounded corner cuts beyond the planned one, bone met along a path."""

from __future__ import annotations

import numba as nb
import numpy as np


@nb.njit(cache=True)
def _squared_to_box(x, y, z, i, j, k, h0, h1, h2):
    # Squared mm from (x, y, z) to the box of voxel (i, j, k) whose half sizes are h.
    a = max(abs(x - 2 * h0 * i) - h0, 0.0)
    b = max(abs(y - 2 * h1 * j) - h1, 0.0)
    c = max(abs(z - 2 * h2 * k) - h2, 0.0)
    return a * a + b * b + c * c


@nb.njit(cache=True)
def _extra_voxels(start, u, n, w, reach, turn, spacing, radius, count, out):
    """Offsets the burr overlaps on the arc and not on the two legs it replaces; how many.

    `start` is the corner relative to the centre of its voxel; u, w the directions into and out of
    it, n the unit normal of u towards w; `reach` mm of each leg are replaced.
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
    b0 = int(np.floor((widened + reach) / spacing[0] + 1.0))
    b1 = int(np.floor((widened + reach) / spacing[1] + 1.0))
    b2 = int(np.floor((widened + reach) / spacing[2] + 1.0))
    far = (widened + reach) ** 2
    found = 0
    for i in range(-b0, b0 + 1):
        for j in range(-b1, b1 + 1):
            for k in range(-b2, b2 + 1):
                corner = _squared_to_box(start[0], start[1], start[2], i, j, k, h0, h1, h2)
                if corner < inner or corner > far:
                    continue
                cut = False
                for s in range(count):
                    if _squared_to_box(arc[s, 0], arc[s, 1], arc[s, 2], i, j, k, h0, h1, h2) < outer:
                        cut = True
                        break
                if not cut:
                    continue
                for s in range(2 * count):
                    if _squared_to_box(legs[s, 0], legs[s, 1], legs[s, 2], i, j, k, h0, h1, h2) < inner:
                        cut = False
                        break
                if cut and found < out.shape[0]:
                    out[found, 0], out[found, 1], out[found, 2] = i, j, k
                    found += 1
                elif cut:
                    return -1
    return found


@nb.njit(cache=True)
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
        if kind != current:
            current = kind
            found = _extra_voxels(starts[kind], into[kind], normals[kind], out_of[kind], reaches[kind],
                                  turns[kind], spacing, radius, count, extra)  # fmt: skip
        if found < 0:  # more than fits the table: refuse rather than guess
            safe[corner] = False
            continue
        for e in range(found):
            i = voxels[corner, 0] + extra[e, 0]
            j = voxels[corner, 1] + extra[e, 1]
            k = voxels[corner, 2] + extra[e, 2]
            if not (0 <= i < labels.shape[0] and 0 <= j < labels.shape[1] and 0 <= k < labels.shape[2]):
                safe[corner] = False
                break
            label = labels[i, j, k]
            if label != air and label != target:
                safe[corner] = False
                break
    return safe


@nb.njit(cache=True)
def weight_removed(labels, target, weight, voxels, spacing, radius):
    """Sum of `weight` over the target voxels first overlapped by the burr at each of the voxels (n, 3)."""
    h0, h1, h2 = spacing[0] / 2, spacing[1] / 2, spacing[2] / 2
    inner = radius * radius * (1 - 1e-12)
    b0 = int(np.floor(radius / spacing[0] + 0.5))
    b1 = int(np.floor(radius / spacing[1] + 0.5))
    b2 = int(np.floor(radius / spacing[2] + 0.5))
    half = np.full((2 * b0 + 1, 2 * b1 + 1), -1, np.int64)  # the element as one run along k per (i, j)
    for i in range(-b0, b0 + 1):
        for j in range(-b1, b1 + 1):
            for k in range(b2 + 1):
                if _squared_to_box(0.0, 0.0, 0.0, i, j, k, h0, h1, h2) < inner:
                    half[i + b0, j + b1] = k
    low = np.array([voxels[:, axis].min() for axis in range(3)]) - np.array([b0, b1, b2])
    high = np.array([voxels[:, axis].max() for axis in range(3)]) + np.array([b0, b1, b2]) + 1
    for axis in range(3):
        low[axis] = max(low[axis], 0)
        high[axis] = min(high[axis], labels.shape[axis])
    gone = np.zeros((max(high[0] - low[0], 0), max(high[1] - low[1], 0), max(high[2] - low[2], 0)), np.bool_)
    total = np.zeros(voxels.shape[0])
    for p in range(voxels.shape[0]):
        for i in range(max(voxels[p, 0] - b0, low[0]), min(voxels[p, 0] + b0 + 1, high[0])):
            for j in range(max(voxels[p, 1] - b1, low[1]), min(voxels[p, 1] + b1 + 1, high[1])):
                run = half[i - voxels[p, 0] + b0, j - voxels[p, 1] + b1]
                for k in range(max(voxels[p, 2] - run, low[2]), min(voxels[p, 2] + run + 1, high[2])):
                    if labels[i, j, k] == target and not gone[i - low[0], j - low[1], k - low[2]]:
                        gone[i - low[0], j - low[1], k - low[2]] = True
                        total[p] += weight[i, j, k]
    return total
