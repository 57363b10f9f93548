"""Compiled iterative closest point fit: one swab, one start at a time, against sorted vertices.

Three things make it quick and change no result.

- A search begins with the vertex that was nearest the last time, and its neighbours: mostly they suffice.
  Where they do not, they bound the search through the tree.
- A match is kept without a search for as long as the point cannot have crossed a plane half way to
  another vertex, and is looked for among three vertices until it can have crossed yet another plane.
  How far a point at distance r from the swab's centroid can have moved is at most T + C r, where T adds
  up the centroid's steps and C the chords 2 sin(angle / 2) of the rotations.
- The sums that the best rotation needs are updated for the matches that changed.
"""

from __future__ import annotations

from math import asin, cos, sin, sqrt

import numpy as np

from study._compiled import inner, threaded
from study.registration._kernels import rotation_of_sums
from study.registration.icp.nearest._kernels import DEPTH, best_of, nearest_two, same_place, walk

REFRESH = 32  # iterations after which the sums are made afresh, so that round-off does not pile up
FLAT = 1e-9  # eigenvalue gap over the swab's sum of squares: below, the matches fix no rotation
NEAR_TIE = 1e-9  # shares of slack and of coordinates that round-off could decide
ROUND_OFF = 1e-12


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
def _inverse_inertia(swab, out):
    """Inverse of the centred swab's tensor of inertia: from a torque to a small rotation."""
    xx = yy = zz = xy = xz = yz = 0.0
    for i in range(swab.shape[0]):
        x, y, z = swab[i, 0], swab[i, 1], swab[i, 2]
        xx += y * y + z * z
        yy += x * x + z * z
        zz += x * x + y * y
        xy -= x * y
        xz -= x * z
        yz -= y * z
    a = yy * zz - yz * yz
    b = xz * yz - xy * zz
    c = xy * yz - xz * yy
    scale = 1.0 / (xx * a + xy * b + xz * c)
    out[0, 0] = a * scale
    out[0, 1] = out[1, 0] = b * scale
    out[0, 2] = out[2, 0] = c * scale
    out[1, 1] = (xx * zz - xz * xz) * scale
    out[1, 2] = out[2, 1] = (xy * xz - xx * yz) * scale
    out[2, 2] = (xx * yy - xy * xy) * scale


@inner
def _small_step(s, total, count, inverse, turn, centre, new, new_centre):
    """Gauss-Newton step: the rigid motion whose first order in the swab's own axes fits best.

    It is applied as the exponential of that motion, so that the result is rigid.
    """
    torque = np.empty(3)
    angle = np.empty(3)
    shift = np.empty(3)
    for r in range(3):
        a = (r + 1) % 3
        b = (r + 2) % 3
        torque[r] = 0.0
        shift[r] = 0.0
        for c in range(3):
            torque[r] += s[a, c] * turn[c, b] - s[b, c] * turn[c, a]
            shift[r] += turn[c, r] * (total[c] / count - centre[c])
    square = 0.0
    for r in range(3):
        angle[r] = inverse[r, 0] * torque[0] + inverse[r, 1] * torque[1] + inverse[r, 2] * torque[2]
        square += angle[r] * angle[r]
    size = sqrt(square)
    first = 1.0
    second = 0.5
    third = 1.0 / 6.0
    if size > 1e-4:  # below, the series' next terms are under round-off
        first = sin(size) / size
        second = (1.0 - cos(size)) / square
        third = (1.0 - first) / square
    for r in range(3):
        new_centre[r] = centre[r]
        for c in range(3):
            new[r, c] = 0.0
    for k in range(3):
        for c in range(3):
            # Rodrigues' formula for the rotation, and its mean along the way for the shift.
            skew = 0.0
            if k != c:
                skew = angle[3 - k - c] if (c - k) % 3 == 2 else -angle[3 - k - c]
            squared = angle[k] * angle[c]
            same = 0.0
            if k == c:
                squared -= square
                same = 1.0
            rotation = same + first * skew + second * squared
            along = same + second * skew + third * squared
            for r in range(3):
                new[r, c] += turn[r, k] * rotation
                new_centre[r] += turn[r, k] * along * shift[c]


