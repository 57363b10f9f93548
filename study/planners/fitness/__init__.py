"""Terms of the fitness metric that a user adds to the five printed ones (Siebold, 2.3.5 and 2.5.3).

The five (direction, coverage, boundary, top half, upward) are small compiled functions in
``_kernels.py``, weighted by `study.planners.FitnessWeights`. What the text's future work asks for goes
into ``PlannerSettings.terms``::

    from study.planners import CuttingForce, IncidenceAngle, PlannerSettings, leave_for_last

    settings = PlannerSettings(
        terms=(
            CuttingForce(weight=10.0, density=density),
            IncidenceAngle(weight=5.0),
            leave_for_last(anatomy.mask("facial_nerve"), anatomy.spacing, weight=40.0),
        )
    )

A term of one's own is a field over the volume, optionally with a compiled score; see `FitnessTerm`. All
terms score from 0 (bad) to 1 (good). They are the 3-D planner's; the zigzag has no fitness.
"""

from study.planners.fitness.compiled import compile_terms, live_bone
from study.planners.fitness.live import CuttingForce, IncidenceAngle
from study.planners.fitness.structures import leave_for_last
from study.planners.fitness.terms import FitnessTerm, field_at_candidate, fitness_score

__all__ = [
    "CuttingForce",
    "FitnessTerm",
    "IncidenceAngle",
    "compile_terms",
    "field_at_candidate",
    "fitness_score",
    "leave_for_last",
    "live_bone",
]
