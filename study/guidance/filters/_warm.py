"""Compiles this room's kernel before workers start."""

from __future__ import annotations

import numpy as np

from study.guidance.filters.noise import PoseNoise
from study.guidance.filters.patient import PatientFilter, PatientFilterSettings


def warm() -> None:
    """Compile, or load, every kernel that Python calls here."""
    PatientFilter(PatientFilterSettings(), PoseNoise((1, 1, 1), (1, 1, 1))).step(np.eye(4))
