"""Compiled motion of the burr: turning, stepping, the simple objective planner, relocation, the way home.

The burr's pose is a float64 array: layer, depth, lateral, tilt, low and high end of its window.
"""

from __future__ import annotations

import numpy as np

from study._compiled import inner
from study.collision._kernels import accessible_window, pose_is_free
from study.planners.simulation._kernels import (
    clear_supervoxel,
    draw,
    mill_ball,
    mill_sweep,
    record,
    sweep_is_safe,
)

NEIGHBOURS = np.array([[0, -1, 0], [-1, 0, 0], [1, 0, 0], [0, 0, -1], [0, 0, 1], [0, 1, 0]], dtype=np.int64)
ANY_TARGET, ONE_VOXEL, SLICE, WITHIN_SLICE = 0, 1, 2, 3  # what a search looks for


@inner
def window_from(sim, low, high, layer, depth, lateral):
    """Window of accessible angles of a voxel, as seen from a neighbour with the window [low, high]."""
    return accessible_window(sim.shaft, layer, depth, lateral, low, high, sim.min_window, sim.min_overlap)


@inner
def tilt_between(tilt, low, high, next_low, next_high):
    """Tilt at which to pass from one window to the next: the present one if it may stay."""
    a, z = max(low, next_low), min(high, next_high)
    if a <= tilt <= z:
        return tilt
    margin = min(0.0175, (z - a) / 4)  # not on the very edge: 1 degree, or a quarter of a narrow overlap
    return min(max(tilt, a + margin), z - margin)


@inner
def turn(sim, burr, tilt):
    """Tilt the shaft in place."""
    if tilt != burr[3]:
        burr[3] = tilt
        record(sim, burr[0], burr[1], burr[2], tilt, 0)


@inner
def remember(sim, layer, depth, lateral, low, high):
    """Keep a window for later searches: bone only disappears, so it stays free."""
    sim.known[layer, depth, lateral, 0] = np.float32(low + 1e-6)  # rounded inwards
    sim.known[layer, depth, lateral, 1] = np.float32(high - 1e-6)


@inner
def arrive(sim, burr, layer, depth, lateral, low, high):
    """Book-keeping at a voxel the burr has just reached with the window [low, high]."""
    clear_supervoxel(sim, layer, depth, lateral)
    burr[0], burr[1], burr[2], burr[4], burr[5] = layer, depth, lateral, low, high
    remember(sim, layer, depth, lateral, low, high)


@inner
def step_to(sim, burr, layer, depth, lateral, low, high):
    """Move to a voxel that shares a face with the present one."""
    turn(sim, burr, tilt_between(burr[3], burr[4], burr[5], low, high))
    removed = mill_ball(sim, layer, depth, lateral)
    record(sim, float(layer), float(depth), float(lateral), burr[3], removed)
    arrive(sim, burr, layer, depth, lateral, low, high)


@inner
def direct_step(sim, burr, layer, depth, lateral, low, high):
    """Move straight to a voxel up to reach + 1 away, checking every part on the way; False if barred."""
    l0, d0, b0 = int(burr[0]), int(burr[1]), int(burr[2])
    move = np.array([layer - l0, depth - d0, lateral - b0])
    parts = max(abs(move[0]), abs(move[1]), abs(move[2]))
    tilt = tilt_between(burr[3], burr[4], burr[5], low, high)
    if not sweep_is_safe(sim, l0, d0, b0, move):
        return False
    for part in range(1, parts):
        f = part / parts
        if not pose_is_free(sim.shaft, l0 + f * move[0], d0 + f * move[1], b0 + f * move[2], tilt):
            return False
    turn(sim, burr, tilt)
    for part in range(1, parts + 1):
        f = part / parts
        removed = mill_sweep(sim, l0, d0, b0, move, part)
        record(sim, l0 + f * move[0], d0 + f * move[1], b0 + f * move[2], tilt, removed)
    arrive(sim, burr, layer, depth, lateral, low, high)
    return True


