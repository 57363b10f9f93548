"""Compiled loops of the 4-DOF accessibility check, in the planner's canonical frame.

Arrays are indexed ``[layer, depth, lateral]``: layers along the rotation axis, depth growing from the
outside into the bone, lateral the remaining axis. In the tilt plane ``u`` points out of the bone
(towards the drill body) and ``w`` along the lateral axis; a shaft tilted by ``theta`` runs along
``(cos theta, sin theta)``. A cylinder is the half-infinite strip ``t >= start, |m| <= radius``:
cylinders further out are wider, so where one ends does not matter.
"""

from __future__ import annotations

from math import acos, asin, atan2, ceil, cos, floor, hypot, inf, sin, sqrt, tan
from typing import NamedTuple

import numpy as np

from study._compiled import inner, kernel
from study._records import by_address

ONE = np.uint64(1)
ALL = np.uint64(0xFFFFFFFFFFFFFFFF)
DE_BRUIJN = np.uint64(0x03F79D71B4CB0A89)
BIT_INDEX = np.zeros(64, np.int64)
for _bit in range(64):
    BIT_INDEX[((1 << _bit) * int(DE_BRUIJN) & int(ALL)) >> 58] = _bit


@by_address
class Shaft(NamedTuple):
    """What the window of accessible angles is computed from (arrays change as bone is removed)."""

    slab: np.ndarray  # uint8 [3, layer, depth, lateral]: solid voxels in the slab of each cylinder
    bits: np.ndarray  # uint64 [3, layer, depth, word]: cells of the collapsed slab that are occupied
    outermost: np.ndarray  # int64 [3, layer]: depth of the outermost occupied row of the slab at first
    low: np.ndarray  # float64 [3, row, lateral offset >= 0]: angular interval a cell blocks
    high: np.ndarray
    near: np.ndarray  # int64 [3, row]: lateral offset from which on cells of the row block at all
    valley: np.ndarray  # int64 [3, row]: lateral offset at which `low` is least
    half: np.ndarray  # int64 [3]: layers on each side of the middle one that a slab holds
    radius: np.ndarray  # float64 [3] mm, widened by the sweep between neighbouring positions
    start: np.ndarray  # float64 [3] mm
    inward: int  # rows of the table that lie deeper than the burr's centre
    step_layer: float  # mm
    step_depth: float
    step_lateral: float
    burr_radius: float  # mm
    max_tilt: float  # radians


@inner
def _widen(point_u, point_w, start, radius, low, high):
    rho = hypot(point_u, point_w)
    if rho < start * (1 - 1e-12):
        return low, high
    phi = atan2(point_w, point_u)
    if rho * rho >= start * start + radius * radius:
        delta = asin(min(1.0, radius / rho))
    else:
        delta = acos(min(1.0, start / rho))
    return min(low, phi - delta), max(high, phi + delta)


@inner
def blocked_interval(u0, u1, w0, w1, start, radius):
    """Angles at which the strip overlaps the box ``[u0, u1] x [w0, w1]``; (inf, -inf) if none.

    The strip first touches the box with a side or its front at a corner of the box, or with its own
    corner (at distance hypot(start, radius)) on an edge of the box: these points decide.
    """
    low, high = inf, -inf
    if u1 <= 0.0 and w0 < 0.0 < w1:  # straight behind the burr: out of reach of any tilt below 90 degrees
        return low, high
    for u in (u0, u1):
        for w in (w0, w1):
            low, high = _widen(u, w, start, radius, low, high)
    for circle in (hypot(start, radius) * (1 + 1e-13), start * (1 + 1e-13)):
        for u in (u0, u1):
            if abs(u) <= circle:
                w = sqrt(circle * circle - u * u)
                if w0 <= w <= w1:
                    low, high = _widen(u, w, start, radius, low, high)
                if w0 <= -w <= w1:
                    low, high = _widen(u, -w, start, radius, low, high)
        for w in (w0, w1):
            if abs(w) <= circle:
                u = sqrt(circle * circle - w * w)
                if u0 <= u <= u1:
                    low, high = _widen(u, w, start, radius, low, high)
                if u0 <= -u <= u1:
                    low, high = _widen(-u, w, start, radius, low, high)
    return low, high


