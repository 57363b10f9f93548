"""Compiled answers of a 5-DOF robot. A window is one direction: tilt ``burr[5]``, tip ``burr[6]``."""

from __future__ import annotations

from math import acos, ceil, cos, hypot, sin, sqrt
from typing import NamedTuple

import numpy as np

from study._compiled import inlined, inner, kernel
from study._records import by_address
from study.collision.directions.field._kernels import (
    REMOVED,
    WITNESSED,
    FreeSpace,
    refresh,
    remove_voxel,
)
from study.collision.directions.search._kernels import next_free, search_from, window_of_directions
from study.collision.directions.single._kernels import NONE, angles, direction, shaft_is_free, turn_is_free
from study.planners.simulation.state._kernels import NOTHING, TARGET, record

TRIES = 12  # free directions of a voxel to which a turn is tried


@by_address
class Pointing(NamedTuple):
    """A 5-DOF robot over unmilled bone."""

    space: FreeSpace
    max_rotation: float  # radians between consecutive rows of the path
    published: bool  # look only at a small window of directions around the present one (2.3.3)
    offsets: np.ndarray  # float64 (n,) radians: the tilts and tips of that window
    least_free: int  # directions of the window that must be free
    cut_turn: float  # radians that the shaft may turn at once only to cut better
    least_gain: float  # of the sine of the incidence angle, for a turn that only serves the cut
    shut: np.ndarray  # int32 over voxels: where in `grounds` the witnesses against them stand; 0 if none
    grounds: np.ndarray  # int32: [0] the next place; then lists, each a length and so many flat indices


@inner
def remove(sim, layer, depth, lateral):
    remove_voxel(sim.shaft.space, layer, depth, lateral)


@inner
def keep_up(sim):
    if sim.shaft.space.counts[REMOVED] >= sim.shaft.space.patience:
        refresh(sim.shaft.space, 4.0, 6.0)


@inner
def _is_shut(sim, layer, depth, lateral):
    """Whether a voxel was found blocked from all directions of the search, and what blocks is still there."""
    space, grounds = sim.shaft.space, sim.shaft.grounds
    flat = (layer * space.solid.shape[1] + depth) * space.solid.shape[2] + lateral
    first = sim.shaft.shut[flat]
    if first == 0:
        return False
    solid = space.solid.ravel()
    for n in range(first + 1, first + 1 + grounds[first]):
        if solid[grounds[n]] == 0:
            sim.shaft.shut[flat] = 0
            return False
    return True


@inner
def _shut(sim, layer, depth, lateral):
    """Remember the witnesses of the search that has just failed, as long as there is room."""
    space, grounds = sim.shaft.space, sim.shaft.grounds
    n, first = space.counts[WITNESSED], grounds[0]
    if first + 1 + n > grounds.size:
        return
    grounds[first] = n
    for m in range(n):
        grounds[first + 1 + m] = space.witnesses[m]
    sim.shaft.shut[(layer * space.solid.shape[1] + depth) * space.solid.shape[2] + lateral] = first
    grounds[0] = first + 1 + n


@inner
def start_window(sim, layer, depth, lateral):
    space = sim.shaft.space
    hit = np.empty(3, np.int64)
    if _is_shut(sim, layer, depth, lateral):
        return False, 0.0, 0.0
    search_from(space, float(layer), float(depth), float(lateral), 0.0, -1.0, 0.0)
    m = next_free(space, float(layer), float(depth), float(lateral), hit)
    if m < 0:
        _shut(sim, layer, depth, lateral)
        return False, 0.0, 0.0
    v = space.directions[m]
    tilt, tip = angles(v[0], v[1], v[2])
    return True, tilt, tip


@inlined
def _can_turn(space, i, j, k, u, v, hit):
    return turn_is_free(space, float(i), float(j), float(k), u[0], u[1], u[2], v[0], v[1], v[2], hit)


@inner
def _any_direction(sim, a, b, i, j, k, layer, depth, lateral):
    """The present direction if it is free there, else the nearest free one that can be turned to here."""
    space = sim.shaft.space
    hit = np.empty(3, np.int64)
    u = direction(a, b)
    # The present direction may lie between those of the search: what shuts these need not shut it.
    if shaft_is_free(space, float(layer), float(depth), float(lateral), u[0], u[1], u[2], 0.0, NONE, hit):
        return True, a, b
    if _is_shut(sim, layer, depth, lateral):
        return False, 0.0, 0.0
    search_from(space, float(layer), float(depth), float(lateral), u[0], u[1], u[2])
    for tried in range(TRIES):
        m = next_free(space, float(layer), float(depth), float(lateral), hit)
        if m < 0:
            if tried == 0:
                _shut(sim, layer, depth, lateral)
            break
        v = (space.directions[m, 0], space.directions[m, 1], space.directions[m, 2])
        if _can_turn(space, i, j, k, u, v, hit):
            tilt, tip = angles(v[0], v[1], v[2])
            return True, tilt, tip
    return False, 0.0, 0.0


