"""Compiled: how far transforms move points, and lattice corners in voxels."""

from __future__ import annotations

from math import floor, sqrt

import numpy as np

from study._compiled import inner, kernel, threaded

SLACK = 1e-9  # voxels: rounding must not hide an offset


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
def offsets_of_blocks(moves, shape, block, low, high):
    """Write the least and largest whole-voxel offset, along each axis, of the corners of every block.

    Parameters
    ----------
    moves : (n, 3, 4) float array
        See `lattice_moves`.
    shape : (3,) int array
        Of the lattice of corners.
    block : int
        Edge of a block in lattice steps; blocks are numbered with the last axis fastest.
    low, high : (blocks, 3) int arrays
    """
    by, bz = (shape[1] - 1) // block + 1, (shape[2] - 1) // block + 1
    first = np.empty(3)
    last = np.empty(3)
    for b in range(low.shape[0]):
        first[0], first[1], first[2] = b // (by * bz) * block, b // bz % by * block, b % bz * block
        for c in range(3):
            last[c] = min(first[c] + block, shape[c]) - 1
        for r in range(3):
            least = np.inf
            most = -np.inf
            for n in range(moves.shape[0]):
                middle = moves[n, r, 3]
                half = SLACK
                for c in range(3):
                    middle += moves[n, r, c] * 0.5 * (first[c] + last[c])
                    half += abs(moves[n, r, c]) * 0.5 * (last[c] - first[c])
                least = min(least, middle - half)
                most = max(most, middle + half)
            low[b, r] = int(floor(least))
            high[b, r] = int(floor(most))


@threaded
def offsets_that_occur(moves, shape, block, begin, end, low, high, table):
    """Mark the offsets that the corners of every block have by any of the transforms.

    Parameters
    ----------
    moves, shape, block
        See `offsets_of_blocks`.
    begin, end : int
        Blocks to do.
    low, high : (blocks, 3) int arrays
        From there.
    table : (blocks, sx, sy, sz) uint8 array
        All 0 at first; ``table[b, x, y, z]`` is set if offset ``low[b] + (x, y, z)`` occurs, or might by the
        bounds of what a block moves by.
    """
    by, bz = (shape[1] - 1) // block + 1, (shape[2] - 1) // block + 1
    first = np.empty(3)
    last = np.empty(3)
    span = np.empty((3, 2), np.int64)
    for b in range(begin, end):
        first[0], first[1], first[2] = b // (by * bz) * block, b // bz % by * block, b % bz * block
        for c in range(3):
            last[c] = min(first[c] + block, shape[c]) - 1
        for n in range(moves.shape[0]):
            for r in range(3):
                middle = moves[n, r, 3]
                half = SLACK
                for c in range(3):
                    middle += moves[n, r, c] * 0.5 * (first[c] + last[c])
                    half += abs(moves[n, r, c]) * 0.5 * (last[c] - first[c])
                span[r, 0] = int(floor(middle - half)) - low[b, r]
                span[r, 1] = int(floor(middle + half)) - low[b, r]
            for x in range(span[0, 0], span[0, 1] + 1):
                for y in range(span[1, 0], span[1, 1] + 1):
                    for z in range(span[2, 0], span[2, 1] + 1):
                        table[b, x, y, z] = 1


@inner
def _or_into(to, other):
    """Set `to` where `other` is set: a loop of its own, so that it is vectorised."""
    for k in range(to.shape[0]):
        to[k] |= other[k]


