"""Fusion of a late, slow optical tracker with the robot's encoders (Baron, section 5.3)."""

from study.guidance.fusion._warm import warm
from study.guidance.fusion.model import lags_of, system_matrices, workspace
from study.guidance.fusion.pose_fusion import Innovation, PoseFusion
from study.guidance.fusion.settings import FusionSettings

__all__ = ["FusionSettings", "Innovation", "PoseFusion", "lags_of", "system_matrices", "warm", "workspace"]
