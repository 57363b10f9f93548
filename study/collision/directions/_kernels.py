"""Compiled 5-DOF check: the drill's three finite cylinders against unmilled voxel cubes, from any direction.

The yes or no is that of `study.collision.exact`: a pose is blocked when a cylinder overlaps the cube of
a solid voxel that the burr at that pose does not overlap (those it removes on arriving); touching is
not overlapping. Two things make it fast. Marching: a ball around a point of the axis that holds no
solid voxel frees the cylinder as far as it lies inside the ball, and the ball's radius is read from a
distance field. The field may be out of date, because bone only disappears: it is a lower bound for
ever. Rows: where the ball is too small the voxels about the axis are looked up in rows of bits, which
follow the milling, and every solid one is tested exactly.

Arrays are canonical, ``[layer, depth, lateral]``; depth grows into the bone. Directions are unit
vectors in mm along these axes, from the burr's centre towards the drill body.
"""

from __future__ import annotations

from math import acos, asin, atan2, ceil, cos, floor, inf, sin, sqrt
from typing import NamedTuple

import numpy as np

from study._compiled import inner, kernel
from study.collision._kernels import ALL, ONE, _lowest_bit
from study.collision.exact._kernels import cylinder_overlaps_box

UNIT = 0.1  # mm of the distance field's numbers
MOST = 255
LOOSEST = 0.7  # mm that a cone may widen the shaft by where voxels are looked up one by one
WITNESSES, FEW = 64, 0  # voxels compared for the one that blocks most: for a wide cone, for a small window
STRUCK = np.int32(-(2**31))  # key of a direction that is off the list
HEART = 0.49  # of a voxel's edge: the ball in its cube, less what float32 may round
REMOVED, REFRESHED, WITNESSED, WINDOWS = 0, 1, 2, 3  # entries of `counts`


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


# --- the distance field --------------------------------------------------------------------------------


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
                value = np.uint8(min(255.0, sqrt(best[k]) * (1 - 1e-6) / UNIT))
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


# --- one direction ---------------------------------------------------------------------------------------


@inner
def _box_between_caps_overlaps(p, u, steps, radius):
    """Whether an infinite cylinder through the origin along u overlaps the box about p. Exact.

    Seen along u the box is a hexagon spanned by three half edges; only its sides that face the axis count.
    """
    # Any two directions across u span the plane; the one with the smallest component is safe to cross with.
    if abs(u[0]) <= abs(u[1]) and abs(u[0]) <= abs(u[2]):
        length = sqrt(u[1] * u[1] + u[2] * u[2])
        e0, e1, e2 = 0.0, u[2] / length, -u[1] / length
    elif abs(u[1]) <= abs(u[2]):
        length = sqrt(u[0] * u[0] + u[2] * u[2])
        e0, e1, e2 = -u[2] / length, 0.0, u[0] / length
    else:
        length = sqrt(u[0] * u[0] + u[1] * u[1])
        e0, e1, e2 = u[1] / length, -u[0] / length, 0.0
    f0, f1, f2 = u[1] * e2 - u[2] * e1, u[2] * e0 - u[0] * e2, u[0] * e1 - u[1] * e0
    cx = p[0] * e0 + p[1] * e1 + p[2] * e2
    cy = p[0] * f0 + p[1] * f1 + p[2] * f2
    gx = (0.5 * steps[0] * e0, 0.5 * steps[1] * e1, 0.5 * steps[2] * e2)
    gy = (0.5 * steps[0] * f0, 0.5 * steps[1] * f1, 0.5 * steps[2] * f2)
    limit = radius * radius * (1 - 2e-12)
    inside = True
    for a in range(3):
        length2 = gx[a] * gx[a] + gy[a] * gy[a]
        if length2 < 1e-24:
            continue  # this edge is seen end on
        b, c = (a + 1) % 3, (a + 2) % 3
        nb = gx[a] * gy[b] - gy[a] * gx[b]
        nc = gx[a] * gy[c] - gy[a] * gx[c]
        n0 = gx[a] * cy - gy[a] * cx
        if abs(n0) <= abs(nb) + abs(nc):
            continue
        inside = False
        # The side of the hexagon that faces the axis: towards it with both other edges.
        mx, my, reach = cx, cy, 1.0
        for o, n in ((b, nb), (c, nc)):
            other2 = gx[o] * gx[o] + gy[o] * gy[o]
            if n * n <= 1e-24 * length2 * other2:
                # Seen in line with this one: together they are one longer side.
                reach += abs(gx[a] * gx[o] + gy[a] * gy[o]) / length2
            else:
                towards = -1.0 if (n > 0) == (n0 > 0) else 1.0
                mx, my = mx + towards * gx[o], my + towards * gy[o]
        t = -(mx * gx[a] + my * gy[a]) / length2
        t = min(reach, max(-reach, t))
        x, y = mx + t * gx[a], my + t * gy[a]
        if x * x + y * y < limit:
            return True
    return inside


