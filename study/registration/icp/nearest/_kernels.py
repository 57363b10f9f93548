"""Compiled searches for the vertex nearest to a point, by a tree or from a vertex near by.

`nearest_two` finds it whatever is known. `walk` goes from a vertex to its nearer neighbours, which is quicker
when one of them is the answer, and finds how far the point may move while it stays the answer.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from study._compiled import inlined, inner

DEPTH = 64  # of a search's stack; a tree of that many levels holds more vertices than there are


@inner
def _box_distance(boxes, node, x, y, z):
    """Squared distance from a point to a node's box; in floating point too never above one to its points."""
    dx = max(max(boxes[node, 0] - x, x - boxes[node, 3]), 0.0)
    dy = max(max(boxes[node, 1] - y, y - boxes[node, 4]), 0.0)
    dz = max(max(boxes[node, 2] - z, z - boxes[node, 5]), 0.0)
    return dx * dx + dy * dy + dz * dz


@inner
def _distance(points, j, x, y, z):
    """Squared distance from a point to a vertex."""
    dx = points[j, 0] - x
    dy = points[j, 1] - y
    dz = points[j, 2] - z
    return dx * dx + dy * dy + dz * dz


@inner
def same_place(points, i, j):
    """Whether two vertices lie at the same place."""
    return points[i, 0] == points[j, 0] and points[i, 1] == points[j, 1] and points[i, 2] == points[j, 2]


@inner
def nearest_two(points, ends, boxes, kept, masked, stack, bounds, x, y, z, first):
    """Nearest vertex and how far the nearest is that lies elsewhere, by the tree.

    Parameters
    ----------
    points, ends, boxes
        Of a `SurfaceTree`.
    kept : (v,) bool array
        Which points to see, if `masked`.
    stack, bounds : (DEPTH,) int and float arrays
        Used up.
    x, y, z : float
        mm.
    first : int
        A point that may be the nearest: it bounds the search. -1 where none is known.

    Returns
    -------
    int, float, float
        Nearest point, of equally near ones the first in the tree's order; its squared distance and that of
        the second nearest, mm^2.
    """
    near = np.inf
    next_ = np.inf
    if first >= 0:
        near = _distance(points, first, x, y, z)
    leaves = ends.shape[0] - 1
    stack[0] = 1
    bounds[0] = 0.0
    top = 1
    while top > 0:
        top -= 1
        node = stack[top]
        if bounds[top] > next_:
            continue
        if node < leaves:
            one = 2 * node
            other = one + 1
            near_one = _box_distance(boxes, one, x, y, z)
            near_other = _box_distance(boxes, other, x, y, z)
            if near_one > near_other:
                one, other = other, one
                near_one, near_other = near_other, near_one
            if near_other <= next_:
                stack[top] = other
                bounds[top] = near_other
                top += 1
            if near_one <= next_:
                stack[top] = one
                bounds[top] = near_one
                top += 1
            continue
        for j in range(ends[node - leaves], ends[node - leaves + 1]):
            if masked and not kept[j]:
                continue
            d = _distance(points, j, x, y, z)
            if d > next_ or j == first:
                continue
            if d == near and same_place(points, j, first):
                first = min(first, j)
            elif d < near or (d == near and j < first):
                next_ = near
                first = j
                near = d
            else:
                next_ = d
    return first, near, next_


@inlined
def walk(points, around, planes, kept, masked, close, x, y, z, first):
    """Go from vertex to nearer vertex until none is nearer, and say how far the point has from there.

    A match changes where the point crosses the plane half way to another vertex. A vertex that lies g
    from the match has its plane at least g / 2 less the match's distance away, so the list of neighbours
    need not be followed further than that.

    Parameters
    ----------
    points, around, planes
        Of a `SurfaceTree`.
    kept : (v,) bool array
        Which points to see, if `masked`.
    close : float
        What round-off can do to a distance, mm.
    x, y, z : float
        mm.
    first : int
        Where to begin.

    Returns
    -------
    int, int, int, float, float
        The match and two rivals, those with the nearest planes (the match again where there are none); the
        distance to the first rival's plane; and how far the point may move before a vertex that is none of
        the three can be the nearest, mm: negative where the lists are too short to be sure of anything.
    """
    going = True
    one = first
    other = first
    to_one = np.inf
    free = -1.0
    while going:
        going = False
        one = first
        other = first
        to_one = np.inf
        to_other = np.inf
        to_third = np.inf
        limit = -1.0
        own = sqrt(_distance(points, first, x, y, z)) + close
        for k in range(around.shape[1]):
            limit = planes[first, k, 0] - own
            if limit >= to_third:
                break
            if masked and not kept[around[first, k]]:
                continue
            slack = planes[first, k, 4] - (
                planes[first, k, 1] * x + planes[first, k, 2] * y + planes[first, k, 3] * z
            )
            if slack >= to_third:
                continue
            if slack < -close:
                first = around[first, k]
                going = True
                break
            if slack >= to_other:
                to_third = slack
                continue
            to_third = to_other
            if slack >= to_one:
                to_other = slack
                other = around[first, k]
            else:
                to_other = to_one
                other = one
                to_one = slack
                one = around[first, k]
        free = min(limit, to_third)
    return first, one, other, to_one, free


@inner
def _to_plane(points, i, j, x, y, z):
    """Distance from a point to the plane half way between two vertices, times that between these."""
    u, v, w = points[i, 0], points[i, 1], points[i, 2]
    a, b, c = points[j, 0], points[j, 1], points[j, 2]
    return 0.5 * ((a - u) * (a + u - 2 * x) + (b - v) * (b + v - 2 * y) + (c - w) * (c + w - 2 * z))


@inlined
def best_of(points, first, one, other, x, y, z):
    """Nearest of three vertices, and how far the point may move before another one of them is."""
    best = first
    near = _distance(points, best, x, y, z)
    for j in (one, other):
        d = _distance(points, j, x, y, z)
        if d < near or (d == near and j < best):
            best = j
            near = d
    slack = np.inf
    for j in (first, one, other):
        if j != best:
            gap = sqrt(_distance(points, j, points[best, 0], points[best, 1], points[best, 2]))
            if gap > 0.0:
                slack = min(slack, _to_plane(points, best, j, x, y, z) / gap)
    return best, slack