@inner
def _window_of_directions(sim, a, b, i, j, k, layer, depth, lateral):
    """The printed check: enough free directions around the present one; the one nearest to their middle."""
    space, offsets = sim.shaft.space, sim.shaft.offsets
    n = offsets.size
    tilts, tips = np.empty(n), np.empty(n)
    for m in range(n):
        tilts[m], tips[m] = a + offsets[m], b + offsets[m]
    free = np.empty((n, n), np.int8)
    window_of_directions(space, float(layer), float(depth), float(lateral), tilts, tips, free)
    least = cos(space.max_tilt) - 1e-12
    count, middle_tilt, middle_tip = 0, 0.0, 0.0
    for x in range(n):
        for y in range(n):
            if free[x, y] and cos(tilts[x]) * cos(tips[y]) < least:
                free[x, y] = 0  # outside the robot's cone
            if free[x, y]:
                count += 1
                middle_tilt += tilts[x]
                middle_tip += tips[y]
    if count < sim.shaft.least_free:
        return False, 0.0, 0.0
    middle_tilt, middle_tip = middle_tilt / count, middle_tip / count
    hit = np.empty(3, np.int64)
    u = direction(a, b)
    for _ in range(TRIES):
        best_x, best_y, best = -1, -1, 1e9
        for x in range(n):
            for y in range(n):
                if free[x, y]:
                    off = hypot(tilts[x] - middle_tilt, tips[y] - middle_tip)
                    if off < best - 1e-12:
                        best_x, best_y, best = x, y, off
        if best_x < 0:
            break
        if _can_turn(space, i, j, k, u, direction(tilts[best_x], tips[best_y]), hit):
            return True, tilts[best_x], tips[best_y]
        free[best_x, best_y] = 0
    return False, 0.0, 0.0


@inner
def window_from(sim, a, b, i, j, k, layer, depth, lateral):
    if sim.shaft.published:
        return _window_of_directions(sim, a, b, i, j, k, layer, depth, lateral)
    return _any_direction(sim, a, b, i, j, k, layer, depth, lateral)


@inner
def search_window(sim, a, b, i, j, k, layer, depth, lateral):
    # Bone only disappears: a direction found free before still is.
    space = sim.shaft.space
    known = sim.known[layer, depth, lateral]
    if known[2] > 0.0:
        if known[0] == a and known[1] == b:
            return True, a, b
        hit = np.empty(3, np.int64)
        u, v = direction(a, b), direction(known[0], known[1])
        if not sim.shaft.published:
            # Keeping the direction beats turning to the known one, and turning there a search.
            if shaft_is_free(
                space, float(layer), float(depth), float(lateral), u[0], u[1], u[2], 0.0, NONE, hit
            ):
                known[0], known[1] = a, b
                return True, a, b
            if _can_turn(space, i, j, k, u, v, hit):
                return True, known[0], known[1]
        elif hypot(known[0] - a, known[1] - b) <= sim.shaft.offsets[-1] and _can_turn(
            space, i, j, k, u, v, hit
        ):
            return True, known[0], known[1]
    free, tilt, tip = window_from(sim, a, b, i, j, k, layer, depth, lateral)
    if free:
        known[0], known[1], known[2] = tilt, tip, 1.0
    return free, tilt, tip


@inner
def passing(sim, burr, a, b):
    return a, b


@inner
def turn(sim, burr, tilt, tip):
    if tilt == burr[3] and tip == burr[4]:
        return
    u, v = direction(burr[3], burr[4]), direction(tilt, tip)
    angle = acos(min(1.0, max(-1.0, u[0] * v[0] + u[1] * v[1] + u[2] * v[2])))
    parts = max(1, int(ceil(angle / sim.shaft.max_rotation - 1e-9)))
    for part in range(1, parts):
        p, q = sin((1.0 - part / parts) * angle) / sin(angle), sin(part / parts * angle) / sin(angle)
        a, b = angles(p * u[0] + q * v[0], p * u[1] + q * v[1], p * u[2] + q * v[2])
        record(sim, burr[0], burr[1], burr[2], a, b, NOTHING)
    record(sim, burr[0], burr[1], burr[2], tilt, tip, NOTHING)
    burr[3], burr[4] = tilt, tip