@inner
def short_path(sim, burr, layer, depth, lateral):
    """The simple objective planner (2.2.6): step by step through the box between burr and goal.

    Voxels are labelled by their Manhattan distance; every step lowers the distance to go, ties are
    broken at random, dead ends are backed out of. Moves the burr and returns True on success; leaves
    everything as it was otherwise.
    """
    start = np.empty(3, np.int64)
    span = np.empty(3, np.int64)
    sign = np.ones(3, np.int64)
    for n in range(3):
        start[n] = int(burr[n])
        span[n] = (layer, depth, lateral)[n] - start[n]
        if span[n] < 0:
            span[n], sign[n] = -span[n], -1
    length = span[0] + span[1] + span[2]
    dead = np.zeros((span[0] + 1, span[1] + 1, span[2] + 1), np.bool_)
    trail = np.zeros((length + 1, 3), np.int64)
    low = np.zeros(length + 1)
    high = np.zeros(length + 1)
    low[0], high[0] = burr[4], burr[5]
    n = 0
    order = np.array([0, 1, 2])
    while n < length:
        for k in range(2):  # shuffle the three axes
            other = k + draw(sim, 3 - k)
            order[k], order[other] = order[other], order[k]
        advanced = False
        for k in range(3):
            axis = order[k]
            if trail[n, axis] == span[axis]:
                continue
            for m in range(3):
                trail[n + 1, m] = trail[n, m] + (1 if m == axis else 0)
            a, b, c = trail[n + 1, 0], trail[n + 1, 1], trail[n + 1, 2]
            if dead[a, b, c]:
                continue
            i, j, o = start[0] + sign[0] * a, start[1] + sign[1] * b, start[2] + sign[2] * c
            if sim.allowed[i, j, o]:
                free, narrow, wide = window_from(sim, low[n], high[n], i, j, o)
                if free:
                    low[n + 1], high[n + 1] = narrow, wide
                    advanced = True
                    break
            dead[a, b, c] = True
        if advanced:
            n += 1
        elif n == 0:
            return False
        else:
            dead[trail[n, 0], trail[n, 1], trail[n, 2]] = True
            n -= 1
    for k in range(1, length + 1):
        i, j, o = (start[0] + sign[0] * trail[k, 0], start[1] + sign[1] * trail[k, 1],
                   start[2] + sign[2] * trail[k, 2])  # fmt: skip
        step_to(sim, burr, i, j, o, low[k], high[k])
    return True


@inner
def find_way(sim, search, burr, goal):
    """Flood outwards from the burr through positions whose windows overlap, to the nearest goal.

    Parameters: `search` is (stamp int32, came int8, low float64, high float64, queue int32 arrays over
    voxels, and a one-element int32 array counting the floods); `goal` is an int64 array: ANY_TARGET
    (unmilled), ONE_VOXEL and the voxel, SLICE (unmilled target at one depth) and the depth, or
    WITHIN_SLICE and the depth, which does not leave the depth the burr is at.

    Returns the length of the way, its voxels last to first in the queue's end; -1 if there is none.
    """
    stamp, came, lows, highs, queue, floods = search
    floods[0] += 1
    mark = floods[0]
    n_depth, n_lateral = sim.solid.shape[1], sim.solid.shape[2]
    plane = n_depth * n_lateral
    here = (int(burr[0]) * n_depth + int(burr[1])) * n_lateral + int(burr[2])
    stamp[here], came[here] = mark, -1
    lows[here], highs[here] = burr[4], burr[5]
    queue[0] = here
    head, tail = 0, 1
    while head < tail:
        flat = queue[head]
        head += 1
        layer = flat // plane
        depth = (flat - layer * plane) // n_lateral
        lateral = flat - layer * plane - depth * n_lateral
        for look in range(12):
            # Goals first: next to the burr they are the rule, and each look costs a window.
            n = look % 6
            i, j, k = layer + NEIGHBOURS[n, 0], depth + NEIGHBOURS[n, 1], lateral + NEIGHBOURS[n, 2]
            if not sim.allowed[i, j, k] or (goal[0] == WITHIN_SLICE and j != depth):
                continue
            if goal[0] == ONE_VOXEL:
                found = i == goal[1] and j == goal[2] and k == goal[3]
            elif goal[0] != ANY_TARGET:
                found = sim.modified[i, j, k] != 0 and j == goal[1]
            else:
                found = sim.modified[i, j, k] != 0
            other = (i * n_depth + j) * n_lateral + k
            if found != (look < 6) or stamp[other] == mark:
                continue
            low, high = lows[flat], highs[flat]
            a, z = np.float64(sim.known[i, j, k, 0]), np.float64(sim.known[i, j, k, 1])
            free = z > a and z - a >= sim.min_window and min(z, high) - max(a, low) >= sim.min_overlap
            if not free:
                free, a, z = window_from(sim, low, high, i, j, k)
                if free:
                    remember(sim, i, j, k, a, z)
            if not free:
                continue
            stamp[other], came[other], lows[other], highs[other] = mark, n, a, z
            queue[tail] = other
            tail += 1
            if found:
                length = 0
                while other != here:
                    length += 1
                    queue[queue.size - length] = other
                    step = NEIGHBOURS[came[other]]
                    other -= (step[0] * n_depth + step[1]) * n_lateral + step[2]
                return length
    return -1


@inner
def go(sim, search, burr, goal):
    """Relocate to the nearest goal of `find_way`; False (and no move) if there is no way."""
    length = find_way(sim, search, burr, goal)
    if length < 0:
        return False
    _, _, lows, highs, queue, _ = search
    n_depth, n_lateral = sim.solid.shape[1], sim.solid.shape[2]
    plane = n_depth * n_lateral
    for n in range(length):
        flat = queue[queue.size - length + n]
        layer = flat // plane
        depth = (flat - layer * plane) // n_lateral
        step_to(sim, burr, layer, depth, flat - layer * plane - depth * n_lateral, lows[flat], highs[flat])
    return True