@inner
def _blocks(space, at, u, i, j, k, radius, start, end):
    """Whether the cube of one solid voxel overlaps a cylinder of the shaft and is not removed by the burr."""
    steps = space.steps
    p = (i * steps[0] - at[0], j * steps[1] - at[1], k * steps[2] - at[2])
    x = max(0.0, abs(p[0]) - 0.5 * steps[0])
    y = max(0.0, abs(p[1]) - 0.5 * steps[1])
    z = max(0.0, abs(p[2]) - 0.5 * steps[2])
    if x * x + y * y + z * z < space.burr_radius * space.burr_radius * (1 - 1e-12):
        return False
    t = p[0] * u[0] + p[1] * u[1] + p[2] * u[2]
    half = 0.5 * (steps[0] * abs(u[0]) + steps[1] * abs(u[1]) + steps[2] * abs(u[2]))
    if t + half <= start or t - half >= end:
        return False
    if start < t < end and p[0] * p[0] + p[1] * p[1] + p[2] * p[2] - t * t < radius * radius:
        return True
    if not _box_between_caps_overlaps(p, u, steps, radius):
        return False
    if t - half >= start and t + half <= end:
        return True
    origin, axis = np.zeros(3), np.empty(3)
    low, high = np.empty(3), np.empty(3)
    for n in range(3):
        axis[n], low[n], high[n] = u[n], p[n] - 0.5 * steps[n], p[n] + 0.5 * steps[n]
    return cylinder_overlaps_box(origin, axis, radius, start, end, low, high)


