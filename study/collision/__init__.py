"""The drill, and whether its shaft can reach a voxel from a direction."""

from study.collision.drill import Drill

__all__ = ["Drill"]
