"""Compiled: how near drills pass by points. A drill is a segment, from its entry to the tip's centre."""

from __future__ import annotations

from math import sqrt

from study._compiled import inner, threaded

_ROUNDING = 1e-9  # mm: far more than rounding errs, far less than anything measured


@inner
def to_segment(x, y, z, dx, dy, dz):
    """Squared distance of a point from a segment, and where on it: 0 at the start, 1 at the end.

    Parameters
    ----------
    x, y, z : float
        The point, seen from the segment's start.
    dx, dy, dz : float
        The segment's end, seen from its start; a segment may be a point.
    """
    length2 = dx * dx + dy * dy + dz * dz
    share = 0.0
    if length2 > 0.0:
        share = min(max((x * dx + y * dy + z * dz) / length2, 0.0), 1.0)
    x -= share * dx
    y -= share * dy
    z -= share * dz
    return x * x + y * y + z * z, share


@threaded
def nearest_points(points, starts, ends, distances, shares, indices):
    """For every segment its nearest point.

    Parameters
    ----------
    points : (m, 3) float array
        At least one.
    starts, ends : (n, 3) float arrays
    distances, shares : (n,) float arrays
        Receive the distance and where on the segment it is found.
    indices : (n,) int array
        Receives which point it is; the first of several.
    """
    for n in range(len(starts)):
        dx = ends[n, 0] - starts[n, 0]
        dy = ends[n, 1] - starts[n, 1]
        dz = ends[n, 2] - starts[n, 2]
        least = 1e300
        where = 0.0
        which = 0
        for m in range(len(points)):
            square, share = to_segment(
                points[m, 0] - starts[n, 0],
                points[m, 1] - starts[n, 1],
                points[m, 2] - starts[n, 2],
                dx,
                dy,
                dz,
            )
            if square < least:
                least = square
                where = share
                which = m
        distances[n] = sqrt(least)
        shares[n] = where
        indices[n] = which


@threaded
def distances_from_segment(points, start, end, out):
    """Distances (m,) of points (m, 3) from one segment."""
    dx = end[0] - start[0]
    dy = end[1] - start[1]
    dz = end[2] - start[2]
    for m in range(len(points)):
        square, _ = to_segment(
            points[m, 0] - start[0], points[m, 1] - start[1], points[m, 2] - start[2], dx, dy, dz
        )
        out[m] = sqrt(square)


@threaded
def erring_distances(points, nominal, first, start, end, errors, out):
    """For every error and structure the distance from the erring segment to the nearest point.

    No point of the segment moves by more than the larger of its ends' errors, so neither does its distance
    from anything: once the points come, by increasing distance from the planned segment, that are farther
    by more than this, none can be nearer any more.

    Parameters
    ----------
    points : (m, 3) float array
        Structure after structure, in each by increasing `nominal`.
    nominal : (m,) float array
        Distance from the planned segment.
    first : (s + 1,) int array
        Where each structure begins; none is empty.
    start, end : (3,) float arrays
        The planned segment.
    errors : (n, 2, 3) float array
        Of start and end.
    out : (n, s) float array
    """
    for n in range(len(errors)):
        ax = start[0] + errors[n, 0, 0]
        ay = start[1] + errors[n, 0, 1]
        az = start[2] + errors[n, 0, 2]
        dx = end[0] + errors[n, 1, 0] - ax
        dy = end[1] + errors[n, 1, 1] - ay
        dz = end[2] + errors[n, 1, 2] - az
        moved = 0.0
        for side in range(2):
            square = errors[n, side, 0] ** 2 + errors[n, side, 1] ** 2 + errors[n, side, 2] ** 2
            moved = max(moved, square)
        moved = sqrt(moved) + _ROUNDING
        for s in range(len(first) - 1):
            least = 1e300
            distance = 1e150
            for m in range(first[s], first[s + 1]):
                if nominal[m] - moved > distance:
                    break
                square, _ = to_segment(points[m, 0] - ax, points[m, 1] - ay, points[m, 2] - az, dx, dy, dz)
                if square < least:
                    least = square
                    distance = sqrt(square)
            out[n, s] = distance
