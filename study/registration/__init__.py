"""Registration: closed-form fits, what they miss to first order, and models of it that can be drawn."""

from study.registration.alignment import Alignment, AlignmentSettings, align_surface
from study.registration.first_order import first_order_tre_covariance, isotropic_tre_covariance
from study.registration.icp import IcpSettings, SurfaceFits, SurfaceTree, register_surface
from study.registration.moments import DisplacementMoments, sampled_moments
from study.registration.point import FLE_RMS, PointRegistration
from study.registration.rigid import RigidFit, register_points
from study.registration.sources import (
    CombinedErrors,
    ErrorSource,
    ImageError,
    RobotError,
    displacement_moments,
)
from study.registration.surface import SurfaceRegistration

__all__ = [
    "FLE_RMS",
    "Alignment",
    "AlignmentSettings",
    "CombinedErrors",
    "DisplacementMoments",
    "ErrorSource",
    "IcpSettings",
    "ImageError",
    "PointRegistration",
    "RigidFit",
    "RobotError",
    "SurfaceFits",
    "SurfaceRegistration",
    "SurfaceTree",
    "align_surface",
    "displacement_moments",
    "first_order_tre_covariance",
    "isotropic_tre_covariance",
    "register_points",
    "register_surface",
    "sampled_moments",
]
