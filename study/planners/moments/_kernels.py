"""Compiled look at what the 3-D planner has to choose from."""

from __future__ import annotations

from study._compiled import kernel
from study.planners.fitness._kernels import rank_candidates
from study.planners.strategies._kernels import candidate_arrays


@kernel
def ranked(sim, burr, heading, weights, terms):
    """The candidates of the next decision, (n, 3) voxels, and their scores (n,)."""
    candidates, scores = candidate_arrays(sim)
    n = rank_candidates(sim, burr, heading, weights, terms, candidates, scores)
    return candidates[:n].copy(), scores[:n].copy()
