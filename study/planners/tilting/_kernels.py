"""Compiled answers of a 4-DOF robot. The burr's window is a range of tilts, ``burr[5]`` to ``burr[6]``."""

from __future__ import annotations

from study._compiled import inner, kernel
from study.collision._kernels import accessible_window, pose_is_free, remove_from_slabs
from study.planners.simulation.state._kernels import NOTHING, record


@inner
def remove(sim, layer, depth, lateral):
    remove_from_slabs(sim.shaft, layer, depth, lateral)


@inner
def keep_up(sim):
    pass


@inner
def start_window(sim, layer, depth, lateral):
    limit = sim.shaft.max_tilt
    return accessible_window(sim.shaft, layer, depth, lateral, -limit, limit, sim.min_window, sim.min_overlap)


@inner
def window_from(sim, a, b, i, j, k, layer, depth, lateral):
    return accessible_window(sim.shaft, layer, depth, lateral, a, b, sim.min_window, sim.min_overlap)


@inner
def search_window(sim, a, b, i, j, k, layer, depth, lateral):
    # Bone only disappears: a window found before is still free, if perhaps wider by now.
    known = sim.known[layer, depth, lateral]
    if known[2] > 0.0:
        low, high = known[0], known[1]
        if high - low >= sim.min_window and min(high, b) - max(low, a) >= sim.min_overlap:
            return True, low, high
    free, low, high = window_from(sim, a, b, i, j, k, layer, depth, lateral)
    if free:
        known[0], known[1], known[2] = low, high, 1.0
    return free, low, high


@inner
def passing(sim, burr, a, b):
    low, high = max(burr[5], a), min(burr[6], b)
    if low <= burr[3] <= high:
        return burr[3], 0.0
    margin = min(0.0175, (high - low) / 4)  # not on the very edge: 1 degree, or a quarter of a narrow overlap
    return min(max(burr[3], low + margin), high - margin), 0.0


@inner
def turn(sim, burr, tilt, tip):
    if tilt != burr[3]:
        burr[3] = tilt
        record(sim, burr[0], burr[1], burr[2], tilt, 0.0, NOTHING)


@inner
def position_is_free(sim, layer, depth, lateral, tilt, tip):
    return pose_is_free(sim.shaft, layer, depth, lateral, tilt)


@inner
def window_around(sim, tilt, tip, layer, depth, lateral):
    free, low, high = accessible_window(sim.shaft, layer, depth, lateral, tilt - 1e-9, tilt + 1e-9, 0.0, 0.0)
    return free and low <= tilt <= high, low, high


@inner
def best_for_cut(sim, burr, a, b, layer, depth, lateral):
    return a, b


@kernel
def drop_inaccessible(shaft, narrow, modified, min_width):
    """Initial accessibility pass (2.3.1): drop targeted voxels that protected bone alone walls off.

    `narrow` is the same shaft with its tilt limited to half of `min_width`: a quick look straight out
    settles most voxels. Returns how many were dropped.
    """
    dropped = 0
    tilt, slight = shaft.max_tilt, narrow.max_tilt
    for i in range(modified.shape[0]):
        for j in range(modified.shape[1]):
            for k in range(modified.shape[2]):
                if modified[i, j, k] == 0:
                    continue
                if accessible_window(narrow, i, j, k, -slight, slight, min_width, min_width)[0]:
                    continue
                if not accessible_window(shaft, i, j, k, -tilt, tilt, min_width, min_width)[0]:
                    modified[i, j, k] = 0
                    dropped += 1
    return dropped


@kernel
def total_width(shaft, voxels):
    """Summed width in radians of the widest window of some voxels."""
    total = 0.0
    for n in range(voxels.shape[0]):
        free, low, high = accessible_window(
            shaft, voxels[n, 0], voxels[n, 1], voxels[n, 2], -shaft.max_tilt, shaft.max_tilt, 0.0, 0.0
        )
        if free:
            total += high - low
    return total
