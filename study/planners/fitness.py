"""Terms of the fitness metric that a user adds to the five printed ones (Siebold, 2.3.5).

The five (direction, coverage, boundary, top half, upward) are small compiled functions in
``strategies/_kernels.py``, weighted by `study.planners.FitnessWeights`. A further term is a field over
the volume, optionally with a compiled score of its own::

    from study.planners import FitnessTerm, PlannerSettings, fitness_score

    @fitness_score
    def downhill(here, there, layer_mm, rise_mm, lateral_mm):
        return 1.0 if there < here else 0.0

    settings = PlannerSettings(terms=(FitnessTerm("downhill", 2.0, distance_mm, downhill),))
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numba as nb
import numpy as np

from study.collision import CanonicalFrame
from study.errors import InputError
from study.planners.strategies._kernels import TERM
from study.volumes import LabelVolume

MOST_TERMS = 4


def fitness_score(function: Callable[[float, float, float, float, float], float]) -> Any:
    """Compile ``score(here, there, layer_mm, rise_mm, lateral_mm)`` for the planner.

    `here` and `there` are the term's field at the burr and at the candidate; the rest is the step to
    the candidate along the rotation axis, outwards and sideways, in mm. The score should lie between
    0 (bad) and 1 (good), like the printed terms.
    """
    return nb.cfunc(TERM)(function)


@fitness_score
def field_at_candidate(here, there, layer_mm, rise_mm, lateral_mm):
    """The default score: the field itself at the candidate."""
    return there


@dataclass(frozen=True, eq=False)
class FitnessTerm:
    """One more term of the fitness metric.

    Parameters
    ----------
    name : str
    weight : float
        Relative to the printed 1, 1, 10, 5, 1.
    field : (nx, ny, nz) array, or function of the volume that returns one
        What the score looks at, voxel by voxel.
    score : compiled function, optional
        From `fitness_score`; the field's value at the candidate by default.
    """

    name: str
    weight: float
    field: np.ndarray | Callable[[LabelVolume], np.ndarray]
    score: Any = field_at_candidate


def compile_terms(terms: tuple[FitnessTerm, ...], volume: LabelVolume, frame: CanonicalFrame) -> tuple:
    """What `rank_candidates` takes: number, weights, canonical fields, four compiled scores.

    Raises
    ------
    InputError
        If there are more than four terms, or a field has another shape than the volume or is not finite.
    """
    if len(terms) > MOST_TERMS:
        raise InputError(f"terms: expected at most {MOST_TERMS}, got {len(terms)}")
    fields = []
    for term in terms:
        field = term.field(volume) if callable(term.field) else term.field
        field = np.asarray(field, dtype=np.float32)
        if field.shape != volume.shape or not np.isfinite(field).all():
            raise InputError(
                f"term {term.name!r}: expected a finite field of shape {volume.shape}, got {field.shape}"
            )
        fields.append(frame.canonical(field))
    stacked = np.stack(fields) if fields else np.zeros((0, 1, 1, 1), np.float32)
    weights = np.array([term.weight for term in terms], dtype=float)
    scores = [term.score for term in terms] + [field_at_candidate] * (MOST_TERMS - len(terms))
    return (len(terms), weights, stacked, *scores)
