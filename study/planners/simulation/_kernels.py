"""Compiled changes of the two simulations (Siebold, 2.2): what moving the burr removes."""

from __future__ import annotations

from math import sqrt

import numpy as np

from study._compiled import inner, kernel
from study.planners.freedom._kernels import remove
from study.planners.simulation.state._kernels import BOUNDARY, LEFT, PROTECTED, TARGET, UNMILLED

ADD, TAKE = np.int64(1), np.int64(-1)  # not plain numbers, each of which numba would compile for


@inner
def _ball_overlaps_box(x, y, z, hx, hy, hz, radius):
    x, y, z = max(0.0, abs(x) - hx), max(0.0, abs(y) - hy), max(0.0, abs(z) - hz)
    return x * x + y * y + z * z < radius * radius * (1 - 1e-12)


@kernel
def segment_overlaps_box(ax, ay, az, bx, by, bz, hx, hy, hz, radius):
    """Whether a ball moving from a to b overlaps a box centred on the origin with half sizes h.

    The squared distance from a point on the segment to the box is convex along the segment: bisect
    its derivative.
    """
    limit = radius * radius * (1 - 1e-12)
    dx, dy, dz = bx - ax, by - ay, bz - az
    low, high = 0.0, 1.0
    for end in range(2):
        t = 0.0 if end == 0 else 1.0
        x = max(0.0, abs(ax + t * dx) - hx)
        y = max(0.0, abs(ay + t * dy) - hy)
        z = max(0.0, abs(az + t * dz) - hz)
        if x * x + y * y + z * z < limit:
            return True
    mx, my, mz = ax + 0.5 * dx, ay + 0.5 * dy, az + 0.5 * dz
    x, y, z = max(0.0, abs(mx) - hx), max(0.0, abs(my) - hy), max(0.0, abs(mz) - hz)
    if sqrt(x * x + y * y + z * z) > radius + 0.5 * sqrt(dx * dx + dy * dy + dz * dz):
        return False
    for _ in range(60):
        t = 0.5 * (low + high)
        px, py, pz = ax + t * dx, ay + t * dy, az + t * dz
        x, y, z = max(0.0, abs(px) - hx), max(0.0, abs(py) - hy), max(0.0, abs(pz) - hz)
        if x * x + y * y + z * z < limit:
            return True
        slope = (x if px > 0 else -x) * dx + (y if py > 0 else -y) * dy + (z if pz > 0 else -z) * dz
        if slope > 0:
            high = t
        else:
            low = t
    return False


@kernel
def swept_parts(longest, steps, radius, offsets):
    """Voxels a ball newly overlaps on each part of a straight move to a non-negative offset.

    A move to (a, b, c) has max(a, b, c) equal parts; what the ball overlaps where a part begins has
    gone before. Fills `offsets` (n, 3) with the voxels, from the start voxel, as far as they fit; other
    signs are mirror images. Returns first and count ``[a, b, c, part]`` and how many there are.
    """
    n = longest + 1
    first = np.zeros((n, n, n, n), np.int64)
    count = np.zeros((n, n, n, n), np.int64)
    reach = np.empty(3, np.int64)
    for k in range(3):
        reach[k] = int(radius / steps[k] + 0.5) + 1
    used = 0
    hx, hy, hz = steps[0] / 2, steps[1] / 2, steps[2] / 2
    for a in range(n):
        for b in range(n):
            for c in range(n):
                parts = max(a, b, c)
                for part in range(1, parts + 1):
                    s, e = (part - 1) / parts, part / parts
                    first[a, b, c, part] = used
                    for i in range(int(s * a) - reach[0], int(e * a) + reach[0] + 2):
                        x, x_end = (s * a - i) * steps[0], (e * a - i) * steps[0]
                        for j in range(int(s * b) - reach[1], int(e * b) + reach[1] + 2):
                            y, y_end = (s * b - j) * steps[1], (e * b - j) * steps[1]
                            for k in range(int(s * c) - reach[2], int(e * c) + reach[2] + 2):
                                z, z_end = (s * c - k) * steps[2], (e * c - k) * steps[2]
                                if _ball_overlaps_box(x, y, z, hx, hy, hz, radius):
                                    continue
                                if not segment_overlaps_box(x, y, z, x_end, y_end, z_end, hx, hy, hz, radius):
                                    continue
                                if used < offsets.shape[0]:
                                    offsets[used, 0], offsets[used, 1], offsets[used, 2] = i, j, k
                                used += 1
                    count[a, b, c, part] = used - first[a, b, c, part]
    return first, count, used


@inner
def _shift(sums, rows, layer, depth, lateral, by):
    # Every position whose rows hold the voxel.
    for r in range(rows.shape[0]):
        row = sums[layer - rows[r, 0], depth - rows[r, 1]]
        for m in range(lateral - rows[r, 2], lateral + rows[r, 2] + 1):
            row[m] += by


@inner
def _shift_live(live, layer, depth, lateral, sign):
    if live.load.size > 0:
        _shift(
            live.load, live.rows, layer, depth, lateral, np.int32(sign * live.density[layer, depth, lateral])
        )
    if live.ahead.size > 0:
        _shift(live.ahead[0], live.rows, layer, depth, lateral, np.int32(sign))
        _shift(live.ahead[1], live.rows, layer, depth, lateral, np.int32(sign * layer))
        _shift(live.ahead[2], live.rows, layer, depth, lateral, np.int32(sign * depth))
        _shift(live.ahead[3], live.rows, layer, depth, lateral, np.int32(sign * lateral))


@kernel
def count_live(solid, live):
    """Fill the sums of `live`, which are zero, from the targeted bone."""
    for layer in range(solid.shape[0]):
        for d in range(solid.shape[1]):
            for b in range(solid.shape[2]):
                if solid[layer, d, b] == TARGET:
                    _shift_live(live, layer, d, b, ADD)


