"""Compiled strategies: the 3-D planner (Siebold, 2.3) and the 2.5-D zigzag (2.4.1)."""

from __future__ import annotations

import numpy as np

from study._compiled import inlined, inner, kernel
from study.planners.fitness._kernels import rank_candidates
from study.planners.freedom._kernels import (
    best_for_cut,
    passing,
    start_window,
    turn,
    window_around,
    window_from,
)
from study.planners.motion._kernels import (
    ANYTHING,
    ONE_VOXEL,
    SLICE,
    WITHIN_SLICE,
    arrive,
    direct_step,
    find_way,
    go,
    short_path,
    step_to,
)
from study.planners.simulation._kernels import mill_ball
from study.planners.simulation.state._kernels import BOUNDARY, FULL, LEFT, NOTHING, ROWS, record

FIRST_ROW = np.int64(0)  # not a plain number, which numba would compile `_walk_back` once more for

# --- 3-D ------------------------------------------------------------------------------------------------


@inlined
def take_step(sim, burr, layer, depth, lateral):
    """Move to a candidate if it is accessible: straight, or by a short path where it is crowded (2.3)."""
    i, j, k = int(burr[0]), int(burr[1]), int(burr[2])
    free, a, b = window_from(sim, burr[5], burr[6], i, j, k, layer, depth, lateral)
    if not free:
        return False
    if not sim.crowded[i, j, k]:
        a, b = best_for_cut(sim, burr, a, b, layer, depth, lateral)
        if direct_step(sim, burr, layer, depth, lateral, a, b):
            return True
    return short_path(sim, burr, layer, depth, lateral)


@kernel
def can_start(sim, layer, depth, lateral):
    """Whether a voxel can be reached out of the air."""
    return start_window(sim, layer, depth, lateral)[0]


@inlined
def begin(sim, burr, start):
    """Stand at the start voxel; False if it is not accessible."""
    free, a, b = start_window(sim, start[0], start[1], start[2])
    if not free:
        return False
    burr[3], burr[4], burr[5], burr[6] = 0.0, 0.0, a, b
    burr[3], burr[4] = passing(sim, burr, a, b)
    removed = mill_ball(sim, start[0], start[1], start[2])
    record(sim, float(start[0]), float(start[1]), float(start[2]), burr[3], burr[4], removed)
    arrive(sim, burr, start[0], start[1], start[2], a, b)
    return True


@inner
def _walk_back(sim, burr, rows, to):
    """Retrace the first `rows` rows of the path to row `to`; what was free on the way in still is."""
    for row in range(rows - 1, to - 1, -1):
        here = sim.path[row]
        if here[0] == burr[0] and here[1] == burr[1] and here[2] == burr[2]:
            turn(sim, burr, here[3], here[4])
        else:
            record(sim, here[0], here[1], here[2], burr[3], burr[4], NOTHING)
            burr[0], burr[1], burr[2] = here[0], here[1], here[2]
            turn(sim, burr, here[3], here[4])


@inlined
def _stand_at(sim, row, pose):
    """Fill `pose` with a row of the path and the window around its tilt; False between voxels."""
    for n in range(5):
        pose[n] = sim.path[row, n]
    i, j, k = int(pose[0]), int(pose[1]), int(pose[2])
    if i != pose[0] or j != pose[1] or k != pose[2]:
        return False
    free, pose[5], pose[6] = window_around(sim, pose[3], pose[4], i, j, k)
    return free


@inner
def relocate(sim, search, burr, goal):
    """Go to the nearest goal; where the burr has trapped itself, back out first.

    A straight step can end where no single step leads on. Then the path is walked back to the first
    of the poses 1, 2, 4, ... rows ago, or the very first, from which a way leads on. False if none does.
    """
    if go(sim, search, burr, goal):
        return True
    rows = sim.counters[ROWS]
    pose = np.empty(7)
    back = 1
    while True:
        row = max(0, rows - 1 - back)
        while row > 0 and not _stand_at(sim, row, pose):
            row -= 1
        if _stand_at(sim, row, pose) and find_way(sim, search, pose, goal) >= 0:
            _walk_back(sim, burr, rows, row)
            for n in range(7):
                burr[n] = pose[n]
            return go(sim, search, burr, goal)
        if row == 0:
            return False
        back *= 2


@inlined
def return_home(sim, search, burr, start):
    """The way back to the start voxel (2.3.7); the way it came, reversed, if the search finds none."""
    if burr[0] == start[0] and burr[1] == start[1] and burr[2] == start[2]:
        return
    if go(sim, search, burr, (ONE_VOXEL, start[0], start[1], start[2])):
        return
    _walk_back(sim, burr, sim.counters[ROWS], FIRST_ROW)


@inner
def candidate_arrays(sim):
    """Room for the candidates of `rank_candidates` and their scores."""
    most = (2 * sim.reach[0] + 3) * (2 * sim.reach[1] + 3) * (2 * sim.reach[2] + 3)
    return np.empty((most, 3), np.int64), np.empty(most)


@inlined
def decide(sim, search, burr, heading, weights, terms, candidates, scores):
    """One decision: the best accessible candidate, or a relocation; False when nothing is left to reach."""
    l0, b0 = burr[0], burr[2]
    n = rank_candidates(sim, burr, heading, weights, terms, candidates, scores)
    moved = False
    while n > 0:
        # The best is nearly always accessible: look it up lazily instead of sorting.
        best = np.argmax(scores[:n])
        i, j, k = candidates[best]
        if take_step(sim, burr, i, j, k):
            moved = True
            break
        n -= 1
        candidates[best], scores[best] = candidates[n], scores[n]
    if not moved and not relocate(sim, search, burr, ANYTHING):
        return False
    if burr[0] != l0 or burr[2] != b0:
        heading[0] = (burr[0] - l0) * sim.steps[0]
        heading[1] = (burr[2] - b0) * sim.steps[2]
    return True