@inner
def _piece_is_free(space, at, u, radius, start, end, t0, t1, more, hit):
    """Look up every voxel that the cylinder can meet between t0 and t1 mm; `hit` gets the one that blocks.

    Having found one, `more` further ones are looked at and the one nearest to the axis is kept: it
    blocks the widest range of directions.
    """
    steps = space.steps
    nearest = inf
    left = more
    clear = space.burr_radius + 0.5 * (steps[0] + steps[1] + steps[2])
    shape = space.solid.shape
    a0, z0 = at[0] + u[0] * t0, at[0] + u[0] * t1
    a1, z1 = at[1] + u[1] * t0, at[1] + u[1] * t1
    reach0 = radius * sqrt(u[1] * u[1] + u[2] * u[2]) + 0.5 * steps[0]
    reach1 = radius * sqrt(u[0] * u[0] + u[2] * u[2]) + 0.5 * steps[1]
    i0, i1 = max(0, ceil((min(a0, z0) - reach0) / steps[0])), floor((max(a0, z0) + reach0) / steps[0])
    j0, j1 = max(0, ceil((min(a1, z1) - reach1) / steps[1])), floor((max(a1, z1) + reach1) / steps[1])
    i1, j1 = min(shape[0] - 1, i1), min(shape[1] - 1, j1)
    half = 0.5 * (steps[0] * abs(u[0]) + steps[1] * abs(u[1]) + steps[2] * abs(u[2]))
    bound = radius + 0.5 * sqrt(steps[0] * steps[0] + steps[1] * steps[1] + steps[2] * steps[2])
    square = u[0] * u[0] + u[1] * u[1]
    drift = sqrt(square) * end  # how far a shaft along the row may run aside of it
    # Rows without a bit near the piece are most of them: a mask tells before any geometry.
    a2, z2 = at[2] + u[2] * t0, at[2] + u[2] * t1
    reach2 = radius * sqrt(square) + 0.5 * steps[2]
    first = max(0, ceil((min(a2, z2) - reach2) / steps[2] - 1e-9))
    last = min(shape[2] - 1, floor((max(a2, z2) + reach2) / steps[2] + 1e-9))
    if first > last:
        return True
    first_mask, last_mask = ALL << np.uint64(first & 63), ALL >> np.uint64(63 - (last & 63))
    for i in range(i0, i1 + 1):
        p0 = i * steps[0] - at[0]
        for j in range(j0, j1 + 1):
            bare = True
            for w in range(first >> 6, (last >> 6) + 1):
                word = space.bits[i, j, w]
                if w == first >> 6:
                    word &= first_mask
                if w == last >> 6:
                    word &= last_mask
                bare &= word == 0
            if bare:
                continue
            p1 = j * steps[1] - at[1]
            # Voxels of this row with centres within `bound` of the axis and between the piece's ends.
            along, beside = p0 * u[0] + p1 * u[1], p0 * p0 + p1 * p1
            low, high = first * steps[2] - at[2], last * steps[2] - at[2]
            if square > 1e-9:
                middle = along * u[2] / square
                rest = middle * middle - (beside - along * along - bound * bound) / square
                if rest < 0.0:
                    continue
                rest = sqrt(rest)
                low, high = max(low, middle - rest), min(high, middle + rest)
            elif beside > (bound + drift) * (bound + drift):
                continue
            if u[2] > 1e-9:
                low, high = max(low, (t0 - half - along) / u[2]), min(high, (t1 + half - along) / u[2])
            elif u[2] < -1e-9:
                low, high = max(low, (t1 + half - along) / u[2]), min(high, (t0 - half - along) / u[2])
            elif along < t0 - half - 1e-6 or along > t1 + half + 1e-6:
                continue
            k0 = max(0, ceil((at[2] + low) / steps[2] - 1e-9))
            k1 = min(shape[2] - 1, floor((at[2] + high) / steps[2] + 1e-9))
            if k0 > k1:
                continue
            for w in range(k0 >> 6, (k1 >> 6) + 1):
                word = space.bits[i, j, w]
                if w == k0 >> 6:
                    word &= ALL << np.uint64(k0 & 63)
                if w == k1 >> 6:
                    word &= ALL >> np.uint64(63 - (k1 & 63))
                while word != 0:
                    k = 64 * w + _lowest_bit(word)
                    word &= word - ONE
                    if nearest < inf:
                        # The first has decided; from here on only the centre counts.
                        left -= 1
                        p2 = k * steps[2] - at[2]
                        t = p0 * u[0] + p1 * u[1] + p2 * u[2]
                        off = p0 * p0 + p1 * p1 + p2 * p2 - t * t
                        # Its centre inside, and clear of what the burr removes: it blocks by itself.
                        if off < min(nearest, radius * radius) and max(clear, start) < t < end:
                            nearest = off
                            hit[0], hit[1], hit[2] = i, j, k
                    elif _blocks(space, at, u, i, j, k, radius, start, end):
                        hit[0], hit[1], hit[2] = i, j, k
                        p2 = k * steps[2] - at[2]
                        t = p0 * u[0] + p1 * u[1] + p2 * u[2]
                        nearest = p0 * p0 + p1 * p1 + p2 * p2 - t * t
                    if nearest < inf and left <= 0:
                        return False
    return nearest == inf


@inner
def _ray_is_free(space, at, u, hit):
    """Whether the bare axis meets no solid voxel beyond the burr: a look that costs little.

    Where it does, `hit` gets a voxel that blocks many directions around this one too.
    """
    steps, shape = space.steps, space.solid.shape
    # A voxel on the axis from here on is clear of the burr: none is wider along any direction.
    t = space.burr_radius + steps[0] + steps[1] + steps[2]
    while t < space.cylinders[2, 2]:
        x, y, z = at[0] + u[0] * t, at[1] + u[1] * t, at[2] + u[2] * t
        i, j, k = (
            int(floor(x / steps[0] + 0.5)),
            int(floor(y / steps[1] + 0.5)),
            int(floor(z / steps[2] + 0.5)),
        )
        if not (0 <= i < shape[0] and 0 <= j < shape[1] and 0 <= k < shape[2]):
            return True
        if space.bits[i, j, k >> 6] >> np.uint64(k & 63) & ONE != 0:
            hit[0], hit[1], hit[2] = i, j, k
            return False
        t += max(0.5 * steps[0], space.distance[i, j, k] * UNIT)
    return True


