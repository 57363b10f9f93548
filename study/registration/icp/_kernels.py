"""Compiled iterative closest point fit: one swab, one start at a time, against sorted vertices.

Three things make it quick and change no result.

- A search begins with the vertices that were nearest the last time: they bound it from the first box on.
- A match is kept without a search for as long as no other vertex can have become nearer. With the
  nearest vertex at d1 and the second nearest at d2, the point first has to move by (d2 - d1) / 2.
  How far a point at distance r from the swab's centroid can have moved is at most T + C r, where T adds
  up the centroid's steps and C the chords 2 sin(angle / 2) of the rotations.
- The sums that the closed-form rotation needs are updated for the matches that changed.
"""

from __future__ import annotations

from math import asin, sqrt

import numpy as np

from study._compiled import inner, threaded
from study.registration._kernels import rotation_of_sums

REFRESH = 32  # iterations after which the sums are made afresh, so that round-off does not pile up
DEPTH = 64  # of a search's stack; a tree of that many levels holds more vertices than there are
FLAT = 1e-9  # eigenvalue gap over the swab's sum of squares: below, the matches fix no rotation
NEAR_TIE = 1e-9  # shares of slack and of coordinates that round-off could decide
ROUND_OFF = 1e-12


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
def _same(points, i, j):
    """Whether two vertices lie at the same place."""
    return points[i, 0] == points[j, 0] and points[i, 1] == points[j, 1] and points[i, 2] == points[j, 2]


@inner
def nearest_two(points, ends, boxes, kept, masked, stack, bounds, x, y, z, first, second):
    """Nearest vertex and the nearest that lies elsewhere; of equally near ones the first in the tree's order.

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
    first, second : int
        Points that may be the answer; they bound the search. Both -1 where nothing is known, and the
        same `second` where there is none.

    Returns
    -------
    int, float, int, float
        Nearest and second nearest point, each with its squared distance, mm^2.
    """
    near = np.inf
    next_ = np.inf
    if first >= 0:
        near = _distance(points, first, x, y, z)
    if second >= 0:
        next_ = _distance(points, second, x, y, z)
        if next_ < near or (next_ == near and second < first):
            first, second = second, first
            near, next_ = next_, near
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
            if d > next_ or j in (first, second):
                continue
            if d == near and _same(points, j, first):
                first = min(first, j)
            elif d < near or (d == near and j < first):
                second = first
                next_ = near
                first = j
                near = d
            elif d < next_ or j < second:
                second = j
                next_ = d
    return first, near, second, next_


@inner
def _sum_up(points, swab, matches, s, total):
    """Sums over all matches: products with the centred swab's coordinates, and coordinates."""
    for r in range(3):
        total[r] = 0.0
        for c in range(3):
            s[r, c] = 0.0
    for i in range(matches.shape[0]):
        for c in range(3):
            y = points[matches[i], c]
            total[c] += y
            for r in range(3):
                s[r, c] += swab[i, r] * y


@inner
def _match(tree, kept, masked, swab, radii, turn, centre, path, close, matches, seconds, expiry, work):
    """Search for the points whose match may have changed; keep the sums; return how many did change.

    `path` holds T and C of the module's text; a point's match holds while T + C r is below its `expiry`.
    """
    points, ends, boxes = tree
    s, total, stack, bounds = work
    changed = 0
    for i in range(matches.shape[0]):
        moved = path[0] + path[1] * radii[i]
        if moved < expiry[i]:
            continue
        a, b, c = swab[i, 0], swab[i, 1], swab[i, 2]
        x = turn[0, 0] * a + turn[0, 1] * b + turn[0, 2] * c + centre[0]
        y = turn[1, 0] * a + turn[1, 1] * b + turn[1, 2] * c + centre[1]
        z = turn[2, 0] * a + turn[2, 1] * b + turn[2, 2] * c + centre[2]
        before = matches[i]
        first, near, second, next_ = nearest_two(
            points, ends, boxes, kept, masked, stack, bounds, x, y, z, before, seconds[i]
        )
        seconds[i] = second
        expiry[i] = moved + 0.5 * (sqrt(next_) - sqrt(near)) * (1.0 - NEAR_TIE) - close
        if first != before:
            changed += 1
            matches[i] = first
            for k in range(3):
                step = points[first, k]
                if before >= 0:
                    step -= points[before, k]
                total[k] += step
                s[0, k] += a * step
                s[1, k] += b * step
                s[2, k] += c * step
    return changed


