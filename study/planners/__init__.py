"""Milling planners: modified and unmodified simulation, fitness, strategies, the `Plan`."""

from study.planners.fitness import (
    CuttingForce,
    FitnessTerm,
    IncidenceAngle,
    fitness_score,
    leave_for_last,
)
from study.planners.modified import ModifiedVolume, modified_volume
from study.planners.passes import plan_passes
from study.planners.plan import Plan
from study.planners.planning import plan_path
from study.planners.settings import FitnessWeights, PlannerSettings

__all__ = [
    "CuttingForce",
    "FitnessTerm",
    "FitnessWeights",
    "IncidenceAngle",
    "ModifiedVolume",
    "Plan",
    "PlannerSettings",
    "fitness_score",
    "leave_for_last",
    "modified_volume",
    "plan_passes",
    "plan_path",
]
