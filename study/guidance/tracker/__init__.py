"""An optical tracker, its markers, its pointer and its stream of samples (Baron, sections 3.2 and 4.2)."""

from study.guidance.tracker.markers import MarkerBody, facing_pose, view_angles
from study.guidance.tracker.pointer import touch
from study.guidance.tracker.settings import TrackerSettings
from study.guidance.tracker.stream import SampleReader, TrackerSample, TrackerStream
from study.guidance.tracker.tracker import Tracker

__all__ = [
    "MarkerBody",
    "SampleReader",
    "Tracker",
    "TrackerSample",
    "TrackerSettings",
    "TrackerStream",
    "facing_pose",
    "touch",
    "view_angles",
]