@inner
def _fit(tree, kept, masked, swab, radii, pose, limits, matches, seconds, expiry, out):
    """Run one start until it stops; see `fit_many`. Return converged, iterations and RMS distance."""
    max_iterations, translation_tolerance, rotation_tolerance, scale = limits
    points = tree[0]
    count = matches.shape[0]
    turn = np.empty((3, 3))
    new = np.empty((3, 3))
    centre = np.empty(3)
    total = np.zeros(3)
    s = np.zeros((3, 3))
    h = np.empty((4, 4))
    v = np.empty((4, 4))
    q = np.empty(4)
    path = np.zeros(2)
    work = (s, total, np.empty(DEPTH, np.int64), np.empty(DEPTH))
    flat = 0.0
    for i in range(count):
        matches[i] = -1
        seconds[i] = -1
        expiry[i] = -np.inf
        flat += FLAT * radii[i] * radii[i]
    reach = scale
    for r in range(3):
        centre[r] = pose[r, 3]
        reach += abs(centre[r])
        for c in range(3):
            turn[r, c] = pose[r, c]
    close = ROUND_OFF * reach
    iterations = 0
    converged = False
    small = False
    while True:
        changed = _match(
            tree, kept, masked, swab, radii, turn, centre, path, close, matches, seconds, expiry, work
        )
        if iterations > 0 and (changed == 0 or small):
            converged = True
            break
        if iterations == max_iterations:
            break
        if iterations % REFRESH == 0:
            _sum_up(points, swab, matches, s, total)
        if rotation_of_sums(s, h, v, q, new) <= flat:
            break  # all matches on one line, or one vertex: no rotation is the best
        shift = 0.0
        chord = 0.0
        for r in range(3):
            step = total[r] / count - centre[r]
            shift += step * step
            centre[r] += step
            for c in range(3):
                step = new[r, c] - turn[r, c]
                chord += step * step
                turn[r, c] = new[r, c]
        shift = sqrt(shift)
        chord = sqrt(0.5 * chord)  # of the angle between the two rotations
        path[0] += shift
        path[1] += chord
        angle = 2.0 * asin(min(1.0, 0.5 * chord))
        small = shift < translation_tolerance and angle < rotation_tolerance
        iterations += 1
    if converged and changed == 0:
        _sum_up(points, swab, matches, s, total)
        rotation_of_sums(s, h, v, q, turn)
        for r in range(3):
            centre[r] = total[r] / count
    rest = 0.0
    for i in range(count):
        for r in range(3):
            d = centre[r] - points[matches[i], r]
            for c in range(3):
                d += turn[r, c] * swab[i, c]
            rest += d * d
    for r in range(3):
        out[r, 3] = centre[r]
        for c in range(3):
            out[r, c] = turn[r, c]
    return converged, iterations, sqrt(rest / count)


@threaded
def fit_many(points, ends, boxes, kept, masked, swabs, radii, poses, limits, out, converged, iterations, rms):
    """Fit a swab from each of many starts.

    Parameters
    ----------
    points, ends, boxes
        Of a `SurfaceTree`.
    kept : (n, v) bool array
        In the tree's order; which vertices each start sees, if `masked`.
    swabs : (n or 1, p, 3) float array
        Centred, mm; one for all starts, or one each.
    radii : (n or 1, p) float array
        Distances of its points from the swab's centroid, mm.
    poses : (n, 3, 4) float array
        Rotation and centroid of the swab at the start, less the tree's origin.
    limits : (int, float, float, float) tuple
        Iterations at most, translation (mm) and rotation (rad) below which a step counts as none, and
        the size of the coordinates (mm), which says what round-off can do.
    out : (n, 3, 4) float array
        Receives rotation and centroid of the swab at the end.
    converged, iterations, rms : (n,) bool, int and float arrays
        Receive how each ended; the RMS distance is to the nearest vertices at the end, mm.
    """
    count = swabs.shape[1]
    matches = np.empty(count, np.int64)
    seconds = np.empty(count, np.int64)
    expiry = np.empty(count)
    tree = (points, ends, boxes)
    for n in range(poses.shape[0]):
        own = n if swabs.shape[0] > 1 else 0
        mask = n if masked else 0
        converged[n], iterations[n], rms[n] = _fit(
            tree,
            kept[mask],
            masked,
            swabs[own],
            radii[own],
            poses[n],
            limits,
            matches,
            seconds,
            expiry,
            out[n],
        )
