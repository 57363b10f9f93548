"""Compiled: how far transforms move points, and lattice corners in voxels."""
