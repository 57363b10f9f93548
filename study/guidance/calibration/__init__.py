"""Calibration of the drill and of its marker on the arm (Baron, section 4.3)."""

from study.guidance.calibration.bits import BitCalibration, calibrate_bits
from study.guidance.calibration.hand_eye import HandEyeCalibration, calibrate_hand_eye
from study.guidance.calibration.pivot import PivotCalibration, calibrate_pivot
from study.guidance.calibration.tool_frame import T_tool_tcp_from
from study.guidance.calibration.turns import turn_spread

__all__ = [
    "BitCalibration",
    "HandEyeCalibration",
    "PivotCalibration",
    "T_tool_tcp_from",
    "calibrate_bits",
    "calibrate_hand_eye",
    "calibrate_pivot",
    "turn_spread",
]