@kernel
def shaft_is_free(space, layer, depth, lateral, u0, u1, u2, spread, more, hit):
    """Whether the shaft is free at a position in (fractional) voxels, from every direction within `spread`.

    `spread` 0 asks for the direction (u0, u1, u2) alone, and the answer is exact; a spread in radians
    asks for all directions so near to it, and False may be over-cautious. `hit` receives a voxel that
    blocks the direction (with a spread: perhaps only a neighbouring one), the best of `more` others.
    """
    steps, shape = space.steps, space.solid.shape
    at = (layer * steps[0], depth * steps[1], lateral * steps[2])
    u = (u0, u1, u2)
    for c in range(3):
        radius, start, end = space.cylinders[c, 0], space.cylinders[c, 1], space.cylinders[c, 2]
        # Turning by `spread` moves a point t mm along the axis and r mm off it by less than spread (t + r).
        t = start if spread == 0.0 else max(0.0, start - spread * radius)
        end_all = end if spread == 0.0 else end + spread * radius
        while t < end_all:
            x, y, z = at[0] + u[0] * t, at[1] + u[1] * t, at[2] + u[2] * t
            i, j, k = (
                int(floor(x / steps[0] + 0.5)),
                int(floor(y / steps[1] + 0.5)),
                int(floor(z / steps[2] + 0.5)),
            )
            outside = 0.0
            leaving = False
            if not (0 <= i < shape[0] and 0 <= j < shape[1] and 0 <= k < shape[2]):
                # Around a box nothing is nearer than the box; past its side, the root of both squares.
                inner_x = min(max(x, -0.5 * steps[0]), (shape[0] - 0.5) * steps[0])
                inner_y = min(max(y, -0.5 * steps[1]), (shape[1] - 0.5) * steps[1])
                inner_z = min(max(z, -0.5 * steps[2]), (shape[2] - 0.5) * steps[2])
                gone_x, gone_y, gone_z = x - inner_x, y - inner_y, z - inner_z
                outside = gone_x * gone_x + gone_y * gone_y + gone_z * gone_z
                leaving = gone_x * u[0] >= 0 and gone_y * u[1] >= 0 and gone_z * u[2] >= 0
                x, y, z = inner_x, inner_y, inner_z
                i, j, k = (
                    min(max(i, 0), shape[0] - 1),
                    min(max(j, 0), shape[1] - 1),
                    min(max(k, 0), shape[2] - 1),
                )
            x, y, z = x - i * steps[0], y - j * steps[1], z - k * steps[2]
            rho = max(0.0, space.distance[i, j, k] * UNIT - sqrt(x * x + y * y + z * z))
            if outside > 0.0:
                if leaving and spread == 0.0 and outside >= radius * radius:
                    break  # the axis leaves the volume, and so does the rest of this cylinder
                rho = sqrt(rho * rho + outside)
            rho -= spread * (t + radius)
            step = 0.0
            if rho > radius:
                step = sqrt(rho * rho - radius * radius)
                if spread > 0.0:
                    rho -= spread * step
                    step = sqrt(rho * rho - radius * radius) if rho > radius else 0.0
            if step < 0.25:
                until = min(t + 1.5, end_all)
                play = spread * (until + radius)
                if play > LOOSEST:
                    return False  # so wide a cone is cheaper looked at in parts
                if not _piece_is_free(
                    space, at, u, radius + play, start - play, end + play, t - play, until + play, more, hit
                ):
                    return False
                step = until - t + 1e-12
            t += step
    return True


# --- many directions ---------------------------------------------------------------------------------------


@inner
def _strike_off(keys, x, y, z, p0, p1, p2, square, s0, e0, r0, s1, e1, r1, s2, e2, r2):
    """Strike the directions off the list whose shaft meets a ball at p: squares of radii, starts, ends.

    Plain float32 and int32 without branches, so that the processor does many at once.
    """
    struck = 0
    for m in range(keys.size):
        t = p0 * x[m] + p1 * y[m] + p2 * z[m]
        off = square - t * t
        inside = (
            ((off < r0) & (t > s0) & (t < e0))
            | ((off < r1) & (t > s1) & (t < e1))
            | ((off < r2) & (t > s2) & (t < e2))
        )
        key = keys[m]
        now = STRUCK if inside else key
        struck += now != key
        keys[m] = now
    return struck


