"""Iterative closest point: many starts of one swab against one surface, in a kernel."""

from study.registration.icp.fits import SurfaceFits, register_surface
from study.registration.icp.nearest import SurfaceTree
from study.registration.icp.settings import IcpSettings

__all__ = ["IcpSettings", "SurfaceFits", "SurfaceTree", "register_surface"]
