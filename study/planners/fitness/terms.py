"""A term of the fitness that looks at a fixed field over the volume."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numba as nb
import numpy as np

from study.planners.fitness._kernels import TERM
from study.volumes import LabelVolume


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
    """One more term of the fitness metric, which does not change while the bone is milled.

    For example a bias against moving towards small values of a field::

        @fitness_score
        def downhill(here, there, layer_mm, rise_mm, lateral_mm):
            return 1.0 if there < here else 0.0

        settings = PlannerSettings(terms=(FitnessTerm("downhill", 2.0, distance_mm, downhill),))

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