@threaded
def reached(solid, block, begin, end, low, table, out):
    """Set `out` at the lattice corners that an offset of their block carries into the structure.

    Parameters
    ----------
    solid : (nx, ny, nz) uint8 array
        The structure.
    block, begin, end, low, table
        See `offsets_that_occur`.
    out : (nx + 1, ny + 1, nz + 1) uint8 array
        All 0 at first.
    """
    nx, ny, nz = solid.shape
    mx, my, mz = out.shape
    by, bz = (my - 1) // block + 1, (mz - 1) // block + 1
    first_set = np.empty((nx, ny), np.int64)  # of every line along the last axis
    last_set = np.empty((nx, ny), np.int64)
    for x in range(nx):
        for y in range(ny):
            first_set[x, y] = nz
            last_set[x, y] = -1
            for z in range(nz):
                if solid[x, y, z]:
                    first_set[x, y] = min(first_set[x, y], z)
                    last_set[x, y] = z
    for b in range(begin, end):
        a0, b0, c0 = b // (by * bz) * block, b // bz % by * block, b % bz * block
        a1, b1, c1 = min(a0 + block, mx), min(b0 + block, my), min(c0 + block, mz)
        for u in range(table.shape[1]):
            for v in range(table.shape[2]):
                for w in range(table.shape[3]):
                    if table[b, u, v, w] == 0:
                        continue
                    dx, dy, dz = low[b, 0] + u, low[b, 1] + v, low[b, 2] + w
                    for i in range(max(a0, -dx), min(a1, nx - dx)):
                        for j in range(max(b0, -dy), min(b1, ny - dy)):
                            k0 = max(c0, first_set[i + dx, j + dy] - dz)
                            k1 = min(c1, last_set[i + dx, j + dy] + 1 - dz)
                            if k1 > k0:
                                _or_into(out[i, j, k0:k1], solid[i + dx, j + dy, k0 + dz : k1 + dz])


@threaded
def reaching(solid, block, begin, end, low, high, out):
    """Set `out` where the structure is at one of the offsets that a place's block allows.

    Parameters
    ----------
    solid : (nx, ny, nz) uint8 array
        The structure.
    block : int
        Edge of a block.
    begin, end : int
        Blocks to do.
    low, high : (blocks, 3) int arrays
        Offsets allowed along each axis, both ends included.
    out : (mx, my, mz) uint8 array
        All 0 at first; set at ``c`` where ``solid[c + offset]`` is for an offset of its block.
    """
    nx, ny, nz = solid.shape
    mx, my, mz = out.shape
    by, bz = (my - 1) // block + 1, (mz - 1) // block + 1
    for b in range(begin, end):
        a0, b0, c0 = b // (by * bz) * block, b // bz % by * block, b % bz * block
        a1, b1, c1 = min(a0 + block, mx), min(b0 + block, my), min(c0 + block, mz)
        x0, x1 = max(a0 + low[b, 0], 0), min(a1 + high[b, 0], nx)
        y0, y1 = max(b0 + low[b, 1], 0), min(b1 + high[b, 1], ny)
        if x1 <= x0 or y1 <= y0:
            continue
        lines = np.zeros((x1 - x0, y1 - y0, c1 - c0), np.uint8)
        found = False
        for x in range(x0, x1):
            for y in range(y0, y1):
                last = -(1 << 60)
                ahead = max(c0 + low[b, 2], 0)
                for c in range(c0, c1):
                    while ahead <= c + high[b, 2] and ahead < nz:
                        if solid[x, y, ahead]:
                            last = ahead
                        ahead += 1
                    if last >= c + low[b, 2]:
                        lines[x - x0, y - y0, c - c0] = 1
                        found = True
        if not found:
            continue
        sheets = np.zeros((x1 - x0, b1 - b0, c1 - c0), np.uint8)
        for x in range(x1 - x0):
            for j in range(b0, b1):
                for y in range(max(j + low[b, 1], y0), min(j + high[b, 1] + 1, y1)):
                    for c in range(c1 - c0):
                        sheets[x, j - b0, c] |= lines[x, y - y0, c]
        for i in range(a0, a1):
            for x in range(max(i + low[b, 0], x0), min(i + high[b, 0] + 1, x1)):
                for j in range(b1 - b0):
                    for c in range(c1 - c0):
                        out[i, b0 + j, c0 + c] |= sheets[x - x0, j, c]
