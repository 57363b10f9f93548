"""Markers: rigid bodies of spheres, whose pose an optical tracker measures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from study.errors import InputError
from study.guidance.frames import checked_transforms, rigid
from study.registration.first_order import motion_of_points
from study.registration.rigid import checked_fiducials, register_many


@dataclass(frozen=True, eq=False)
class MarkerBody:
    """Spheres fixed to each other, in a frame of their own.

    Parameters
    ----------
    points : (m, 3) array
        Centres of the spheres, mm; three or more, not on one line. The spheres face along +z.
    name : str

    Raises
    ------
    InputError
        If the spheres do not fix a pose.
    """

    points: ArrayLike
    name: str = "marker"

    def __post_init__(self) -> None:
        points = checked_fiducials(f"spheres of {self.name!r}", self.points)
        points.flags.writeable = False
        object.__setattr__(self, "points", points)

    @classmethod
    def plate(cls, size_mm: float = 80.0, name: str = "plate") -> MarkerBody:
        """Four spheres on a flat plate, near the corners of a square of edge `size_mm`, facing +z.

        They are moved off the corners so that no two of their distances are alike, as a tracker needs to
        tell one sphere from another, and scaled so that the root mean squared distance from their centroid,
        which is the frame's origin, is the square's.

        Raises
        ------
        InputError
            If the size is not a positive number.
        """
        if not np.isfinite(size_mm) or size_mm <= 0:
            raise InputError(f"size_mm: expected a positive number, got {size_mm!r}")
        corners = np.array([[0.5, 0.5, 0.0], [-0.5, 0.4, 0.0], [-0.4, -0.5, 0.0], [0.5, -0.3, 0.0]])
        corners -= corners.mean(axis=0)
        corners *= np.sqrt(0.5 / (corners**2).sum(axis=1).mean())
        return cls(corners * size_mm, name)

    @cached_property
    def motion_of_displacements(self) -> np.ndarray:
        """(m, 6, 3) first-order motion of the body by which small displacements of its spheres are fitted.

        All in the body's frame: rotation vector (rad) first, then translation of the origin (mm), each the
        sum over spheres of this times the sphere's displacement.
        """
        jacobian = motion_of_points(self.points, np.zeros(3)).reshape(-1, 6)
        return np.moveaxis(np.linalg.pinv(jacobian).reshape(6, -1, 3), 0, 1)

    def placed(self, T_cam_body: np.ndarray) -> np.ndarray:
        """(n, m, 3) centres of the spheres at (n, 4, 4) poses, mm."""
        return self.points @ np.swapaxes(T_cam_body[:, :3, :3], 1, 2) + T_cam_body[:, None, :3, 3]

    def fitted(self, spheres: np.ndarray) -> np.ndarray:
        """(n, 4, 4) poses ``T_cam_body`` that fit (n, m, 3) measured spheres best, by least squares."""
        moving = np.broadcast_to(self.points, spheres.shape)
        return register_many(moving, spheres, np.ones(len(self.points)))


def view_angles(T_cam_body: ArrayLike) -> np.ndarray:
    """(n,) angles between where markers face and where the camera is, seen from them, rad.

    Passive spheres on a plate are usually seen up to about a right angle, flat markers up to about 1 rad.

    Parameters
    ----------
    T_cam_body : (n, 4, 4) array
        The camera is at the origin, markers face along their +z.

    Raises
    ------
    InputError
        If it is not an array of rigid transforms, or a marker is at the camera's origin.
    """
    T = checked_transforms("T_cam_body", T_cam_body)
    distance = np.linalg.norm(T[:, :3, 3], axis=1)
    if (distance == 0).any():
        raise InputError("T_cam_body: expected markers in front of the camera, got one at its origin")
    towards = -T[:, :3, 3] / distance[:, None]
    facing = T[:, :3, 2]
    return np.arctan2(np.linalg.norm(np.cross(facing, towards), axis=1), (facing * towards).sum(axis=1))


def facing_pose(position: ArrayLike, towards: ArrayLike = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Poses at positions whose z axis points at the camera, or at another point.

    Their x axis is as near to the camera's x axis as it can be; to its y axis where z is within some 25
    degrees of x.

    Parameters
    ----------
    position : (3,) or (n, 3) array
        mm, camera frame.
    towards : (3,) or (n, 3) array
        mm; the camera by default.

    Returns
    -------
    (4, 4) or (n, 4, 4) array

    Raises
    ------
    InputError
        If two places are the same, or a number is not finite.
    """
    place, goal = np.asarray(position, dtype=float), np.asarray(towards, dtype=float)
    if place.shape[-1:] != (3,) or place.ndim > 2:
        raise InputError(f"position: expected shape (3,) or (n, 3) in mm, got {place.shape}")
    z = goal - place
    length = np.linalg.norm(z, axis=-1, keepdims=True)
    if not (np.isfinite(length) & (length > 0)).all():
        raise InputError(f"position: expected finite numbers, apart from {towards}, got {position}")
    z = z / length
    near = np.where(np.abs(z[..., :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    x = near - (near * z).sum(axis=-1, keepdims=True) * z
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    return rigid(np.stack([x, np.cross(z, x), z], axis=-1), place)
