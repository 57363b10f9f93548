"""The two industrial arms of the guided robot: kinematics as drawn and as built (Baron, 3.1)."""

from study.robots.arms.arm import SixAxisArm, arm, differential_gain
from study.robots.arms.errors import ArmErrors
from study.robots.arms.inverse import follow
from study.robots.arms.table import ArmData, arm_data, arm_names, arm_table

__all__ = [
    "ArmData",
    "ArmErrors",
    "SixAxisArm",
    "arm",
    "arm_data",
    "arm_names",
    "arm_table",
    "differential_gain",
    "follow",
]
