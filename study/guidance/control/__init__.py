"""PI control of the drill's pose by differential commands (Baron, sections 3.1 and 5.1)."""

from study.guidance.control.pose_controller import ControlSettings, PoseController

__all__ = ["ControlSettings", "PoseController"]
