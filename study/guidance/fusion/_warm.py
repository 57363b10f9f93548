"""Compiles this room's kernels before workers start."""

from __future__ import annotations

import numpy as np

from study.guidance.fusion.pose_fusion import PoseFusion
from study.guidance.fusion.settings import FusionSettings


def warm() -> None:
    """Compile, or load, every kernel that Python calls here."""
    PoseFusion(FusionSettings(), np.eye(4)).step(np.zeros(6), np.eye(4))
