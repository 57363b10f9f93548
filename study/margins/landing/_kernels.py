"""Compiled: where registrations put voxels, and what the worst of them is there.

Places are in voxels: voxel (i, j, k) is all that lies within half a voxel of (i, j, k), its lower faces
included.
"""

from __future__ import annotations

from math import floor

import numpy as np

from study._compiled import inlined, threaded


@inlined
def _landed(move, point):
    """Voxel in which a point lands."""
    x, y, z = point[0], point[1], point[2]
    return (
        int(floor(move[0, 0] * x + move[0, 1] * y + move[0, 2] * z + move[0, 3] + 0.5)),
        int(floor(move[1, 0] * x + move[1, 1] * y + move[1, 2] * z + move[1, 3] + 0.5)),
        int(floor(move[2, 0] * x + move[2, 1] * y + move[2, 2] * z + move[2, 3] + 0.5)),
    )


@threaded
def largest_ranks(moves, points, rank, beyond, first_only, out):
    """For each transform the largest rank of the voxels in which points land.

    Parameters
    ----------
    moves : (n, 3, 4) float array
        From voxels to voxels.
    points : (m, 3) float array
    rank : (nx, ny, nz) int32 array
    beyond : int
        Rank of all that is outside the array.
    first_only : bool
        Any rank above 0 will do.
    out : (n,) int32 array
        Receives the largest rank, at least 0.
    """
    nx, ny, nz = rank.shape
    for n in range(moves.shape[0]):
        most = np.int32(0)
        for m in range(points.shape[0]):
            i, j, k = _landed(moves[n], points[m])
            there = np.int32(beyond)
            if 0 <= i < nx and 0 <= j < ny and 0 <= k < nz:
                there = rank[i, j, k]
            if there > most:
                most = there
                if first_only:
                    break
        out[n] = most


@threaded
def largest_lost(moves, points, ranks, solid, out):
    """For each transform the largest rank of the points that do not land in a structure.

    Parameters
    ----------
    moves : (n, 3, 4) float array
        From voxels to voxels.
    points : (m, 3) float array
        By decreasing rank.
    ranks : (m,) int32 array
        Of the points, above 0.
    solid : (nx, ny, nz) uint8 array
        1 in the structure; there is none of it outside the array.
    out : (n,) int32 array
        Receives the largest rank, 0 where all points land in the structure.
    """
    nx, ny, nz = solid.shape
    for n in range(moves.shape[0]):
        out[n] = 0
        for m in range(points.shape[0]):
            i, j, k = _landed(moves[n], points[m])
            if not (0 <= i < nx and 0 <= j < ny and 0 <= k < nz and solid[i, j, k]):
                out[n] = ranks[m]
                break


@threaded
def count_violations(moves, points, union, seen, counts):
    """Count for each voxel outside a union the transforms that put a point into it, each once.

    Parameters
    ----------
    moves : (n, 3, 4) float array
        From voxels to voxels.
    points : (m, 3) float array
    union : (nx, ny, nz) uint8 array
        Structure and margin; what lands outside the array is not counted.
    seen : (nx, ny, nz) int32 array
        All 0 at first.
    counts : (nx, ny, nz) int32 array
        Counts are added here.
    """
    nx, ny, nz = union.shape
    for n in range(moves.shape[0]):
        for m in range(points.shape[0]):
            i, j, k = _landed(moves[n], points[m])
            if 0 <= i < nx and 0 <= j < ny and 0 <= k < nz and union[i, j, k] == 0 and seen[i, j, k] != n + 1:
                seen[i, j, k] = n + 1
                counts[i, j, k] += 1


@threaded
def count_lost(moves, points, solid, counts):
    """Count for each point the transforms that do not put it into a structure.

    Parameters
    ----------
    moves : (n, 3, 4) float array
        From voxels to voxels.
    points : (m, 3) float array
    solid : (nx, ny, nz) uint8 array
        1 in the structure; there is none of it outside the array.
    counts : (m,) int32 array
        Counts are added here.
    """
    nx, ny, nz = solid.shape
    for n in range(moves.shape[0]):
        for m in range(points.shape[0]):
            i, j, k = _landed(moves[n], points[m])
            if not (0 <= i < nx and 0 <= j < ny and 0 <= k < nz and solid[i, j, k]):
                counts[m] += 1
