"""Compiled 3-D planner that stops on the way, so that its state can be looked at."""

from __future__ import annotations

import numpy as np

from study._compiled import kernel
from study.planners.motion._kernels import ANY_TARGET, go
from study.planners.simulation._kernels import LEFT, ROWS
from study.planners.strategies._kernels import begin, rank_candidates, take_step


@kernel
def run_until(sim, search, start, weights, terms, rows, arrivals):
    """Go through the decisions of `run_3d` until the path has `rows` rows; then rank the next candidates.

    `arrivals` is filled with the number of rows after each decision. Returns the burr's pose, the
    heading, the number of decisions, and the candidates with their scores.
    """
    burr = np.zeros(6)
    heading = np.zeros(2)
    most = (2 * sim.reach[0] + 3) * (2 * sim.reach[1] + 3) * (2 * sim.reach[2] + 3)
    candidates = np.empty((most, 3), np.int64)
    scores = np.empty(most)
    anything = np.array([ANY_TARGET, 0, 0, 0])
    begin(sim, burr, start)
    arrivals[0] = sim.counters[ROWS]
    steps = 1
    while sim.counters[LEFT] > 0 and sim.counters[ROWS] < rows and steps < arrivals.size:
        l0, b0 = burr[0], burr[2]
        n = rank_candidates(sim, burr, heading, weights, terms, candidates, scores)
        moved = False
        while n > 0:
            best = np.argmax(scores[:n])
            i, j, k = candidates[best]
            if take_step(sim, burr, i, j, k):
                moved = True
                break
            n -= 1
            candidates[best], scores[best] = candidates[n], scores[n]
        if not moved and not go(sim, search, burr, anything):
            break
        if burr[0] != l0 or burr[2] != b0:
            heading[0] = (burr[0] - l0) * sim.steps[0]
            heading[1] = (burr[2] - b0) * sim.steps[2]
        arrivals[steps] = sim.counters[ROWS]
        steps += 1
    n = rank_candidates(sim, burr, heading, weights, terms, candidates, scores)
    return burr, heading, steps, candidates[:n].copy(), scores[:n].copy()
