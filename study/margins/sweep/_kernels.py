"""Compiled: for each drawn transform, the most valuable lattice corner that it carries into a structure.

A transform moves lattice corner c by ``d = D c + t`` voxels; the corner then lies in voxel
``c + floor(d)``. Registrations turn so little that the offset ``floor(d)`` is one and the same for whole
blocks of corners, and few offsets occur. The answer of a block to an offset is worked out once and
remembered, so that a registration costs some hundred looks instead of some hundred thousand. Where a block
does not move by one offset, the best of the answers to all offsets that it may have is an upper bound: only
if that beats what was found elsewhere are smaller blocks, and in the end single corners, looked at. The
result is the same as from looking at every corner.

Arrays of a `Corners` (see `arrange`): corners in leaves of 8^3, each leaf's most valuable first, leaves in
groups of 4^3.
"""

from __future__ import annotations

from math import floor

import numpy as np

from study._compiled import inlined, kernel

LEAF = 8  # lattice steps
GROUP = 4  # leaves
# Bounds of a block's offsets are taken this much wider than worked out: rounding must not hide one.
SLACK = 1e-9
MOST_OFFSETS = 27  # a block that may have more is not bounded but opened


@kernel
def exposed_corners(order, state, where, value):
    """List the corners of ranked voxels and those where unranked ones touch the structure, worthiest first.

    Parameters
    ----------
    order : (n,) int array
        Flat indices of voxels by increasing rank; the rank of ``order[r]`` is ``r + 1``.
    state : (nx, ny, nz) uint8 array
        1 inside the structure, 2 where a voxel has a rank, 0 elsewhere.
    where : (m, 3) int32 array
        Receives corners.
    value : (m,) int32 array
        Receives the largest rank of the voxels that a corner touches; n + 1 where it touches a voxel
        that is neither ranked nor in the structure.

    Returns
    -------
    int
        Number of corners; more than `where` holds if some could not be written.
    """
    nx, ny, nz = state.shape
    seen = np.zeros((nx + 1, ny + 1, nz + 1), np.uint8)
    beyond = order.shape[0] + 1
    count = 0
    # What touches an unranked voxel comes first: it is worth most.
    for unranked in (True, False):
        for r in range(order.shape[0] - 1, -1, -1):
            flat = order[r]
            i, j, k = flat // (ny * nz), (flat // nz) % ny, flat % nz
            for a in range(i, i + 2):
                for b in range(j, j + 2):
                    for c in range(k, k + 2):
                        if seen[a, b, c] or (unranked and not _touches(state, a, b, c, 0)):
                            continue
                        seen[a, b, c] = 1
                        where[count, 0] = a
                        where[count, 1] = b
                        where[count, 2] = c
                        value[count] = beyond if unranked else r + 1
                        count += 1
        if unranked:
            for i in range(nx):
                for j in range(ny):
                    for k in range(nz):
                        if state[i, j, k] != 1:
                            continue
                        for a in range(i, i + 2):
                            for b in range(j, j + 2):
                                for c in range(k, k + 2):
                                    if seen[a, b, c] or not _touches(state, a, b, c, 0):
                                        continue
                                    seen[a, b, c] = 1
                                    if count < where.shape[0]:
                                        where[count, 0] = a
                                        where[count, 1] = b
                                        where[count, 2] = c
                                        value[count] = beyond
                                    count += 1
    return count


@inlined
def _touches(state, a, b, c, wanted):
    """Whether a lattice corner touches a voxel of a state."""
    nx, ny, nz = state.shape
    found = False
    for x in range(max(a - 1, 0), min(a + 1, nx)):
        for y in range(max(b - 1, 0), min(b + 1, ny)):
            for z in range(max(c - 1, 0), min(c + 1, nz)):
                if state[x, y, z] == wanted:
                    found = True
    return found


@kernel
def shell_corners(union, where):
    """List the lattice corners that touch voxels inside and outside of `union`.

    Returns
    -------
    int
        Number of corners.
    """
    nx, ny, nz = union.shape
    seen = np.zeros((nx + 1, ny + 1, nz + 1), np.uint8)
    count = 0
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if union[i, j, k] == 0:
                    continue
                for a in range(i, i + 2):
                    for b in range(j, j + 2):
                        for c in range(k, k + 2):
                            if seen[a, b, c]:
                                continue
                            seen[a, b, c] = 1
                            if _touches(union, a, b, c, 0):
                                if count < where.shape[0]:
                                    where[count, 0] = a
                                    where[count, 1] = b
                                    where[count, 2] = c
                                count += 1
    return count


