"""Segmented images: `LabelVolume`, the files they come from and go to, structuring elements."""

from study.volumes.elements import ball_element
from study.volumes.label_volume import PLANNING_NAMES, LabelVolume

__all__ = ["PLANNING_NAMES", "LabelVolume", "ball_element"]
