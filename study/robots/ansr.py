"""The 4-axis robot: three translations and one rotation of the drill (Siebold, 2.2.3 and 2.4.1)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from study.errors import InputError

if TYPE_CHECKING:
    from study.planners import Plan


def _unit(vector: np.ndarray, name: str) -> np.ndarray:
    vector = np.array(vector, dtype=float)
    if vector.shape != (3,) or not np.isfinite(vector).all() or np.linalg.norm(vector) < 1e-12:
        raise InputError(f"{name}: expected a finite (3,) vector longer than 0, got {vector.tolist()}")
    return vector / np.linalg.norm(vector)


@dataclass(frozen=True, eq=False)
class Ansr:
    """A bone-attached robot with joints x, y, z (mm) and tilt (radians).

    The translations carry the rotation, the rotation carries the drill: its axis passes through the
    rotation's centre, the burr's centre hangs `burr_offset` mm along it. Joints x, y, z are the
    rotation centre's coordinates along the three translations, from the origin of the mm frame.

    Parameters
    ----------
    directions : (3, 3) array
        Orthonormal; the translations in the mm frame, one a column. The robot is mounted along the
        grid of the scan (2.2.3), so these are the volume's directions.
    rotation_axis : int
        The translation the drill rotates about: 0, 1 or 2.
    rest_axis : (3,) array
        Unit vector from the burr's centre to the drill body at tilt 0, perpendicular to the rotation axis.
    burr_offset : float
        mm from the rotation's centre to the burr's centre. Not printed; 60 mm, about the middle of
        the modelled drill. It changes joints, not times.
    max_tilt_speed_deg : float
        Degrees per second of the rotation. Not printed; 20.
    axis_tolerance_deg : float
        A drill axis may leave the plane of rotation by this much (rounding in a file) before it is
        refused. 0.05 degrees moves the far end of a 110 mm drill by 0.1 mm, a quarter of a voxel.

    Raises
    ------
    InputError
        If a parameter has the wrong shape or range, or `rest_axis` is not perpendicular to the rotation axis.
    """

    #: Names of the joints with their units, the rotations last.
    joint_names = ("x_mm", "y_mm", "z_mm", "tilt_deg")

    directions: np.ndarray = field(default_factory=lambda: np.eye(3))
    rotation_axis: int = 0
    rest_axis: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    burr_offset: float = 60.0
    max_tilt_speed_deg: float = 20.0
    axis_tolerance_deg: float = 0.05

    def __post_init__(self) -> None:
        directions = np.array(self.directions, dtype=float)
        if directions.shape != (3, 3) or not np.allclose(directions.T @ directions, np.eye(3), atol=1e-5):
            raise InputError(f"directions: expected orthonormal columns, (3, 3); got {directions.tolist()}")
        if self.rotation_axis not in (0, 1, 2):
            raise InputError(f"rotation_axis: expected 0, 1 or 2, got {self.rotation_axis!r}")
        for name in ("burr_offset", "max_tilt_speed_deg", "axis_tolerance_deg"):
            value = getattr(self, name)
            if not np.isfinite(value) or value <= 0:
                raise InputError(f"{name}: expected a positive number, got {value!r}")
        rest = _unit(self.rest_axis, "rest_axis")
        if abs(rest @ directions[:, self.rotation_axis]) > np.sin(np.deg2rad(self.axis_tolerance_deg)):
            raise InputError(
                f"rest_axis: expected a vector perpendicular to the rotation axis "
                f"{directions[:, self.rotation_axis].tolist()}, got {rest.tolist()}"
            )
        for array in (directions, rest):
            array.flags.writeable = False
        object.__setattr__(self, "directions", directions)
        object.__setattr__(self, "rest_axis", rest)

    @classmethod
    def for_plan(cls, plan: Plan, **parameters: float) -> Ansr:
        """The robot mounted as a plan assumes: along the grid, tilt 0 along the approach.

        Parameters
        ----------
        plan : Plan
        **parameters
            `burr_offset`, `max_tilt_speed_deg` or `axis_tolerance_deg`.

        Raises
        ------
        InputError
            If the plan has more degrees of freedom than the robot, was read without its volume or
            rotation axis, or its approach runs along its rotation axis.
        """
        axes = len(cls.joint_names)
        if plan.dof > axes:
            raise InputError(f"plan: a {axes}-axis robot needs a plan with dof {axes}, got dof {plan.dof}")
        if plan.modified is None or plan.rotation_axis not in (0, 1, 2):
            raise InputError(
                "plan: expected its volume and its rotation axis (0, 1 or 2); "
                f"got rotation_axis {plan.rotation_axis!r}"
                + (" and no volume (Plan.read_csv takes both)" if plan.modified is None else "")
            )
        directions = plan.modified.volume.directions
        about = directions[:, plan.rotation_axis]
        approach = _unit(plan.approach, "plan.approach")
        across = approach - (approach @ about) * about
        if np.linalg.norm(across) < 1e-6:
            raise InputError(f"plan: its approach {approach.tolist()} runs along its rotation axis")
        return cls(directions, int(plan.rotation_axis), -across, **parameters)

    @property
    def rotation_vector(self) -> np.ndarray:
        """(3,) unit vector the tilt turns about."""
        return self.directions[:, self.rotation_axis]

    @property
    def side_axis(self) -> np.ndarray:
        """(3,) unit vector that a tilt of a quarter turn points the drill along."""
        return np.cross(self.rotation_vector, self.rest_axis)

    def forward(self, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Burr and drill axis of joint values.

        Parameters
        ----------
        joints : (n, 4) array
            x, y, z in mm, tilt in radians.

        Returns
        -------
        points : (n, 3) array
            Burr centres, mm.
        axes : (n, 3) array
            Unit vectors from the burr's centre to the drill body.
        """
        joints = self._checked_joints(joints)
        axes = self._in_plane(joints[:, 3])
        return joints[:, :3] @ self.directions.T - self.burr_offset * axes, axes

    def inverse(self, points: np.ndarray, axes: np.ndarray) -> np.ndarray:
        """Joint values that bring the burr to `points` with the drill along `axes`.

        Parameters
        ----------
        points : (n, 3) array
            Burr centres, mm.
        axes : (n, 3) array
            Unit vectors from the burr's centre to the drill body.

        Returns
        -------
        (n, 4) array
            x, y, z in mm, tilt in radians within (-pi, pi].

        Raises
        ------
        InputError
            If the shapes differ from (n, 3), an axis is no unit vector, or an axis leaves the plane
            of rotation by more than `axis_tolerance_deg`: that is no 4-DOF pose.
        """
        points, axes = self._checked_poses(points, axes)
        out_of_plane = np.abs(axes @ self.rotation_vector)
        if (out_of_plane > np.sin(np.deg2rad(self.axis_tolerance_deg))).any():
            row = int(np.argmax(out_of_plane))
            angle = np.rad2deg(np.arcsin(min(out_of_plane[row], 1.0)))
            raise InputError(
                f"axes: expected drill axes within {self.axis_tolerance_deg:g} degrees of the plane "
                f"perpendicular to the rotation axis {self.rotation_vector.tolist()}; row {row} is "
                f"{angle:.3g} degrees off, this is not a plan of 4 degrees of freedom"
            )
        tilt = np.arctan2(axes @ self.side_axis, axes @ self.rest_axis)
        centre = (points + self.burr_offset * self._in_plane(tilt)) @ self.directions
        return np.column_stack([centre, tilt])

    def turning_times(self, axes: np.ndarray) -> np.ndarray:
        """Seconds that the rotation takes at least between consecutive drill axes.

        Parameters
        ----------
        axes : (n, 3) array
            Unit vectors from the burr's centre to the drill body.

        Returns
        -------
        (n - 1,) array
            Of the joint's turn at `max_tilt_speed_deg`.
        """
        tilt = np.unwrap(self.inverse(np.zeros(np.shape(axes)), axes)[:, 3])
        return np.abs(np.diff(tilt)) / np.deg2rad(self.max_tilt_speed_deg)

    def places_in_turns(self, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Steps and shares of them at which a turn needs a sample: none, one joint turns evenly."""
        return np.empty(0, int), np.empty(0)

    def _in_plane(self, tilt: np.ndarray) -> np.ndarray:
        return np.cos(tilt)[:, None] * self.rest_axis + np.sin(tilt)[:, None] * self.side_axis

    def _checked_joints(self, joints: np.ndarray) -> np.ndarray:
        joints = np.asarray(joints, dtype=float)
        if joints.ndim != 2 or joints.shape[1] != len(self.joint_names):
            raise InputError(f"joints: expected shape (n, {len(self.joint_names)}), got {joints.shape}")
        return joints

    @staticmethod
    def _checked_poses(points: np.ndarray, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points, and axes of length 1 to the last digit."""
        points, axes = np.asarray(points, dtype=float), np.asarray(axes, dtype=float)
        if points.ndim != 2 or points.shape[1] != 3 or axes.shape != points.shape:
            raise InputError(f"points, axes: expected two (n, 3) arrays, got {points.shape} and {axes.shape}")
        if not np.isfinite(points).all():
            raise InputError("points: expected finite mm, got a value that is not finite")
        length = np.linalg.norm(axes, axis=1)
        bad = ~(np.abs(length - 1) < 1e-3)
        if bad.any():
            row = int(np.flatnonzero(bad)[0])
            raise InputError(f"axes: expected unit vectors, got {axes[row].tolist()} in row {row}")
        return points, axes / length[:, None]