@kernel
def interval_tables(shape, inward, half, radius, start, step_layer, step_depth, step_lateral, burr_radius):
    """Blocked interval of every cell relative to the burr's voxel; mirrored for negative lateral offsets.

    A cell whose voxels all overlap the burr never blocks: the burr removes them on arrival.
    """
    n_rows, n_lateral = shape
    low = np.full((3, n_rows, n_lateral), inf)
    high = np.full((3, n_rows, n_lateral), -inf)
    near = np.full((3, n_rows), n_lateral)
    valley = np.full((3, n_rows), n_lateral - 1)
    limit = burr_radius * burr_radius * (1 - 1e-12)
    for i in range(3):
        across = max(0.0, half[i] - 0.5) * step_layer
        for row in range(n_rows):
            u = (row - inward) * step_depth
            for m in range(n_lateral):
                w = m * step_lateral
                near_u = max(0.0, abs(u) - step_depth / 2)
                near_w = max(0.0, w - step_lateral / 2)
                if near_u * near_u + near_w * near_w + across * across < limit:
                    continue
                low[i, row, m], high[i, row, m] = blocked_interval(
                    u - step_depth / 2, u + step_depth / 2, w - step_lateral / 2, w + step_lateral / 2,
                    start[i], radius[i],
                )  # fmt: skip
                if low[i, row, m] != inf:
                    near[i, row] = min(near[i, row], m)
                    if low[i, row, m] < low[i, row, valley[i, row]]:
                        valley[i, row] = m
    return low, high, near, valley


@kernel
def collapse_slabs(solid, half, slab, bits, outermost):
    """Count solid voxels of every slab by a running sum over the layers; set a bit where there are any."""
    n_layer, n_depth, n_lateral = solid.shape
    outermost[:] = n_depth
    running = np.zeros((n_depth, n_lateral), np.uint8)
    for i in range(3):
        reach = half[i]
        running[:] = 0
        for layer in range(-reach, n_layer):
            enter, leave = layer + reach, layer - reach - 1
            if enter < n_layer:
                for d in range(n_depth):
                    for b in range(n_lateral):
                        running[d, b] += solid[enter, d, b] != 0
            if leave >= 0:
                for d in range(n_depth):
                    for b in range(n_lateral):
                        running[d, b] -= solid[leave, d, b] != 0
            if layer < 0:
                continue
            for d in range(n_depth):
                word = np.uint64(0)
                for b in range(n_lateral):
                    slab[i, layer, d, b] = running[d, b]
                    if running[d, b] != 0:
                        word |= ONE << np.uint64(b & 63)
                    if b & 63 == 63 or b == n_lateral - 1:
                        bits[i, layer, d, b >> 6] = word
                        if word != 0:
                            outermost[i, layer] = min(outermost[i, layer], d)
                        word = np.uint64(0)


@kernel
def remove_from_slabs(shaft, layer, depth, lateral):
    """Take one voxel, just milled, out of the collapsed slabs."""
    n_layer = shaft.slab.shape[1]
    for i in range(3):
        reach = shaft.half[i]
        for m in range(max(0, layer - reach), min(n_layer, layer + reach + 1)):
            left = shaft.slab[i, m, depth, lateral] - np.uint8(1)
            shaft.slab[i, m, depth, lateral] = left
            if left == 0:
                shaft.bits[i, m, depth, lateral >> 6] &= ~(ONE << np.uint64(lateral & 63))


