"""5-DOF accessibility (2.2.3): is the shaft free from a direction, from which ones, between two."""

from study.collision.directions.around import cone_around, turned_aside, window_around
from study.collision.directions.check import DirectionCheck
from study.collision.directions.space import build_free_space, cone_of_directions

__all__ = [
    "DirectionCheck",
    "build_free_space",
    "cone_around",
    "cone_of_directions",
    "turned_aside",
    "window_around",
]
