"""Compiled: how far transforms move points, and lattice corners in voxels."""

from __future__ import annotations

from math import floor, sqrt

from study._compiled import kernel


@kernel
def largest_displacement(transforms, points):
    """Largest distance by which any of (n, 4, 4) transforms moves any of (m, 3) points."""
    most = 0.0
    for n in range(transforms.shape[0]):
        for m in range(points.shape[0]):
            square = 0.0
            for r in range(3):
                value = transforms[n, r, 3] - points[m, r]
                for c in range(3):
                    value += transforms[n, r, c] * points[m, c]
                square += value * value
            most = max(most, square)
    return sqrt(most)


@kernel
def lattice_moves(transforms, to_voxels, to_mm, first, out):
    """Write ``[D, t]`` with the displacement ``D c + t``, in voxels, of lattice corner c by each transform.

    Parameters
    ----------
    transforms : (n, 4, 4) float array
        mm.
    to_voxels, to_mm : (3, 3) float arrays
        mm to voxel steps and back.
    first : (3,) float array
        mm of corner (0, 0, 0).
    out : (n, 3, 4) float array
    """
    for n in range(transforms.shape[0]):
        for r in range(3):
            for c in range(4):
                out[n, r, c] = 0.0
            for k in range(3):
                shift = transforms[n, k, 3] - first[k]
                for m in range(3):
                    turn = transforms[n, k, m]
                    shift += turn * first[m]
                    if k == m:
                        turn -= 1.0
                    for c in range(3):
                        out[n, r, c] += to_voxels[r, k] * turn * to_mm[m, c]
                out[n, r, 3] += to_voxels[r, k] * shift


@kernel
def offset_range(moves, corners, low, high):
    """Write the least and largest whole-voxel offset along each axis of any of (m, 3) corners.

    Parameters
    ----------
    moves : (n, 3, 4) float array
        See `lattice_moves`.
    corners : (m, 3) float array
    low, high : (3,) int arrays
    """
    for r in range(3):
        least = 1e18
        most = -1e18
        for n in range(moves.shape[0]):
            for m in range(corners.shape[0]):
                value = moves[n, r, 3]
                for c in range(3):
                    value += moves[n, r, c] * corners[m, c]
                least = min(least, value)
                most = max(most, value)
        low[r] = int(floor(least))
        high[r] = int(floor(most))