@inner
def _lowest_bit(word):
    """Index of the lowest set bit of a non-zero word, by a de Bruijn product."""
    return BIT_INDEX[((word & (~word + ONE)) * DE_BRUIJN) >> np.uint64(58)]


@inner
def _subtract(gaps, n, low, high, min_width, current_low, current_high, min_overlap):
    """Take [low, high] out of the first n gaps; drop what is too narrow or overlaps too little. New n.

    ``gaps[0]`` and ``gaps[1]`` hold the gaps' ends in order, the other two rows are scratch.
    """
    kept = 0
    for g in range(n):
        for side in range(2):
            a, z = gaps[0, g], gaps[1, g]
            if high <= a or low >= z:
                if side == 1:
                    continue
            elif side == 0:
                z = low
            else:
                a = high
            overlap = min(z, current_high) - max(a, current_low)
            if z > a and z - a >= min_width and overlap >= min_overlap and kept < gaps.shape[1]:
                gaps[2, kept], gaps[3, kept] = a, z
                kept += 1
    for g in range(kept):
        gaps[0, g], gaps[1, g] = gaps[2, g], gaps[3, g]
    return kept


@inner
def _run_interval(shaft, i, row, first, last):
    """Interval blocked by a row's cells from lateral offset `first` to `last`; (inf, -inf) if none.

    Going sideways, cells block from offset `near` on; their upper end grows, their lower end falls to
    offset `valley` (as far as the strip's front corner decides) and grows from there. So the ends of
    the run and the valley decide; negative offsets are the mirror image.
    """
    low, high = inf, -inf
    near, valley = shaft.near[i, row], shaft.valley[i, row]
    a = max(first, near)
    if a <= last:
        low = shaft.low[i, row, min(max(valley, a), last)]
        high = shaft.high[i, row, last]
    a = max(-last, near)
    if a <= -first:
        low = min(low, -shaft.high[i, row, -first])
        high = max(high, -shaft.low[i, row, min(max(valley, a), -first)])
    return low, high


@kernel
def accessible_window(shaft, layer, depth, lateral, current_low, current_high, min_width, min_overlap):
    """The range of accessible angles of a voxel that overlaps the current range most.

    Returns (accessible, low, high). A voxel is accessible when such a range is at least `min_width`
    wide and overlaps ``[current_low, current_high]`` by at least `min_overlap` (2.3.3).
    """
    gaps = np.empty((4, 24))
    gaps[0, 0], gaps[1, 0] = -shaft.max_tilt, shaft.max_tilt
    n = np.int64(1)
    overlap = min(shaft.max_tilt, current_high) - max(-shaft.max_tilt, current_low)
    if 2 * shaft.max_tilt < min_width or overlap < min_overlap:
        return False, 0.0, 0.0
    n_lateral = shaft.slab.shape[3]
    half_depth, half_lateral = shaft.step_depth / 2, shaft.step_lateral / 2
    for i in range(3):
        radius = shaft.radius[i]
        # No row closer than this is touched at any tilt that is left.
        nearest = shaft.start[i] * cos(shaft.max_tilt) - radius * sin(shaft.max_tilt)
        first = max(-shaft.inward, floor((nearest - half_depth) / shaft.step_depth))
        tan_low, tan_high = tan(gaps[0, 0]), tan(gaps[1, n - 1])
        wide_low, wide_high = radius / cos(gaps[0, 0]), radius / cos(gaps[1, n - 1])
        for row in range(first, depth + 1 - shaft.outermost[i, layer]):
            d, r = depth - row, row + shaft.inward
            u = row * shaft.step_depth
            u0, u1 = u - half_depth, u + half_depth
            left = min(u0 * tan_low, u1 * tan_low) - wide_low - half_lateral
            right = max(u0 * tan_high, u1 * tan_high) + wide_high + half_lateral
            cell_from = max(0, lateral + floor(left / shaft.step_lateral))
            cell_to = min(n_lateral - 1, lateral + ceil(right / shaft.step_lateral))
            if cell_from > cell_to:
                continue
            changed = False
            for w in range(cell_from >> 6, (cell_to >> 6) + 1):
                word = shaft.bits[i, layer, d, w]
                if word == 0:
                    continue
                if w == cell_from >> 6:
                    word &= ALL << np.uint64(cell_from & 63)
                if w == cell_to >> 6:
                    word &= ALL >> np.uint64(63 - (cell_to & 63))
                while word != 0:
                    # A run of occupied cells blocks one interval: neighbours' intervals overlap.
                    begin = _lowest_bit(word)
                    rest = ~(word >> np.uint64(begin))
                    size = _lowest_bit(rest) if rest != 0 else 64
                    if begin + size >= 64:
                        word = np.uint64(0)
                    else:
                        word &= ALL << np.uint64(begin + size)
                    cell = w * 64 + begin - lateral
                    low, high = _run_interval(shaft, i, r, cell, cell + size - 1)
                    if low >= gaps[1, n - 1] or high <= gaps[0, 0]:
                        continue
                    n = _subtract(gaps, n, low, high, min_width, current_low, current_high, min_overlap)
                    if n == 0:
                        return False, 0.0, 0.0
                    changed = True
            if changed:
                tan_low, tan_high = tan(gaps[0, 0]), tan(gaps[1, n - 1])
                wide_low, wide_high = radius / cos(gaps[0, 0]), radius / cos(gaps[1, n - 1])
    best, best_overlap = 0, -inf
    for g in range(n):
        overlap = min(gaps[1, g], current_high) - max(gaps[0, g], current_low)
        if overlap > best_overlap:
            best, best_overlap = g, overlap
    return True, gaps[0, best], gaps[1, best]


