"""Milling planners: modified and unmodified simulation, fitness, strategies, the `Plan`."""

from study.planners.fitness import FitnessTerm, fitness_score
from study.planners.modified import ModifiedVolume, modified_volume
from study.planners.passes import plan_passes
from study.planners.plan import Plan
from study.planners.planning import plan_path
from study.planners.settings import FitnessWeights, PlannerSettings

__all__ = [
    "FitnessTerm",
    "FitnessWeights",
    "ModifiedVolume",
    "Plan",
    "PlannerSettings",
    "fitness_score",
    "modified_volume",
    "plan_passes",
    "plan_path",
]
