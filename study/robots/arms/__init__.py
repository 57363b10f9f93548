"""Six-axis arms: the two industrial ones of the guided robot, as drawn and as built (Baron, 3.1); the UR5."""

from study.robots.arms.arm import SixAxisArm, arm, differential_gain
from study.robots.arms.chain import ChainArm, ChainData, guided_arm
from study.robots.arms.errors import ArmErrors
from study.robots.arms.inverse import follow
from study.robots.arms.table import ArmData, arm_data, arm_names, arm_table

__all__ = [
    "ArmData",
    "ArmErrors",
    "ChainArm",
    "ChainData",
    "SixAxisArm",
    "arm",
    "arm_data",
    "arm_names",
    "arm_table",
    "differential_gain",
    "follow",
    "guided_arm",
]