@kernel
def pose_is_free(shaft, layer, depth, lateral, theta):
    """Whether the shaft at this (fractional) position and tilt avoids the collapsed slabs. Conservative."""
    n_layer, n_depth, n_lateral = shaft.slab.shape[1], shaft.slab.shape[2], shaft.slab.shape[3]
    l0, l1 = floor(layer), ceil(layer)
    c, s = cos(theta), sin(theta)
    limit = shaft.burr_radius * shaft.burr_radius * (1 - 1e-12)
    along = shaft.step_depth / 2 * c + shaft.step_lateral / 2 * abs(s)
    across = shaft.step_depth / 2 * abs(s) + shaft.step_lateral / 2 * c
    for i in range(3):
        radius, start = shaft.radius[i], shaft.start[i]
        far = max(layer - (l0 - shaft.half[i]), l1 + shaft.half[i] - layer)
        far = max(0.0, far - 0.5) * shaft.step_layer
        deepest = floor(depth + (radius * abs(s) - start * c) / shaft.step_depth + 1)
        top = min(
            shaft.outermost[i, max(0, min(l0, n_layer - 1))], shaft.outermost[i, max(0, min(l1, n_layer - 1))]
        )
        for d in range(min(deepest, n_depth - 1), top - 1, -1):
            u = (depth - d) * shaft.step_depth
            centre = u * s / c
            width = (radius + across) / c
            b0 = max(0, ceil(lateral + (centre - width) / shaft.step_lateral))
            b1 = min(n_lateral - 1, floor(lateral + (centre + width) / shaft.step_lateral))
            for layer_index in (l0, l1):
                if not 0 <= layer_index < n_layer:
                    continue
                for b in range(b0, b1 + 1):
                    if shaft.slab[i, layer_index, d, b] == 0:
                        continue
                    w = (b - lateral) * shaft.step_lateral
                    if u * c + w * s + along <= start:
                        continue
                    near_u = max(0.0, abs(u) - shaft.step_depth / 2)
                    near_w = max(0.0, abs(w) - shaft.step_lateral / 2)
                    if near_u * near_u + near_w * near_w + far * far < limit:
                        continue
                    return False
    return True