@inner
def _testify(space, at, i, j, k, keys, rays):
    """Let the solid voxel (i, j, k) bear witness: strike off `keys` what it blocks. How many it struck."""
    f = np.float32
    steps, c = space.steps, space.cylinders
    p0, p1, p2 = i * steps[0] - at[0], j * steps[1] - at[1], k * steps[2] - at[2]
    heart = HEART * min(steps[0], min(steps[1], steps[2]))
    r0, r1, r2 = c[0, 0] + heart, c[1, 0] + heart, c[2, 0] + heart
    return _strike_off(
        keys, rays[0], rays[1], rays[2], f(p0), f(p1), f(p2),
        f(p0 * p0 + p1 * p1 + p2 * p2), f(c[0, 1]), f(c[0, 2]), f(r0 * r0), f(c[1, 1]), f(c[1, 2]),
        f(r1 * r1), f(c[2, 1]), f(c[2, 2]), f(r2 * r2),
    )  # fmt: skip


@kernel
def search_from(space, layer, depth, lateral, u0, u1, u2):
    """Begin a search at a position: list all directions of the robot's cone by their nearness to u.

    The witnesses of the last search speak first: they mostly bar the neighbouring voxel too.
    """
    x, y, z, keys = space.rays[0], space.rays[1], space.rays[2], space.keys
    a, b, c = np.float32(u0 * 1e9), np.float32(u1 * 1e9), np.float32(u2 * 1e9)
    for m in range(keys.size):
        keys[m] = np.int32(a * x[m] + b * y[m] + c * z[m])
    steps, shape = space.steps, space.solid.shape
    at = (layer * steps[0], depth * steps[1], lateral * steps[2])
    before = space.counts[WITNESSED]
    space.counts[WITNESSED] = 0
    plane = shape[1] * shape[2]
    clear = space.burr_radius + 0.5 * (steps[0] + steps[1] + steps[2])
    for n in range(before):
        flat = space.witnesses[n]
        i = flat // plane
        j = (flat - i * plane) // shape[2]
        k = flat - i * plane - j * shape[2]
        p0, p1, p2 = i * steps[0] - at[0], j * steps[1] - at[1], k * steps[2] - at[2]
        # What the burr would remove here bears no witness.
        if space.solid[i, j, k] == 0 or p0 * p0 + p1 * p1 + p2 * p2 < clear * clear:
            continue
        if _testify(space, at, i, j, k, keys, space.rays) > 0:
            space.witnesses[space.counts[WITNESSED]] = flat
            space.counts[WITNESSED] += 1


@kernel
def next_free(space, layer, depth, lateral, hit):
    """The nearest direction still listed that is free, or -1 when none is left; takes it off the list.

    A voxel that blocks one direction is a witness against all those it surely blocks: some dozens of
    witnesses shut the whole cone. They are kept in `space.witnesses`: until one of them is milled no
    direction they shut comes free.
    """
    steps, shape, keys = space.steps, space.solid.shape, space.keys
    at = (layer * steps[0], depth * steps[1], lateral * steps[2])
    while True:
        nearest = STRUCK
        for m in range(keys.size):
            nearest = max(nearest, keys[m])
        if nearest == STRUCK:
            return -1
        chosen = 0
        while keys[chosen] != nearest:
            chosen += 1
        keys[chosen] = STRUCK
        d = space.directions[chosen]
        if _ray_is_free(space, at, (d[0], d[1], d[2]), hit) and shaft_is_free(
            space, layer, depth, lateral, d[0], d[1], d[2], 0.0, WITNESSES, hit
        ):
            return chosen
        _testify(space, at, hit[0], hit[1], hit[2], keys, space.rays)
        if space.counts[WITNESSED] < space.witnesses.size:
            space.witnesses[space.counts[WITNESSED]] = (hit[0] * shape[1] + hit[1]) * shape[2] + hit[2]
            space.counts[WITNESSED] += 1


@kernel
def nearest_free(space, layer, depth, lateral, u0, u1, u2, hit):
    """Index of the free direction of the robot's cone that is nearest to u; -1 if none is free."""
    search_from(space, layer, depth, lateral, u0, u1, u2)
    return next_free(space, layer, depth, lateral, hit)


@kernel
def directions_free(space, layer, depth, lateral, axes, free):
    """Fill bool `free` for (n, 3) directions at one position, one look each."""
    hit = np.zeros(3, np.int64)
    for m in range(axes.shape[0]):
        free[m] = shaft_is_free(space, layer, depth, lateral, axes[m, 0], axes[m, 1], axes[m, 2], 0.0, 0, hit)


@inner
def direction(tilt, tip):
    """Unit vector of a shaft tilted about the layer axis and tipped out of the plane across it."""
    return sin(tip), -cos(tip) * cos(tilt), cos(tip) * sin(tilt)


@inner
def angles(u0, u1, u2):
    """Tilt and tip of a unit vector."""
    return atan2(u2, -u1), asin(min(1.0, max(-1.0, u0)))


