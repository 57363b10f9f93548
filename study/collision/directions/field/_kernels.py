"""Compiled state of the 5-DOF check: unmilled bone as rows of bits and as a distance field.

The field may be out of date: bone only disappears, so that an old distance is a lower bound for ever.
Arrays are canonical, ``[layer, depth, lateral]``; depth grows into the bone.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from study._compiled import inner, kernel
from study._records import by_address
from study.collision._kernels import ONE

UNIT = 0.1  # mm of the distance field's numbers
MOST = 255.0  # of these
REMOVED, REFRESHED, WITNESSED, WINDOWS = 0, 1, 2, 3  # entries of `counts`


@by_address
class FreeSpace(NamedTuple):
    """Unmilled bone as the shaft meets it (bits and distance change as bone is removed)."""

    solid: np.ndarray  # uint8: non-zero is unmilled; the planner's own array
    bits: np.ndarray  # uint64 [layer, depth, word]: the same, a bit a voxel
    distance: np.ndarray  # uint8, UNIT: at least so far from the voxel's centre to the nearest solid cube
    dirty: np.ndarray  # int64 (2, 3): box of the voxels removed since the field was last refreshed
    counts: np.ndarray  # int64: removed since then; refreshments; witnesses of the last search; windows
    rays: np.ndarray  # float32 (3, n): `directions` by component
    keys: np.ndarray  # int32 (n,): 1e9 x cosine to the direction sought while still listed, else STRUCK
    witnesses: np.ndarray  # int32 (2 n,): flat indices of the voxels that bar the directions struck off
    cylinders: np.ndarray  # float64 (3, 3): radius, start, end in mm, widened by the sweep
    steps: np.ndarray  # float64 (3,) mm
    burr_radius: float  # mm
    directions: np.ndarray  # float64 (n, 3): what the robot's cone is searched by, the approach first
    max_tilt: float  # radians from the approach
    turn_step: float  # radians between the directions by which a turn in place is checked
    patience: int  # voxels that may be removed before the field is refreshed


@kernel
def pack_bits(solid, bits):
    """Set the bit of every solid voxel."""
    for i in range(solid.shape[0]):
        for j in range(solid.shape[1]):
            for w in range(bits.shape[2]):
                word = np.uint64(0)
                for k in range(64 * w, min(64 * w + 64, solid.shape[2])):
                    if solid[i, j, k] != 0:
                        word |= ONE << np.uint64(k & 63)
                bits[i, j, w] = word


@inner
def _gap(n, step):
    """Squared mm from a voxel's centre to the nearer face of a voxel n further on."""
    near = max(0.0, abs(n) - 0.5) * step
    return np.float32(near * near)


@kernel
def raise_distance(solid, steps, distance, low, high, cap):
    """Raise the distance field in the box [low, high) to what `solid` allows, looking `cap` mm far.

    Exact up to `cap` and rounded down; never lowered, so an older value that is larger stays: bone
    only disappears. A separable minimum: along laterals by two scans, then over depths and layers.
    """
    shape = solid.shape
    reach_layer, reach_depth = int(cap / steps[0]) + 1, int(cap / steps[1]) + 1
    reach_lateral = int(cap / steps[2]) + 1
    far = np.float32(cap * cap)
    l0, l1 = max(0, low[0] - reach_layer), min(shape[0], high[0] + reach_layer)
    d0, d1 = max(0, low[1] - reach_depth), min(shape[1], high[1] + reach_depth)
    b0, b1 = low[2], high[2]
    n = b1 - b0
    along = np.empty((l1 - l0, d1 - d0, n), np.float32)
    empty = np.empty((l1 - l0, d1 - d0), np.bool_)
    squares = np.empty(reach_lateral + 2, np.float32)
    for m in range(reach_lateral + 2):
        squares[m] = min(far, _gap(m, steps[2]))
    for i in range(l0, l1):
        for j in range(d0, d1):
            row, out = solid[i, j], along[i - l0, j - d0]
            since = reach_lateral + 1
            anything = False
            for k in range(max(0, b0 - reach_lateral), b1):
                since = 0 if row[k] != 0 else min(since + 1, reach_lateral + 1)
                if k >= b0:
                    out[k - b0] = squares[since]
                    anything |= since <= reach_lateral
            since = reach_lateral + 1
            for k in range(min(shape[2], b1 + reach_lateral) - 1, b0 - 1, -1):
                since = 0 if row[k] != 0 else min(since + 1, reach_lateral + 1)
                if k < b1:
                    if squares[since] < out[k - b0]:
                        out[k - b0] = squares[since]
                    anything |= since <= reach_lateral
            empty[i - l0, j - d0] = not anything
    across = np.empty((l1 - l0, high[1] - low[1], n), np.float32)
    bare = np.empty((l1 - l0, high[1] - low[1]), np.bool_)
    for i in range(l1 - l0):
        for j in range(low[1], high[1]):
            out = across[i, j - low[1]]
            for k in range(n):
                out[k] = far
            bare[i, j - low[1]] = True
            for jj in range(max(d0, j - reach_depth), min(d1, j + reach_depth + 1)):
                if not empty[i, jj - d0]:
                    bare[i, j - low[1]] = False
                    _lower(out, along[i, jj - d0], _gap(jj - j, steps[1]))
    best = np.empty(n, np.float32)
    for i in range(low[0], high[0]):
        for j in range(low[1], high[1]):
            for k in range(n):
                best[k] = far
            for ii in range(max(l0, i - reach_layer), min(l1, i + reach_layer + 1)):
                if not bare[ii - l0, j - low[1]]:
                    _lower(best, across[ii - l0, j - low[1]], _gap(ii - i, steps[0]))
            target = distance[i, j]
            for k in range(n):
                value = np.uint8(min(MOST, sqrt(best[k]) * (1 - 1e-6) / UNIT))
                if value > target[b0 + k]:
                    target[b0 + k] = value


@inner
def _lower(out, other, more):
    for k in range(out.size):
        value = other[k] + more
        out[k] = value if value < out[k] else out[k]


@kernel
def remove_voxel(space, layer, depth, lateral):
    """Take one voxel, just milled, out of the rows, and note that the field is out of date there."""
    space.bits[layer, depth, lateral >> 6] &= ~(ONE << np.uint64(lateral & 63))
    dirty = space.dirty
    dirty[0, 0], dirty[1, 0] = min(dirty[0, 0], layer), max(dirty[1, 0], layer + 1)
    dirty[0, 1], dirty[1, 1] = min(dirty[0, 1], depth), max(dirty[1, 1], depth + 1)
    dirty[0, 2], dirty[1, 2] = min(dirty[0, 2], lateral), max(dirty[1, 2], lateral + 1)
    space.counts[REMOVED] += 1


@kernel
def refresh(space, margin, cap):
    """Bring the distance field up to date about what was removed: `margin` mm around it, up to `cap` mm."""
    if space.counts[REMOVED] == 0:
        return
    low = np.empty(3, np.int64)
    high = np.empty(3, np.int64)
    for n in range(3):
        more = int(margin / space.steps[n])
        low[n] = max(0, space.dirty[0, n] - more)
        high[n] = min(space.solid.shape[n], space.dirty[1, n] + more)
        space.dirty[0, n], space.dirty[1, n] = space.solid.shape[n], 0
    raise_distance(space.solid, space.steps, space.distance, low, high, cap)
    space.counts[REMOVED] = 0
    space.counts[REFRESHED] += 1