@kernel
def run_3d(sim, search, start, weights, terms, until):
    """Mill by fitness until no target voxel can be reached, then go home.

    Or, where `until` is not 0, stop at the first decision after which the path has so many rows. Returns
    the burr's pose and the heading.
    """
    burr, heading = np.zeros(7), np.zeros(2)
    if not begin(sim, burr, start):
        return burr, heading
    candidates, scores = candidate_arrays(sim)
    while sim.counters[LEFT] > 0 and sim.counters[FULL] == 0:
        if until > 0 and sim.counters[ROWS] >= until:
            break
        if not decide(sim, search, burr, heading, weights, terms, candidates, scores):
            break
    if until == 0:
        return_home(sim, search, burr, start)
    return burr, heading


# --- 2.5-D zigzag ---------------------------------------------------------------------------------------


@inner
def _row_voxel(row_axis, row, depth, along):
    # Rows run along `row_axis` (0 layers, 2 laterals) and lie side by side along the other one.
    if row_axis == 2:
        return row, depth, along
    return along, depth, row


@inner
def _adjacent(burr, i, j, k):
    return abs(burr[0] - i) + abs(burr[1] - j) + abs(burr[2] - k) == 1


@inlined
def _visit(sim, search, burr, i, j, k):
    """Step to a neighbouring voxel, or go to it the long way round."""
    if burr[0] == i and burr[1] == j and burr[2] == k:
        return True
    if _adjacent(burr, i, j, k):
        free, a, b = window_from(sim, burr[5], burr[6], int(burr[0]), int(burr[1]), int(burr[2]), i, j, k)
        if free:
            step_to(sim, burr, i, j, k, a, b)
            return True
    return go(sim, search, burr, (ONE_VOXEL, i, j, k))


@inner
def _has_work(sim, i, j, k):
    """Whether standing here would clear anything."""
    return sim.modified[i, j, k] == BOUNDARY or sim.covers[i, j, k] > 0


@inner
def _zigzag_layer(sim, search, burr, targeted, depth, row_axis, row_pitch):
    """Parallel rows over one layer, there and back, from the side nearer to the burr."""
    n_rows = targeted.shape[0] if row_axis == 2 else targeted.shape[2]
    n_along = targeted.shape[2] if row_axis == 2 else targeted.shape[0]
    first_row, last_row = n_rows, -1
    for row in range(n_rows):
        for along in range(n_along):
            i, j, k = _row_voxel(row_axis, row, depth, along)
            if targeted[i, j, k]:
                first_row, last_row = min(first_row, row), max(last_row, row)
                break
    if last_row < 0:
        return
    # The rows stand as a comb in the middle of the layer's extent.
    n_pitches = (last_row - first_row) // row_pitch
    offset = first_row + (last_row - first_row - n_pitches * row_pitch) // 2
    here_row = burr[0] if row_axis == 2 else burr[2]
    upwards = abs(here_row - first_row) <= abs(here_row - last_row)
    along_now = burr[2] if row_axis == 2 else burr[0]
    for r in range(n_pitches + 1):
        row = offset + (r if upwards else n_pitches - r) * row_pitch
        low, high = n_along, -1
        for along in range(n_along):
            i, j, k = _row_voxel(row_axis, row, depth, along)
            if targeted[i, j, k] and _has_work(sim, i, j, k):
                low, high = min(low, along), max(high, along)
        if high < 0:
            continue
        forwards = abs(along_now - low) <= abs(along_now - high)
        for m in range(high - low + 1):
            along = low + m if forwards else high - m
            i, j, k = _row_voxel(row_axis, row, depth, along)
            # Along a row the burr goes straight on; it leaves out what it cannot reach, and detours
            # past gaps only to where something is left to clear.
            if targeted[i, j, k] and (_adjacent(burr, i, j, k) or _has_work(sim, i, j, k)):
                _visit(sim, search, burr, i, j, k)
        along_now = burr[2] if row_axis == 2 else burr[0]


@kernel
def run_zigzag(sim, search, start, targeted, row_axis, row_pitch, layer_pitch):
    """Layer by layer: rows, then a circuit around what is left at each slice's rim; pockets last."""
    burr = np.zeros(7)
    if not begin(sim, burr, start):
        return False
    n_depth = targeted.shape[1]
    first, last = n_depth, -1
    for d in range(n_depth):
        if sim.left_at_depth[d] > 0:
            first, last = min(first, d), max(last, d)
    top = first
    while top <= last and sim.counters[FULL] == 0:
        depth = min(top + layer_pitch // 2, last)
        _zigzag_layer(sim, search, burr, targeted, depth, row_axis, row_pitch)
        for d in range(top, min(top + layer_pitch, last + 1)):
            circuit = (WITHIN_SLICE, d, NOTHING, NOTHING)
            rim = (SLICE, d, NOTHING, NOTHING)
            while sim.counters[FULL] == 0 and sim.left_at_depth[d] > 0:
                if burr[1] == d and go(sim, search, burr, circuit):
                    continue
                if not go(sim, search, burr, rim):
                    break
        top += layer_pitch
    while sim.counters[LEFT] > 0 and sim.counters[FULL] == 0:
        if not relocate(sim, search, burr, ANYTHING):
            break
    return_home(sim, search, burr, start)
    return True
