"""Compiled search for the surface corner that is nearest in a voxel's own metric."""
