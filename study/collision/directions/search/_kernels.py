"""Compiled 5-DOF check of many directions: the nearest free one of a cone, all of a small window.

A voxel that blocks one direction is a witness against all that it surely blocks, which spares most looks.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from study._compiled import inner, kernel
from study.collision.directions.field._kernels import WINDOWS, WITNESSED
from study.collision.directions.single._kernels import MANY, NONE, direction, ray_is_free, shaft_is_free

STRUCK = np.int32(-(2**31))  # key of a direction that is off the list
HEART = 0.49  # of a voxel's edge: the ball in its cube, less what float32 may round


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
        if ray_is_free(space, at, (d[0], d[1], d[2]), hit) and shaft_is_free(
            space, layer, depth, lateral, d[0], d[1], d[2], 0.0, MANY, hit
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
        free[m] = shaft_is_free(
            space, layer, depth, lateral, axes[m, 0], axes[m, 1], axes[m, 2], 0.0, NONE, hit
        )


@inner
def _settle_tile(space, layer, depth, lateral, tilts, tips, first, second, size, keys, hit):
    """Look at a square tile of directions: 1 all are free, 0 `hit` is a witness, -1 still open."""
    a, z = tilts[first], tilts[first + size - 1]
    b, y = tips[second], tips[second + size - 1]
    u0, u1, u2 = direction(0.5 * (a + z), 0.5 * (b + y))
    at = (layer * space.steps[0], depth * space.steps[1], lateral * space.steps[2])
    if size > 1 and not ray_is_free(space, at, (u0, u1, u2), hit):
        return 0
    # Angles are never larger than lengths in the plane of tilt and tip.
    spread = 0.5 * sqrt((z - a) * (z - a) + (y - b) * (y - b))
    if not shaft_is_free(space, layer, depth, lateral, u0, u1, u2, spread, NONE, hit):
        if size > 1:
            if shaft_is_free(space, layer, depth, lateral, u0, u1, u2, 0.0, MANY, hit):
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
