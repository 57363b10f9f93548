"""The drill, and whether its shaft can reach a voxel from a direction."""

from study.collision.directions import DirectionCheck, cone_around, turned_aside, window_around
from study.collision.drill import Drill
from study.collision.frame import CanonicalFrame, canonical_frame, find_approach
from study.collision.octree import OctreeCheck
from study.collision.windows import build_shaft, window

__all__ = [
    "CanonicalFrame",
    "DirectionCheck",
    "Drill",
    "OctreeCheck",
    "build_shaft",
    "canonical_frame",
    "cone_around",
    "find_approach",
    "turned_aside",
    "window",
    "window_around",
]
