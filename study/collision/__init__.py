"""The drill, and whether its shaft can reach a voxel from a direction."""

from study.collision.drill import Drill
from study.collision.frame import CanonicalFrame, canonical_frame, find_approach
from study.collision.windows import build_shaft, window

__all__ = ["CanonicalFrame", "Drill", "build_shaft", "canonical_frame", "find_approach", "window"]