@inner
def _match(tree, kept, masked, swab, radii, turn, centre, path, close, matches, rivals, state, work):
    """Search for the points whose match may have changed; keep the sums; return how many did change.

    `path` holds T and C of the module's text. While T + C r is below the first value of a point's `state`
    its match holds. The others say where it was when it was last searched for, and how far from there the
    match is the one found then or one of the two `rivals`.
    """
    points, ends, boxes, around, planes = tree
    s, total, stack, bounds = work
    changed = 0
    for i in range(matches.shape[0]):
        moved = path[0] + path[1] * radii[i]
        if moved < state[i, 0]:
            continue
        a, b, c = swab[i, 0], swab[i, 1], swab[i, 2]
        x = turn[0, 0] * a + turn[0, 1] * b + turn[0, 2] * c + centre[0]
        y = turn[1, 0] * a + turn[1, 1] * b + turn[1, 2] * c + centre[1]
        z = turn[2, 0] * a + turn[2, 1] * b + turn[2, 2] * c + centre[2]
        before = matches[i]
        first = before
        slack = -1.0
        free = -1.0
        if before >= 0:
            u, v, w = x - state[i, 1], y - state[i, 2], z - state[i, 3]
            free = state[i, 4] - sqrt(u * u + v * v + w * w)
        if free <= 0.0:
            if before >= 0:
                first, one, other, slack, free = walk(
                    points, around, planes, kept, masked, close, x, y, z, before
                )
                rivals[i, 0] = first
                rivals[i, 1] = one
                rivals[i, 2] = other
            if free < 0.0:
                first, near, next_ = nearest_two(
                    points, ends, boxes, kept, masked, stack, bounds, x, y, z, first
                )
                slack = free = 0.5 * (sqrt(next_) - sqrt(near))
                rivals[i, 0] = rivals[i, 1] = rivals[i, 2] = first
            free = free * (1.0 - NEAR_TIE) - close
            state[i, 1] = x
            state[i, 2] = y
            state[i, 3] = z
            state[i, 4] = free
        if slack <= close:  # not known, or a tie
            first, slack = best_of(points, rivals[i, 0], rivals[i, 1], rivals[i, 2], x, y, z)
        state[i, 0] = moved + min(slack * (1.0 - NEAR_TIE) - close, free)
        if before < 0 or (first != before and not same_place(points, first, before)):
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
def _fit(tree, kept, masked, swab, radii, pose, limits, matches, rivals, state, out):
    """Run one start until it stops; see `fit_many`. Return converged, iterations and RMS distance."""
    max_iterations, translation_tolerance, rotation_tolerance, scale, closed = limits
    points = tree[0]
    count = matches.shape[0]
    turn = np.empty((3, 3))
    new = np.empty((3, 3))
    centre = np.empty(3)
    new_centre = np.empty(3)
    inverse = np.empty((3, 3))
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
        state[i, 0] = -np.inf
        flat += FLAT * radii[i] * radii[i]
    reach = scale
    for r in range(3):
        centre[r] = pose[r, 3]
        reach += abs(centre[r])
        for c in range(3):
            turn[r, c] = pose[r, c]
    close = ROUND_OFF * reach
    if not closed:
        _inverse_inertia(swab, inverse)
    iterations = 0
    converged = False
    small = False
    while True:
        changed = _match(
            tree, kept, masked, swab, radii, turn, centre, path, close, matches, rivals, state, work
        )
        if iterations > 0 and (small or (closed and changed == 0)):
            converged = True
            break
        if iterations == max_iterations:
            break
        if iterations % REFRESH == 0:
            _sum_up(points, swab, matches, s, total)
        if not closed:
            _small_step(s, total, count, inverse, turn, centre, new, new_centre)
        elif rotation_of_sums(s, h, v, q, new) <= flat:
            break  # all matches on one line, or one vertex: no rotation is the best
        else:
            for r in range(3):
                new_centre[r] = total[r] / count
        shift = 0.0
        chord = 0.0
        for r in range(3):
            step = new_centre[r] - centre[r]
            shift += step * step
            centre[r] = new_centre[r]
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
def fit_many(tree, kept, masked, swabs, radii, poses, limits, out, converged, iterations, rms):
    """Fit a swab from each of many starts.

    Parameters
    ----------
    tree : tuple of arrays
        ``points``, ``ends``, ``boxes``, ``around`` and ``planes`` of a `SurfaceTree`.
    kept : (n, v) bool array
        In the tree's order; which vertices each start sees, if `masked`.
    swabs : (n or 1, p, 3) float array
        Centred, mm; one for all starts, or one each.
    radii : (n or 1, p) float array
        Distances of its points from the swab's centroid, mm.
    poses : (n, 3, 4) float array
        Rotation and centroid of the swab at the start, less the tree's origin.
    limits : (int, float, float, float, bool) tuple
        Iterations at most, translation (mm) and rotation (rad) below which a step counts as none, the
        size of the coordinates (mm), which says what round-off can do, and whether steps are the best
        fit in closed form or to first order.
    out : (n, 3, 4) float array
        Receives rotation and centroid of the swab at the end.
    converged, iterations, rms : (n,) bool, int and float arrays
        Receive how each ended; the RMS distance is to the nearest vertices at the end, mm.
    """
    count = swabs.shape[1]
    matches = np.empty(count, np.int64)
    rivals = np.empty((count, 3), np.int64)
    state = np.empty((count, 5))
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
            rivals,
            state,
            out[n],
        )
