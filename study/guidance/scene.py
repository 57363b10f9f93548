"""Where robot, camera and patient stand, and how the drill is mounted: the geometry of a virtual experiment.

The texts show these in photographs only. The layout is ours: the patient half a metre in front of the robot,
the camera two metres to the side, markers that face it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from study.errors import InputError
from study.guidance.frames import checked_transform, inverse, moved, rigid
from study.guidance.tracker import MarkerBody, facing_pose
from study.registration.rigid import checked_fiducials, checked_points
from study.registration.sources import checked_vector


def facing_orientation(axis: np.ndarray, towards: np.ndarray, T_tool_tcp: np.ndarray) -> np.ndarray:
    """(3, 3) orientation of the drill on an axis, turned about it until its marker faces the camera best.

    A hole does not tell how the drill is turned about its own axis; the robot uses that to keep the
    marker in view (Baron, section 4.1).

    Parameters
    ----------
    axis : (3,) array
        From the drill's body to the tip, unit vector, any frame.
    towards : (3,) array
        From the drill to the camera, same frame.
    T_tool_tcp : (4, 4) array
        Of the drill in its marker's frame; the marker faces along its +z.

    Returns
    -------
    (3, 3) array
        Axes of the tcp frame in that frame.

    Raises
    ------
    InputError
        If the camera is on the axis, or the marker faces along the drill: no turn is better than another.
    """
    marker = T_tool_tcp[2, :3]  # where the marker faces, in the tcp frame
    facing = np.hypot(marker[0], marker[1])
    across = towards - (towards @ axis) * axis
    length = np.linalg.norm(across)
    if not (facing > 1e-6 and length > 1e-6 * np.linalg.norm(towards)):
        raise InputError("expected a camera beside the drill's axis and a marker that does not face along it")
    # Turn the tcp so that the marker's direction across the axis meets the camera's.
    x = across / length
    cos, sin = marker[0] / facing, marker[1] / facing
    return np.column_stack([x, np.cross(axis, x), axis]) @ np.array(
        [[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]
    )


@dataclass(frozen=True, eq=False)
class Phantom:
    """What is drilled: spheres to register by and straight holes, in the frame of its image.

    Attributes
    ----------
    name : str
    spheres : (n, 3) array
        Centres, mm; three or more, not on one line.
    entries, targets : (m, 3) arrays
        Ends of the planned holes, mm.
    T_rob_img : (4, 4) array
        Where it lies.
    beyond_mm : float
        How far the tip goes on past the target.

    Raises
    ------
    InputError
        If a shape is wrong or a hole has no length.
    """

    name: str
    spheres: ArrayLike
    entries: ArrayLike
    targets: ArrayLike
    T_rob_img: ArrayLike
    beyond_mm: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "spheres", checked_fiducials("spheres", self.spheres))
        entries = checked_points("entries", np.atleast_2d(self.entries))
        targets = checked_points("targets", np.atleast_2d(self.targets))
        if len(entries) != len(targets):
            raise InputError(
                f"entries, targets: expected as many of both, got {len(entries)} and {len(targets)}"
            )
        if (np.linalg.norm(targets - entries, axis=1) < 1e-6).any():
            raise InputError("entries, targets: expected holes of some length, one ends where it begins")
        if not 0 <= self.beyond_mm < np.inf:
            raise InputError(f"beyond_mm: expected a finite number of at least 0 mm, got {self.beyond_mm!r}")
        object.__setattr__(self, "entries", entries)
        object.__setattr__(self, "targets", targets)
        object.__setattr__(self, "T_rob_img", checked_transform("T_rob_img", self.T_rob_img))

    @property
    def lengths(self) -> np.ndarray:
        """(m,) mm from entry to target."""
        return np.linalg.norm(self.targets - self.entries, axis=1)

    @property
    def directions(self) -> np.ndarray:
        """(m, 3) unit vectors from entry to target."""
        return (self.targets - self.entries) / self.lengths[:, None]


@dataclass(frozen=True, eq=False)
class Scene:
    """The camera, the markers and the drill's mount, as they truly are.

    Attributes
    ----------
    camera : (3,) array
        Position in the robot's frame, mm.
    looks_at : (3,) array
        The point it is aimed at, mm.
    patient_marker : (3,) array
        In the robot's frame, mm.
    base_marker : (3,) array
        In the robot's frame, mm.
    calibration_place : (3,) array
        Where the tip is while it is calibrated, in the robot's frame, mm.
    marker_size_mm, tip_lever_mm : float
        See `study.guidance.systems.GuidedSystem`.
    flange_mm, mount_mm : float
        From the end effector's origin, the wrist's centre, along the last axis to the drill's mount, and from
        there along the drill to its tip.
    mount_tilt_deg : float
        Between the last axis and the drill. Ours: chosen so that both arms drill downwards with a bent wrist,
        far from singular poses.
    """

    camera: ArrayLike = (450.0, -1900.0, 900.0)
    looks_at: ArrayLike = (450.0, 0.0, 250.0)
    patient_marker: ArrayLike = (450.0, -90.0, 150.0)
    base_marker: ArrayLike = (60.0, -120.0, 200.0)
    calibration_place: ArrayLike = (400.0, -150.0, 250.0)
    marker_size_mm: float = 80.0
    tip_lever_mm: float = 180.0
    flange_mm: float = 90.0
    mount_mm: float = 120.0
    mount_tilt_deg: float = 60.0

    def __post_init__(self) -> None:
        for name in ("camera", "looks_at", "patient_marker", "base_marker", "calibration_place"):
            object.__setattr__(self, name, checked_vector(name, getattr(self, name), "mm"))
        for name in ("marker_size_mm", "tip_lever_mm", "flange_mm", "mount_mm", "mount_tilt_deg"):
            if not np.isfinite(getattr(self, name)):
                raise InputError(f"{name}: expected a finite number, got {getattr(self, name)!r}")

    @cached_property
    def T_rob_cam(self) -> np.ndarray:
        """The camera, z along its line of sight."""
        return facing_pose(self.camera, self.looks_at)

    @cached_property
    def T_cam_rob(self) -> np.ndarray:
        """The robot's base, seen by the camera."""
        return inverse(self.T_rob_cam)

    @cached_property
    def T_rob_pat(self) -> np.ndarray:
        """The patient's marker, facing the camera."""
        return facing_pose(self.patient_marker, self.camera)

    @cached_property
    def T_rob_base(self) -> np.ndarray:
        """The base's marker, facing the camera."""
        return facing_pose(self.base_marker, self.camera)

    @cached_property
    def marker(self) -> MarkerBody:
        """The plate of spheres on drill, base and patient."""
        return MarkerBody.plate(self.marker_size_mm)

    @cached_property
    def T_tool_tcp(self) -> np.ndarray:
        """The drill under its marker: tip straight below, 60 mm behind, pointing down."""
        down = np.column_stack([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
        return rigid(down, [0.0, -self.tip_lever_mm, -60.0])

    def drilling_pose(self, T_rob_img: np.ndarray, tip: np.ndarray, axis: np.ndarray) -> np.ndarray:
        """(4, 4) T_rob_tcp of a tip and an axis planned in the image, its marker turned to the camera."""
        place = moved(T_rob_img, tip)
        direction = T_rob_img[:3, :3] @ axis
        return rigid(facing_orientation(direction, self.camera - place, self.T_tool_tcp), place)

    @cached_property
    def T_ee_tcp(self) -> np.ndarray:
        """The drill on the end effector."""
        tilt = Rotation.from_euler("y", -self.mount_tilt_deg, degrees=True)
        return rigid(tilt, np.array([0.0, 0.0, self.flange_mm]) + tilt.apply([0.0, 0.0, self.mount_mm]))
