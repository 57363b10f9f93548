"""The semantics of collision, stated once: finite cylinders against voxel cubes, no approximation."""
