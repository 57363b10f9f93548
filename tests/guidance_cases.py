"""Guided robots without any error, or with one."""

from study.guidance import LoopSettings, SafetySettings, system

#: Causes of error that can be none; what is left is geometry and time.
ERRORS = (
    "tracker_jitter_mm",
    "tracker_distortion_mm",
    "tracker_quantum_mm",
    "robot_repeatability_mm",
    "joint_bias_mrad",
    "link_error_mm",
    "axis_error_mrad",
    "pointer_tip_error_mm",
    "pointer_seating_mm",
    "bit_length_error_mm",
    "tool_axis_error_mrad",
    "calibration_force_n",
    "sphere_position_mm",
    "image_fle_mm",
    "lateral_force_n",
    "force_variation_n",
    "entry_slip_mm",
    "scan_reading_mm",
)

#: A tracker without noise repeats itself when the robot stands.
NOISELESS = LoopSettings(safety=SafetySettings(frozen_samples=0))


def only(name, **causes):
    """A system of which nothing errs but what is named."""
    return system(name, **(dict.fromkeys(ERRORS, 0.0) | causes))