@inner
def _settle_tile(space, layer, depth, lateral, tilts, tips, first, second, size, keys, hit):
    """Look at a square tile of directions: 1 all are free, 0 `hit` is a witness, -1 still open."""
    a, z = tilts[first], tilts[first + size - 1]
    b, y = tips[second], tips[second + size - 1]
    u0, u1, u2 = direction(0.5 * (a + z), 0.5 * (b + y))
    at = (layer * space.steps[0], depth * space.steps[1], lateral * space.steps[2])
    if size > 1 and not _ray_is_free(space, at, (u0, u1, u2), hit):
        return 0
    # Angles are never larger than lengths in the plane of tilt and tip.
    spread = 0.5 * sqrt((z - a) * (z - a) + (y - b) * (y - b))
    if not shaft_is_free(space, layer, depth, lateral, u0, u1, u2, spread, FEW, hit):
        if size > 1:
            if shaft_is_free(space, layer, depth, lateral, u0, u1, u2, 0.0, WITNESSES, hit):
                return -1
            return 0
        keys[first * tips.size + second] = STRUCK
        return 0
    for m in range(first, first + size):
        for n in range(second, second + size):
            keys[m * tips.size + n] = 1
    return 1


@kernel
def window_of_directions(space, layer, depth, lateral, tilts, tips, free):
    """Which directions of a square grid of tilts and tips (radians) are free; fills int8 `free` with 0 and 1.

    Tiles of directions are looked at together, halved or parted in three where that does not settle
    them; a voxel that blocks is a witness against every direction it surely blocks. Returns how many
    are free. Exact: the same answers as one look a direction.
    """
    space.counts[WINDOWS] += 1
    n = tilts.size
    hit = np.zeros(3, np.int64)
    at = (layer * space.steps[0], depth * space.steps[1], lateral * space.steps[2])
    keys = np.zeros(n * n, np.int32)  # 0 open, 1 free, STRUCK blocked
    rays = np.empty((3, n * n), np.float32)
    listed = False
    size = n
    while True:
        for a in range(0, n, size):
            for b in range(0, n, size):
                open_directions = False
                for x in range(a, a + size):
                    for y in range(b, b + size):
                        open_directions |= keys[x * n + y] == 0
                if not open_directions:
                    continue
                if _settle_tile(space, layer, depth, lateral, tilts, tips, a, b, size, keys, hit) == 0:
                    if not listed:
                        listed = True
                        for x in range(n):
                            for y in range(n):
                                u0, u1, u2 = direction(tilts[x], tips[y])
                                m = x * n + y
                                rays[0, m], rays[1, m], rays[2, m] = u0, u1, u2
                    _testify(space, at, hit[0], hit[1], hit[2], keys, rays)
        if size == 1:
            break
        if size % 2 == 0:
            size //= 2
        else:
            size = size // 3 if size % 3 == 0 else 1
    count = 0
    for a in range(n):
        for b in range(n):
            free[a, b] = keys[a * n + b] == 1
            count += free[a, b]
    return count


@kernel
def turn_is_free(space, layer, depth, lateral, u0, u1, u2, v0, v1, v2, hit):
    """Whether the shaft can turn in place from u, where it is free, to v along the great circle.

    Decided by single directions on the arc, at most `turn_step` apart, the arc being halved as often as
    that takes: the widened cylinders leave no room for bone in between. Where a whole cone about a part
    of the arc is free, its directions need not be looked at.
    """
    whole = acos(min(1.0, max(-1.0, u0 * v0 + u1 * v1 + u2 * v2)))
    if whole < 1e-9:
        return True
    sine = sin(whole)
    at, size = 0.0, 1.0
    while at < 1.0 - 1e-12:
        single = size * whole <= space.turn_step
        f = at + (size if single else 0.5 * size)
        p, q = sin((1.0 - f) * whole) / sine, sin(f * whole) / sine
        spread = 0.0 if single else 0.5 * size * whole
        if shaft_is_free(
            space, layer, depth, lateral, p * u0 + q * v0, p * u1 + q * v1, p * u2 + q * v2, spread, 0, hit
        ):
            at += size
            # The next part may be twice as long where the halving comes out even.
            while size < 1.0 and at < 1.0 and at / (2 * size) == floor(at / (2 * size)):
                size *= 2
        elif single:
            return False
        else:
            size *= 0.5
    return True