@kernel
def arrange(where, value, shape, corners, values, leaf_start, leaf_low, leaf_high, group_start):
    """Sort corners into leaves and leaves into groups; within a leaf the order stays.

    Parameters
    ----------
    where : (n, 3) int32 array
    value : (n,) int32 array
        Not increasing.
    shape : (3,) int array
        Of the lattice.
    corners, values : like `where` and `value`
        Receive the sorted ones.
    leaf_start : (most leaves + 1,) int array
    leaf_low, leaf_high : (most leaves, 3) int arrays
        Receive the smallest and largest corner of each leaf.
    group_start : (most groups + 1,) int array
        Receives the first leaf of each group.

    Returns
    -------
    (int, int)
        Numbers of leaves and groups.
    """
    size = LEAF * GROUP
    gx, gy, gz = (shape[0] - 1) // size + 1, (shape[1] - 1) // size + 1, (shape[2] - 1) // size + 1
    cells = np.zeros(gx * gy * gz * GROUP**3 + 1, np.int64)
    n = where.shape[0]
    for r in range(n):
        cells[_cell(where, r, gy, gz) + 1] += 1
    leaves = 0
    groups = 0
    group_of_last = -1
    total = 0
    for cell in range(cells.shape[0] - 1):
        count = cells[cell + 1]
        if count:
            if cell // GROUP**3 != group_of_last:
                group_of_last = cell // GROUP**3
                group_start[groups] = leaves
                groups += 1
            leaf_start[leaves] = total
            leaves += 1
            total += count
        cells[cell] = total - count  # where the next corner of this cell goes
    leaf_start[leaves] = total
    group_start[groups] = leaves
    for r in range(n):
        cell = _cell(where, r, gy, gz)
        to = cells[cell]
        cells[cell] += 1
        values[to] = value[r]
        for c in range(3):
            corners[to, c] = where[r, c]
    for leaf in range(leaves):
        for c in range(3):
            low = corners[leaf_start[leaf], c]
            high = low
            for r in range(leaf_start[leaf] + 1, leaf_start[leaf + 1]):
                low = min(low, corners[r, c])
                high = max(high, corners[r, c])
            leaf_low[leaf, c] = low
            leaf_high[leaf, c] = high
    return leaves, groups


