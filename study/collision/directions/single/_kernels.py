"""Compiled 5-DOF check of one direction: the drill's three finite cylinders against unmilled voxel cubes.

The yes or no is that of `study.collision.exact`: a pose is blocked when a cylinder overlaps the cube of
a solid voxel that the burr at that pose does not overlap (those it removes on arriving); touching is
not overlapping. Two things make it fast. Marching: a ball around a point of the axis that holds no
solid voxel frees the cylinder as far as it lies inside the ball, and the ball's radius is read from the
distance field. Rows: where the ball is too small the voxels about the axis are looked up in rows of
bits, which follow the milling, and every solid one is tested exactly.

Directions are unit vectors in mm along ``[layer, depth, lateral]``, from the burr's centre towards the
drill body.
"""

from __future__ import annotations

from math import acos, asin, atan2, ceil, cos, floor, inf, sin, sqrt

import numpy as np

from study._compiled import inner, kernel
from study.collision._kernels import ALL, ONE, _lowest_bit
from study.collision.directions.field._kernels import UNIT
from study.collision.exact._kernels import cylinder_overlaps_box

LOOSEST = 0.7  # mm that a cone may widen the shaft by where voxels are looked up one by one
# Further voxels compared for the one that blocks most: none, or for a wide cone. (Of numpy's type: for
# plain numbers numba would compile the callee once each.)
NONE, MANY = np.int64(0), np.int64(64)


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
def ray_is_free(space, at, u, hit):
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


@inner
def direction(tilt, tip):
    """Unit vector of a shaft tilted about the layer axis and tipped out of the plane across it."""
    return sin(tip), -cos(tip) * cos(tilt), cos(tip) * sin(tilt)


@inner
def angles(u0, u1, u2):
    """Tilt and tip of a unit vector."""
    return atan2(u2, -u1), asin(min(1.0, max(-1.0, u0)))


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
            space, layer, depth, lateral, p * u0 + q * v0, p * u1 + q * v1, p * u2 + q * v2, spread, NONE, hit
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
