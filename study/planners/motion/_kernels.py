"""Compiled motion of the burr: turning, stepping, the simple objective planner, relocation, the way home.

The burr's pose is a float64 array: layer, depth, lateral, tilt, tip, and its window; what a window is
the robot's freedom says (`study.planners.freedom`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from study._compiled import inner
from study._records import by_address
from study.planners.freedom._kernels import (
    keep_up,
    passing,
    position_is_free,
    search_window,
    turn,
    window_from,
)
from study.planners.simulation._kernels import clear_supervoxel, mill_ball, mill_sweep, sweep_is_safe
from study.planners.simulation.state._kernels import NOTHING, draw, record

NEIGHBOURS = np.array([[0, -1, 0], [-1, 0, 0], [1, 0, 0], [0, 0, -1], [0, 0, 1], [0, 1, 0]], dtype=np.int64)
# What a search looks for. A goal is four whole numbers; of numpy's type, as numba would compile a
# function once more for every plain one.
ANY_TARGET, ONE_VOXEL, SLICE, WITHIN_SLICE = np.int64(0), np.int64(1), np.int64(2), np.int64(3)
ANYTHING = (ANY_TARGET, NOTHING, NOTHING, NOTHING)


@by_address
class Search(NamedTuple):
    """Scratch of `find_way`, over the flat indices of all voxels."""

    stamp: np.ndarray  # int32: the last flood that came here
    came: np.ndarray  # int8: by which of the NEIGHBOURS
    low: np.ndarray  # float64: its window
    high: np.ndarray
    queue: np.ndarray  # int32
    floods: np.ndarray  # int32 (1,): how many there were


@inner
def arrive(sim, burr, layer, depth, lateral, a, b):
    """Book-keeping at a voxel the burr has just reached with the window (a, b)."""
    clear_supervoxel(sim, layer, depth, lateral)
    burr[0], burr[1], burr[2], burr[5], burr[6] = layer, depth, lateral, a, b
    known = sim.known[layer, depth, lateral]
    known[0], known[1], known[2] = a, b, 1.0
    keep_up(sim)


@inner
def step_to(sim, burr, layer, depth, lateral, a, b):
    """Move to a voxel that shares a face with the present one."""
    tilt, tip = passing(sim, burr, a, b)
    turn(sim, burr, tilt, tip)
    removed = mill_ball(sim, layer, depth, lateral)
    record(sim, float(layer), float(depth), float(lateral), burr[3], burr[4], removed)
    arrive(sim, burr, layer, depth, lateral, a, b)


@inner
def direct_step(sim, burr, layer, depth, lateral, a, b):
    """Move straight to a voxel up to reach + 1 away, checking every part on the way; False if barred."""
    l0, d0, b0 = int(burr[0]), int(burr[1]), int(burr[2])
    move = (layer - l0, depth - d0, lateral - b0)
    parts = max(abs(move[0]), abs(move[1]), abs(move[2]))
    tilt, tip = passing(sim, burr, a, b)
    if not sweep_is_safe(sim, l0, d0, b0, move):
        return False
    for part in range(1, parts):
        f = part / parts
        if not position_is_free(sim, l0 + f * move[0], d0 + f * move[1], b0 + f * move[2], tilt, tip):
            return False
    turn(sim, burr, tilt, tip)
    for part in range(1, parts + 1):
        f = part / parts
        removed = mill_sweep(sim, l0, d0, b0, move, part)
        record(sim, l0 + f * move[0], d0 + f * move[1], b0 + f * move[2], burr[3], burr[4], removed)
    arrive(sim, burr, layer, depth, lateral, a, b)
    return True


@inner
def _on_trail(start, sign, steps):
    return start[0] + sign[0] * steps[0], start[1] + sign[1] * steps[1], start[2] + sign[2] * steps[2]


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
    low[0], high[0] = burr[5], burr[6]
    n = 0
    order = np.empty(3, np.int64)
    for axis in range(3):
        order[axis] = axis
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
                u, v, w = _on_trail(start, sign, trail[n])
                free, narrow, wide = window_from(sim, low[n], high[n], u, v, w, i, j, o)
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
        i, j, o = _on_trail(start, sign, trail[k])
        step_to(sim, burr, i, j, o, low[k], high[k])
    return True


@inner
def find_way(sim, search, burr, goal):
    """Flood outwards from the burr through positions whose windows overlap, to the nearest goal.

    `goal` is four whole numbers: ANY_TARGET (unmilled), ONE_VOXEL and the voxel, SLICE (unmilled target
    at one depth) and the depth, or WITHIN_SLICE and the depth, which does not leave the depth the burr is at.

    Returns the length of the way, its voxels last to first in the queue's end; -1 if there is none.
    """
    stamp, came, queue, lows, highs = search.stamp, search.came, search.queue, search.low, search.high
    search.floods[0] += 1
    mark = search.floods[0]
    n_depth, n_lateral = sim.solid.shape[1], sim.solid.shape[2]
    plane = n_depth * n_lateral
    here = (int(burr[0]) * n_depth + int(burr[1])) * n_lateral + int(burr[2])
    stamp[here], came[here] = mark, -1
    lows[here], highs[here] = burr[5], burr[6]
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
            free, a, z = search_window(sim, lows[flat], highs[flat], layer, depth, lateral, i, j, k)
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
    lows, highs, queue = search.low, search.high, search.queue
    n_depth, n_lateral = sim.solid.shape[1], sim.solid.shape[2]
    plane = n_depth * n_lateral
    for n in range(length):
        flat = queue[queue.size - length + n]
        layer = flat // plane
        depth = (flat - layer * plane) // n_lateral
        step_to(sim, burr, layer, depth, flat - layer * plane - depth * n_lateral, lows[flat], highs[flat])
    return True