@inner
def position_is_free(sim, layer, depth, lateral, tilt, tip):
    u = direction(tilt, tip)
    hit = np.empty(3, np.int64)
    return shaft_is_free(
        sim.shaft.space, float(layer), float(depth), float(lateral), u[0], u[1], u[2], 0.0, NONE, hit
    )


@inner
def window_around(sim, tilt, tip, layer, depth, lateral):
    return position_is_free(sim, float(layer), float(depth), float(lateral), tilt, tip), tilt, tip


@inner
def _engaged_bone(sim, layer, depth, lateral):
    """Unit vector from the burr's centre to the middle of the bone it will cut at a voxel; zeros if none."""
    x, y, z = 0, 0, 0
    for n in range(sim.element.shape[0]):
        i, j, k = sim.element[n, 0], sim.element[n, 1], sim.element[n, 2]
        if sim.solid[layer + i, depth + j, lateral + k] == TARGET:
            x, y, z = x + i, y + j, z + k
    p, q, r = x * sim.steps[0], y * sim.steps[1], z * sim.steps[2]
    length = sqrt(p * p + q * q + r * r)
    if length == 0.0:
        return 0.0, 0.0, 0.0
    return p / length, q / length, r / length


@inner
def incidence(bone, u):
    """Sine of the angle between the shaft and the bone ahead: 1 cuts with the equator, 0 with the pole."""
    along = bone[0] * u[0] + bone[1] * u[1] + bone[2] * u[2]
    return sqrt(max(0.0, 1.0 - along * along))


@inner
def best_for_cut(sim, burr, a, b, layer, depth, lateral):
    # Where the shaft has to turn anyway, the nearest free direction is taken as it is.
    if sim.shaft.published or a != burr[3] or b != burr[4]:
        return a, b
    space = sim.shaft.space
    bone = _engaged_bone(sim, layer, depth, lateral)
    if bone[0] == 0.0 and bone[1] == 0.0 and bone[2] == 0.0:
        return a, b
    u = direction(a, b)
    here = incidence(bone, u)
    # The way to a better angle is straight away from the bone, in the plane of bone and shaft.
    along = bone[0] * u[0] + bone[1] * u[1] + bone[2] * u[2]
    if 1.0 - here < sim.shaft.least_gain:
        return a, b
    side = -1.0 if along > 0.0 else 1.0
    w0, w1, w2 = (
        side * (bone[0] - along * u[0]),
        side * (bone[1] - along * u[1]),
        side * (bone[2] - along * u[2]),
    )
    length = sqrt(w0 * w0 + w1 * w1 + w2 * w2)
    if length < 1e-9:
        return a, b
    i, j, k = int(burr[0]), int(burr[1]), int(burr[2])
    hit = np.empty(3, np.int64)
    least = cos(space.max_tilt)
    # To the best angle of all that is in sight, or half or a quarter of the way.
    whole = min(sim.shaft.cut_turn, acos(min(1.0, here)))
    for share in (1.0, 0.5, 0.25):
        angle = share * whole
        c, s = cos(angle), sin(angle) / length
        v = (c * u[0] + s * w0, c * u[1] + s * w1, c * u[2] + s * w2)
        if -v[1] < least or incidence(bone, v) < here + sim.shaft.least_gain:
            continue
        if shaft_is_free(
            space, float(layer), float(depth), float(lateral), v[0], v[1], v[2], 0.0, NONE, hit
        ) and _can_turn(space, i, j, k, u, v, hit):
            tilt, tip = angles(v[0], v[1], v[2])
            return tilt, tip
    return a, b


@kernel
def drop_inaccessible(space, modified):
    """Initial accessibility pass (2.3.1): drop targeted voxels that protected bone alone walls off.

    Neighbours are mostly free from the same direction: it is tried first. Returns how many were dropped.
    """
    dropped = 0
    hit = np.empty(3, np.int64)
    last = 0
    for i in range(modified.shape[0]):
        for j in range(modified.shape[1]):
            for k in range(modified.shape[2]):
                if modified[i, j, k] == 0:
                    continue
                d = space.directions[last]
                if shaft_is_free(space, float(i), float(j), float(k), d[0], d[1], d[2], 0.0, NONE, hit):
                    continue
                search_from(space, float(i), float(j), float(k), 0.0, -1.0, 0.0)
                m = next_free(space, float(i), float(j), float(k), hit)
                if m < 0:
                    modified[i, j, k] = 0
                    dropped += 1
                else:
                    last = m
    return dropped