@kernel
def count_top(solid, top_rows, modified, top):
    """Fill `top` from scratch where `modified` is set, by prefix sums along the lateral axis."""
    n_layer, n_depth, n_lateral = solid.shape
    before = np.zeros((n_layer, n_depth, n_lateral + 1), np.int32)
    for layer in range(n_layer):
        for d in range(n_depth):
            for b in range(n_lateral):
                before[layer, d, b + 1] = before[layer, d, b] + (solid[layer, d, b] == TARGET)
    for layer in range(n_layer):
        for d in range(n_depth):
            for b in range(n_lateral):
                if modified[layer, d, b] == 0:
                    continue
                n = 0
                for r in range(top_rows.shape[0]):
                    row = before[layer + top_rows[r, 0], d + top_rows[r, 1]]
                    n += row[b + top_rows[r, 2] + 1] - row[b - top_rows[r, 2]]
                top[layer, d, b] = n


@kernel
def count_covers(modified, allowed, reach, near, covers, crowded):
    """Fill `covers` and `crowded` within the box `near` from scratch."""
    for layer in range(near[0, 0], near[1, 0]):
        for d in range(near[0, 1], near[1, 1]):
            for b in range(near[0, 2], near[1, 2]):
                if not allowed[layer, d, b]:
                    continue
                n = 0
                blocked = False
                for i in range(layer - reach[0], layer + reach[0] + 1):
                    for j in range(d - reach[1], d + reach[1] + 1):
                        for k in range(b - reach[2], b + reach[2] + 1):
                            if modified[i, j, k] == UNMILLED:
                                n += 1
                            if not allowed[i, j, k]:
                                blocked = True
                covers[layer, d, b] = n
                crowded[layer, d, b] = blocked


@inner
def _mill(sim, layer, depth, lateral):
    sim.solid[layer, depth, lateral] = 0
    remove(sim, layer, depth, lateral)
    _shift(sim.top, sim.top_rows, layer, depth, lateral, np.uint16(65535))  # minus one, modulo 2^16
    _shift_live(sim.live, layer, depth, lateral, TAKE)


@inner
def mill_ball(sim, layer, depth, lateral):
    """Remove the targeted voxels the burr overlaps at a voxel; how many there were."""
    removed = 0
    for n in range(sim.element.shape[0]):
        i, j, k = layer + sim.element[n, 0], depth + sim.element[n, 1], lateral + sim.element[n, 2]
        if sim.solid[i, j, k] == TARGET:
            _mill(sim, i, j, k)
            removed += 1
    return removed


@inner
def sweep_is_safe(sim, layer, depth, lateral, move):
    """Whether the burr cuts no protected voxel on a straight move of up to reach + 1 voxels."""
    a, b, c = abs(move[0]), abs(move[1]), abs(move[2])
    for part in range(1, max(a, b, c) + 1):
        start = sim.sweep_first[a, b, c, part]
        for n in range(start, start + sim.sweep_count[a, b, c, part]):
            i = layer + (sim.sweep_offsets[n, 0] if move[0] >= 0 else -sim.sweep_offsets[n, 0])
            j = depth + (sim.sweep_offsets[n, 1] if move[1] >= 0 else -sim.sweep_offsets[n, 1])
            k = lateral + (sim.sweep_offsets[n, 2] if move[2] >= 0 else -sim.sweep_offsets[n, 2])
            if sim.solid[i, j, k] == PROTECTED:
                return False
    return True


@inner
def mill_sweep(sim, layer, depth, lateral, move, part):
    """Remove the targeted voxels the burr overlaps on one part of a straight move; how many."""
    a, b, c = abs(move[0]), abs(move[1]), abs(move[2])
    removed = 0
    start = sim.sweep_first[a, b, c, part]
    for n in range(start, start + sim.sweep_count[a, b, c, part]):
        i = layer + (sim.sweep_offsets[n, 0] if move[0] >= 0 else -sim.sweep_offsets[n, 0])
        j = depth + (sim.sweep_offsets[n, 1] if move[1] >= 0 else -sim.sweep_offsets[n, 1])
        k = lateral + (sim.sweep_offsets[n, 2] if move[2] >= 0 else -sim.sweep_offsets[n, 2])
        if sim.solid[i, j, k] == TARGET:
            _mill(sim, i, j, k)
            removed += 1
    return removed


@inner
def _uncover(sim, layer, depth, lateral):
    for i in range(layer - sim.reach[0], layer + sim.reach[0] + 1):
        for j in range(depth - sim.reach[1], depth + sim.reach[1] + 1):
            for k in range(lateral - sim.reach[2], lateral + sim.reach[2] + 1):
                sim.covers[i, j, k] -= np.uint16(1)


@inner
def clear_supervoxel(sim, layer, depth, lateral):
    """Mark what the supervoxel clears: its centre, and whatever in it is not target boundary."""
    if sim.modified[layer, depth, lateral] == BOUNDARY:
        sim.modified[layer, depth, lateral] = 0
        sim.counters[LEFT] -= 1
        sim.left_at_depth[depth] -= 1
    for i in range(layer - sim.reach[0], layer + sim.reach[0] + 1):
        for j in range(depth - sim.reach[1], depth + sim.reach[1] + 1):
            for k in range(lateral - sim.reach[2], lateral + sim.reach[2] + 1):
                if sim.modified[i, j, k] == UNMILLED:
                    sim.modified[i, j, k] = 0
                    sim.counters[LEFT] -= 1
                    sim.left_at_depth[j] -= 1
                    _uncover(sim, i, j, k)
