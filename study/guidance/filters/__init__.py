"""Filters of one signal: the patient's, and the low-pass of figure 7 (Baron, sections 5.2 and 5.3)."""

from study.guidance.filters._warm import warm
from study.guidance.filters.low_pass import low_pass
from study.guidance.filters.noise import PoseNoise, measured_noise
from study.guidance.filters.patient import (
    PatientFilter,
    PatientFilterSettings,
    new_sample_weight_of_orientation,
    new_sample_weight_of_position,
)

__all__ = [
    "PatientFilter",
    "PatientFilterSettings",
    "PoseNoise",
    "low_pass",
    "measured_noise",
    "new_sample_weight_of_orientation",
    "new_sample_weight_of_position",
    "warm",
]
