"""Compiled landing of voxels under drawn transforms."""
