"""The vertex nearest to a point, exactly: a tree over a surface's vertices and lists of their neighbours."""

from study.registration.icp.nearest.tree import SurfaceTree

__all__ = ["SurfaceTree"]
