"""Linear access to the cochlea: one straight hole through the facial recess, and what it may touch.

The method that the paper cites for statistically optimal trajectories (Baron, 4.1 and reference 32).
"""

from study.guidance.access._warm import warm
from study.guidance.access.accuracy import RequiredAccuracy, required_std, risk_curve, rms_across
from study.guidance.access.axes import LineErrors, drill_axes, to_drill_axes, to_image_axes, transforms
from study.guidance.access.collision import CollisionRisks, collision_probability
from study.guidance.access.models import (
    AnyRoll,
    DrawnErrors,
    FittedErrors,
    LineErrorModel,
    NormalErrors,
    printed_absolute,
    printed_lateral,
)
from study.guidance.access.planning import AccessPlan, plan_access
from study.guidance.access.settings import ACCEPTABLE_PROBABILITIES, AccessSettings
from study.guidance.access.structures import (
    Surroundings,
    oval_window,
    round_window_target,
    structure_points,
    surroundings,
)

__all__ = [
    "ACCEPTABLE_PROBABILITIES",
    "AccessPlan",
    "AccessSettings",
    "AnyRoll",
    "CollisionRisks",
    "DrawnErrors",
    "FittedErrors",
    "LineErrorModel",
    "LineErrors",
    "NormalErrors",
    "RequiredAccuracy",
    "Surroundings",
    "collision_probability",
    "drill_axes",
    "oval_window",
    "plan_access",
    "printed_absolute",
    "printed_lateral",
    "required_std",
    "risk_curve",
    "rms_across",
    "round_window_target",
    "structure_points",
    "surroundings",
    "to_drill_axes",
    "to_image_axes",
    "transforms",
    "warm",
]
