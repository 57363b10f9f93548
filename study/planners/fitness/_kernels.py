"""Compiled fitness of the 3-D planner's candidates (Siebold, 2.3.2, 2.3.5, 2.4.1); terms are from 0 to 1."""

from __future__ import annotations

from math import hypot, sqrt

import numba as nb

from study._compiled import inner
from study.collision.directions.single._kernels import direction
from study.planners.pointing._kernels import incidence
from study.planners.simulation.state._kernels import BOUNDARY

TERM = nb.types.float64(
    nb.types.float64, nb.types.float64, nb.types.float64, nb.types.float64, nb.types.float64
)


# --- the five terms of the fitness (2.4.1), each between 0 and 1 -------------------------------------


@inner
def keep_direction(heading_layer, heading_lateral, move_layer, move_lateral):
    """(1) Preserve the current planar direction of movement: (1 + cosine) / 2; 1/2 without a direction."""
    length = hypot(heading_layer, heading_lateral) * hypot(move_layer, move_lateral)
    if length == 0.0:
        return 0.5
    return 0.5 + 0.5 * (heading_layer * move_layer + heading_lateral * move_lateral) / length


@inner
def coverage(covered, supervoxel_size):
    """(2) Cover as many voxels as possible: share of the supervoxel that the step would clear."""
    return covered / supervoxel_size


@inner
def on_boundary(label):
    """(3) Put the supervoxel's centre on a target boundary voxel."""
    return 1.0 if label == BOUNDARY else 0.0


@inner
def spare_top_half(targeted, top_half_size):
    """(4) Little targeted bone in the outer half of the burr, which cuts badly."""
    return 1.0 - targeted / top_half_size


@inner
def upward(rise, largest_rise):
    """(5) Bias towards moving outwards."""
    return 0.5 + 0.5 * rise / largest_rise


# --- terms that follow the milling (2.5.3), each between 0 and 1 --------------------------------------


@inner
def spare_force(engaged, half_size):
    """Little bone to cut, and soft: 1 less the density-weighted voxels over half of the burr's."""
    return max(0.0, 1.0 - engaged / half_size)


@inner
def cut_with_equator(sim, shaft, layer, depth, lateral, by_bone, half_size):
    """The sine of the angle between the shaft and the bone about to be cut; 1 where there is none.

    `by_bone`: times the share of half of the burr's voxels that is bone; 0 where there is none.
    """
    ahead = sim.live.ahead
    n = ahead[0, layer, depth, lateral]
    if n == 0:
        return 0.0 if by_bone else 1.0
    x = (ahead[1, layer, depth, lateral] / n - layer) * sim.steps[0]
    y = (ahead[2, layer, depth, lateral] / n - depth) * sim.steps[1]
    z = (ahead[3, layer, depth, lateral] / n - lateral) * sim.steps[2]
    length = sqrt(x * x + y * y + z * z)
    sine = incidence((x / length, y / length, z / length), shaft) if length > 1e-9 else 1.0
    return sine * min(1.0, n / half_size) if by_bone else sine


# --- all of them ----------------------------------------------------------------------------------------


@inner
def rank_candidates(sim, burr, heading, weights, terms, candidates, scores):
    """Candidate next positions within and next to the supervoxel (2.3.2), and their fitness (2.3.5).

    `terms` is the user's own: (number, weights and fields of the fixed ones; weight of the force; weight
    of the incidence and whether by bone; four compiled functions). Returns the number of candidates.
    """
    l0, d0, b0 = int(burr[0]), int(burr[1]), int(burr[2])
    size = (2 * sim.reach[0] + 1) * (2 * sim.reach[1] + 1) * (2 * sim.reach[2] + 1)
    top_size = 0
    for r in range(sim.top_rows.shape[0]):
        top_size += 2 * sim.top_rows[r, 2] + 1
    largest_rise = (sim.reach[1] + 1) * sim.steps[1]
    n_terms, term_weights, fields, force_weight, incidence_weight, by_bone, f0, f1, f2, f3 = terms
    shaft = direction(burr[3], burr[4])
    half_size = 0.0
    for r in range(sim.live.rows.shape[0]):
        half_size += sim.live.rows[r, 2] + 0.5
    n = 0
    for i in range(l0 - sim.reach[0] - 1, l0 + sim.reach[0] + 2):
        for j in range(d0 - sim.reach[1] - 1, d0 + sim.reach[1] + 2):
            for k in range(b0 - sim.reach[2] - 1, b0 + sim.reach[2] + 2):
                label = sim.modified[i, j, k]
                if label == 0:
                    continue
                move_layer = (i - l0) * sim.steps[0]
                rise = (d0 - j) * sim.steps[1]
                move_lateral = (k - b0) * sim.steps[2]
                covered = sim.covers[i, j, k] + (1 if label == BOUNDARY else 0)
                score = (
                    weights[0] * keep_direction(heading[0], heading[1], move_layer, move_lateral)
                    + weights[1] * coverage(covered, size)
                    + weights[2] * on_boundary(label)
                    + weights[3] * spare_top_half(sim.top[i, j, k], top_size)
                    + weights[4] * upward(rise, largest_rise)
                )
                if force_weight != 0.0:
                    score += force_weight * spare_force(0.001 * sim.live.load[i, j, k], half_size)
                if incidence_weight != 0.0:
                    score += incidence_weight * cut_with_equator(sim, shaft, i, j, k, by_bone, half_size)
                for t in range(n_terms):
                    here, there = fields[t, l0, d0, b0], fields[t, i, j, k]
                    if t == 0:
                        value = f0(here, there, move_layer, rise, move_lateral)
                    elif t == 1:
                        value = f1(here, there, move_layer, rise, move_lateral)
                    elif t == 2:
                        value = f2(here, there, move_layer, rise, move_lateral)
                    else:
                        value = f3(here, there, move_layer, rise, move_lateral)
                    score += term_weights[t] * value
                candidates[n, 0], candidates[n, 1], candidates[n, 2] = i, j, k
                scores[n] = score
                n += 1
    return n
