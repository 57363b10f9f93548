"""Fusion of a late, slow optical tracker with the robot's encoders (Baron, section 5.3)."""

from study.guidance.fusion.workspace import workspace

__all__ = ["workspace"]
