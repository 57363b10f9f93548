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

from study._compiled import inlined, inner, kernel, threaded

LEAF = 8  # lattice steps
GROUP = 4  # leaves
# Bounds of a block's offsets are taken this much wider than worked out: rounding must not hide one.
SLACK = 1e-9
MOST_OFFSETS = 27  # a block that may have more is not bounded but opened


@kernel
def arrange(rank, reaching, above, shell_only):
    """List the lattice corners that matter, in leaves and groups, each leaf's most valuable corner first.

    Parameters
    ----------
    rank : (nx, ny, nz) int32 array
        When a voxel enters the margin; 0 in the structure. A corner is worth the largest rank of the voxels
        that it touches.
    reaching : (nx + 1, ny + 1, nz + 1) uint8 array
        Corners that a transform may carry into the structure.
    above : int
        Corners worth no more do not matter.
    shell_only : bool
        Only corners that also touch a voxel of rank 0.

    Returns
    -------
    corners : (n, 3) int32 array
    values : (n,) int32 array
    leaf_start : (leaves + 1,) int array
        First corner of each leaf.
    leaf_low, leaf_high : (leaves, 3) int arrays
        Smallest and largest corner of each.
    group_start : (groups + 1,) int array
        First leaf of each group.
    """
    nx, ny, nz = rank.shape
    size = LEAF * GROUP
    gx, gy, gz = nx // size + 1, ny // size + 1, nz // size + 1
    corners = np.empty((1024, 3), np.int32)
    values = np.empty(1024, np.int32)
    leaf_start = np.empty(256, np.int64)
    leaf_low = np.empty((256, 3), np.int64)
    leaf_high = np.empty((256, 3), np.int64)
    group_start = np.empty(gx * gy * gz + 1, np.int64)
    keys = np.empty(LEAF**3, np.int64)
    count = 0
    leaves = 0
    groups = 0
    for group in range(gx * gy * gz):
        first = leaves
        for cell in range(GROUP**3):
            a0 = (group // (gy * gz)) * size + cell // (GROUP * GROUP) * LEAF
            b0 = (group // gz % gy) * size + cell // GROUP % GROUP * LEAF
            c0 = (group % gz) * size + cell % GROUP * LEAF
            if not _any_set(reaching, a0, b0, c0):
                continue
            found = 0
            for a in range(a0, min(a0 + LEAF, nx + 1)):
                for b in range(b0, min(b0 + LEAF, ny + 1)):
                    for c in range(c0, min(c0 + LEAF, nz + 1)):
                        if reaching[a, b, c] == 0:
                            continue
                        worth = np.int64(-1)
                        least = np.int64(1 << 40)
                        for x in range(max(a - 1, 0), min(a + 1, nx)):
                            for y in range(max(b - 1, 0), min(b + 1, ny)):
                                for z in range(max(c - 1, 0), min(c + 1, nz)):
                                    worth = max(worth, np.int64(rank[x, y, z]))
                                    least = min(least, np.int64(rank[x, y, z]))
                        if worth > above and (least == 0 or not shell_only):
                            place = ((a - a0) * LEAF + b - b0) * LEAF + c - c0
                            keys[found] = worth * LEAF**3 + place
                            found += 1
            if found == 0:
                continue
            _sort_decreasing(keys, found)
            while count + found > values.shape[0]:
                corners = _longer_rows(corners)
                grown = np.empty(2 * values.shape[0], np.int32)
                for r in range(count):
                    grown[r] = values[r]
                values = grown
            if leaves + 2 > leaf_start.shape[0]:
                leaf_low = _longer_rows(leaf_low)
                leaf_high = _longer_rows(leaf_high)
                starts = np.empty(2 * leaf_start.shape[0], np.int64)
                for r in range(leaves):
                    starts[r] = leaf_start[r]
                leaf_start = starts
            leaf_start[leaves] = count
            for r in range(found):
                place = keys[r] % LEAF**3
                values[count] = keys[r] // LEAF**3
                corners[count, 0] = a0 + place // (LEAF * LEAF)
                corners[count, 1] = b0 + place // LEAF % LEAF
                corners[count, 2] = c0 + place % LEAF
                for t in range(3):
                    if r == 0:
                        leaf_low[leaves, t] = corners[count, t]
                        leaf_high[leaves, t] = corners[count, t]
                    leaf_low[leaves, t] = min(leaf_low[leaves, t], np.int64(corners[count, t]))
                    leaf_high[leaves, t] = max(leaf_high[leaves, t], np.int64(corners[count, t]))
                count += 1
            leaves += 1
        if leaves > first:
            group_start[groups] = first
            groups += 1
    leaf_start[leaves] = count
    group_start[groups] = leaves
    return (
        corners[:count],
        values[:count],
        leaf_start[: leaves + 1],
        leaf_low[:leaves],
        leaf_high[:leaves],
        group_start[: groups + 1],
    )


@inner
def _longer_rows(array):
    """The same rows in an array of twice the length."""
    out = np.empty((2 * array.shape[0], 3), array.dtype)
    for r in range(array.shape[0]):
        for c in range(3):
            out[r, c] = array[r, c]
    return out


@inner
def _any_set(mask, a0, b0, c0):
    """Whether any corner of a leaf is set."""
    for a in range(a0, min(a0 + LEAF, mask.shape[0])):
        for b in range(b0, min(b0 + LEAF, mask.shape[1])):
            for c in range(c0, min(c0 + LEAF, mask.shape[2])):
                if mask[a, b, c]:
                    return True
    return False


@inner
def _sort_decreasing(keys, n):
    """Shell sort, in place."""
    gap = 1
    while gap < n // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for r in range(gap, n):
            key = keys[r]
            s = r
            while s >= gap and keys[s - gap] < key:
                keys[s] = keys[s - gap]
                s -= gap
            keys[s] = key
        gap //= 3


@inlined
def _bounds(move, low, high, n, extent, span):
    """Write into `span` the least and largest offset of a block along each axis; their number returned.

    0 if with none of them the block comes near the structure.
    """
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
        if high[n, r] + span[r, 1] < extent[r, 0] or low[n, r] + span[r, 0] > extent[r, 1]:
            return 0
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


@threaded
def sweep(
    moves,
    solid,
    extent,
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
    extent : (3, 2) int array
        Its first and last voxel along each axis.
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
            count = _bounds(move, group_low, group_high, g, extent, span)
            if count == 0:
                continue
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
                    count = _bounds(move, leaf_low, leaf_high, leaf, extent, span)
                    if count == 0:
                        continue
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
