"""Iterative closest point: many starts of one swab against one surface, in a kernel."""

from study.registration.icp.fits import SurfaceFits, register_surface
from study.registration.icp.settings import IcpSettings
from study.registration.icp.tree import SurfaceTree

__all__ = ["IcpSettings", "SurfaceFits", "SurfaceTree", "register_surface"]
