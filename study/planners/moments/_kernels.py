"""Compiled 3-D planner that stops on the way, so that its state can be looked at."""

from __future__ import annotations

import numpy as np

from study._compiled import kernel
from study.planners.fitness._kernels import rank_candidates
from study.planners.simulation.state._kernels import LEFT, ROWS
from study.planners.strategies._kernels import begin, candidate_arrays, decide


@kernel
def run_until(sim, search, start, weights, terms, rows, arrivals):
    """Go through the decisions of `run_3d` until the path has `rows` rows; then rank the next candidates.

    `arrivals` is filled with the number of rows after each decision. Returns the burr's pose, the
    heading, the number of decisions, and the candidates with their scores.
    """
    burr = np.zeros(7)
    heading = np.zeros(2)
    candidates, scores = candidate_arrays(sim)
    begin(sim, burr, start)
    arrivals[0] = sim.counters[ROWS]
    steps = 1
    while sim.counters[LEFT] > 0 and sim.counters[ROWS] < rows and steps < arrivals.size:
        if not decide(sim, search, burr, heading, weights, terms, candidates, scores):
            break
        arrivals[steps] = sim.counters[ROWS]
        steps += 1
    n = rank_candidates(sim, burr, heading, weights, terms, candidates, scores)
    return burr, heading, steps, candidates[:n].copy(), scores[:n].copy()