@inlined
def _cell(where, r, gy, gz):
    x, y, z = where[r, 0] // LEAF, where[r, 1] // LEAF, where[r, 2] // LEAF
    group = ((x // GROUP) * gy + y // GROUP) * gz + z // GROUP
    return ((group * GROUP + x % GROUP) * GROUP + y % GROUP) * GROUP + z % GROUP


@inlined
def _bounds(move, low, high, n, span):
    """Write into `span` the least and largest offset of a block along each axis; their number returned."""
    count = 1
    for r in range(3):
        middle = move[r, 3]
        half = SLACK
        for c in range(3):
            middle += move[r, c] * 0.5 * (low[n, c] + high[n, c])
            half += abs(move[r, c]) * 0.5 * (high[n, c] - low[n, c])
        span[r, 0] = int(floor(middle - half))
        span[r, 1] = int(floor(middle + half))
        count *= span[r, 1] - span[r, 0] + 1
    return count


@inlined
def _leaf_answer(solid, corners, values, first, last, x, y, z):
    """Largest value of corners that the offset carries into the structure; 0 if none."""
    nx, ny, nz = solid.shape
    for r in range(first, last):
        i, j, k = corners[r, 0] + x, corners[r, 1] + y, corners[r, 2] + z
        if 0 <= i < nx and 0 <= j < ny and 0 <= k < nz and solid[i, j, k]:
            return values[r]
    return np.int32(0)


@inlined
def _remembered(solid, corners, values, leaf_start, memo, leaf, slot, x, y, z):
    """Answer of a leaf to an offset, from the memo (which holds it plus 1, 0 is unknown) if it has one."""
    if slot < 0:
        return _leaf_answer(solid, corners, values, leaf_start[leaf], leaf_start[leaf + 1], x, y, z)
    known = memo[leaf, slot]
    if known == 0:
        known = _leaf_answer(solid, corners, values, leaf_start[leaf], leaf_start[leaf + 1], x, y, z) + 1
        memo[leaf, slot] = known
    return known - 1


@inlined
def _slot(x, y, z, table, enabled):
    """Place of an offset in the memos; -1 when there is none."""
    if not enabled:
        return -1
    a, b, c = x - table[0, 0], y - table[1, 0], z - table[2, 0]
    if a < 0 or b < 0 or c < 0 or a >= table[0, 1] or b >= table[1, 1] or c >= table[2, 1]:
        return -1
    return (a * table[1, 1] + b) * table[2, 1] + c


@inlined
def _leaf_bound(solid, corners, values, leaf_start, memo, table, use, leaf, span):
    """Largest answer of a leaf to the offsets in `span`."""
    best = np.int32(0)
    for x in range(span[0, 0], span[0, 1] + 1):
        for y in range(span[1, 0], span[1, 1] + 1):
            for z in range(span[2, 0], span[2, 1] + 1):
                slot = _slot(x, y, z, table, use)
                best = max(best, _remembered(solid, corners, values, leaf_start, memo, leaf, slot, x, y, z))
    return best


@inlined
def _group_bound(solid, corners, values, leaf_start, group_start, memo, memo_group, table, use, group, span):
    """Largest answer of a group's leaves to the offsets in `span`; needs the group's memo."""
    best = np.int32(0)
    for x in range(span[0, 0], span[0, 1] + 1):
        for y in range(span[1, 0], span[1, 1] + 1):
            for z in range(span[2, 0], span[2, 1] + 1):
                slot = _slot(x, y, z, table, use)
                known = memo_group[group, slot]
                if known == 0:
                    for leaf in range(group_start[group], group_start[group + 1]):
                        if values[leaf_start[leaf]] >= known:
                            answer = _remembered(
                                solid, corners, values, leaf_start, memo, leaf, slot, x, y, z
                            )
                            known = max(known, answer + 1)
                    known = max(known, np.int32(1))
                    memo_group[group, slot] = known
                best = max(best, known - 1)
    return best


@inlined
def _corner_by_corner(solid, corners, values, first, last, move, best):
    """Largest value above `best` of corners that the transform carries into the structure; `best` if none."""
    nx, ny, nz = solid.shape
    for r in range(first, last):
        if values[r] <= best:
            break
        a, b, c = corners[r, 0], corners[r, 1], corners[r, 2]
        i = a + int(floor(move[0, 3] + move[0, 0] * a + move[0, 1] * b + move[0, 2] * c))
        j = b + int(floor(move[1, 3] + move[1, 0] * a + move[1, 1] * b + move[1, 2] * c))
        k = c + int(floor(move[2, 3] + move[2, 0] * a + move[2, 1] * b + move[2, 2] * c))
        if 0 <= i < nx and 0 <= j < ny and 0 <= k < nz and solid[i, j, k]:
            return values[r]
    return best


@kernel
def sweep(
    moves,
    solid,
    corners,
    values,
    leaf_start,
    leaf_low,
    leaf_high,
    group_start,
    group_low,
    group_high,
    group_most,
    memo,
    memo_group,
    table,
    use,
    above,
    first_only,
    out,
):
    """Largest value of the corners that each transform carries into the structure.

    Parameters
    ----------
    moves : (n, 3, 4) float array
        ``[D, t]``: a corner's displacement in voxels.
    solid : (nx, ny, nz) uint8 array
        The structure.
    corners, values, leaf_start, leaf_low, leaf_high, group_start
        See `arrange`.
    group_low, group_high, group_most : (groups, 3), (groups, 3), (groups,) arrays
        A group's extent and its largest value.
    memo, memo_group : (leaves, offsets), (groups, offsets) int32 arrays
        Remembered answers plus 1; all 0 at first.
    table : (3, 2) int array
        Least offset that the memos hold along each axis, and how many.
    use : bool
        Whether there are memos.
    above : int
        Only values above this count.
    first_only : bool
        Any value above it will do.
    out : (n,) int32 array
        Receives the largest value, `above` where there is none above it.
    """
    groups = group_most.shape[0]
    span = np.empty((3, 2), np.int64)
    later = np.empty(groups, np.int64)
    bound = np.empty(groups, np.int32)
    for n in range(moves.shape[0]):
        move = moves[n]
        best = np.int32(above)
        waiting = 0
        for g in range(groups):
            if group_most[g] <= best:
                continue
            count = _bounds(move, group_low, group_high, g, span)
            inside = use and count <= MOST_OFFSETS
            if inside:
                for r in range(3):
                    if span[r, 0] < table[r, 0] or span[r, 1] >= table[r, 0] + table[r, 1]:
                        inside = False
            if inside:
                most = _group_bound(
                    solid,
                    corners,
                    values,
                    leaf_start,
                    group_start,
                    memo,
                    memo_group,
                    table,
                    use,
                    g,
                    span,
                )
                if most <= best:
                    continue
                if count == 1:
                    best = most
                    if first_only:
                        break
                    continue
            else:
                most = group_most[g]
            later[waiting] = g
            bound[waiting] = most
            waiting += 1
        if not (first_only and best > above):
            for w in range(waiting):
                if bound[w] <= best:
                    continue
                g = later[w]
                for leaf in range(group_start[g], group_start[g + 1]):
                    if values[leaf_start[leaf]] <= best:
                        continue
                    count = _bounds(move, leaf_low, leaf_high, leaf, span)
                    if count <= MOST_OFFSETS and (use or count == 1):
                        most = _leaf_bound(solid, corners, values, leaf_start, memo, table, use, leaf, span)
                        if most <= best:
                            continue
                        if count == 1:
                            best = most
                            if first_only:
                                break
                            continue
                    best = _corner_by_corner(
                        solid, corners, values, leaf_start[leaf], leaf_start[leaf + 1], move, best
                    )
                    if first_only and best > above:
                        break
                if first_only and best > above:
                    break
        out[n] = best
