"""A 5-axis robot: the 4-axis one with a second rotation of the drill."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.errors import InputError
from study.robots.ansr import Ansr
from study.robots.turns import PART_OF_TURN, cut_turns, turned


@dataclass(frozen=True, eq=False)
class FiveAxis(Ansr):
    """The 4-axis robot with one more rotation: joints x, y, z (mm), tilt and lean (radians).

    No such robot is in the text: its 5-DOF plans were never driven, and the columns that a robot
    decides are empty in tables 2.2, A.3 and A.4 (2.4.2). This one is taken so that plans of 4 and 5
    degrees of freedom can be compared in seconds at all. The tilt turns about the same axis as the
    4-axis robot's and carries the lean, which turns the drill out of the plane of the tilt; both
    rotations pass through one centre and are equally fast.

    Between two planned axes the drill turns on the great circle, as it was planned and is replayed.
    Two joints that both turn evenly leave that circle: by 0.1 mm at the far end of a 110 mm drill
    over 5 degrees at 45 degrees of lean. So a turn is cut into parts of at most a degree, which
    leaves a few micrometres.

    Parameters
    ----------
    directions, rotation_axis, rest_axis, burr_offset, max_tilt_speed_deg, axis_tolerance_deg
        As of `Ansr`; the speed is that of either rotation.
    """

    joint_names = ("x_mm", "y_mm", "z_mm", "tilt_deg", "lean_deg")

    def forward(self, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Burr centres in mm and drill axes, (n, 3) each, of (n, 5) joint values; see `Ansr.forward`."""
        joints = self._checked_joints(joints)
        lean = joints[:, 4:]
        axes = np.cos(lean) * self._in_plane(joints[:, 3]) + np.sin(lean) * self.rotation_vector
        return joints[:, :3] @ self.directions.T - self.burr_offset * axes, axes

    def inverse(self, points: np.ndarray, axes: np.ndarray) -> np.ndarray:
        """Joint values that bring the burr to `points` with the drill along `axes`.

        Parameters
        ----------
        points, axes : (n, 3) arrays
            As of `Ansr.inverse`.

        Returns
        -------
        (n, 5) array
            x, y, z in mm; tilt within (-pi, pi], lean within a quarter turn, radians.

        Raises
        ------
        InputError
            If the shapes differ from (n, 3), an axis is no unit vector, or it lies within a degree of
            the tilt's own axis, where the tilt has no value.
        """
        points, axes = self._checked_poses(points, axes)
        lean = np.arcsin(np.clip(axes @ self.rotation_vector, -1.0, 1.0))
        if (np.abs(lean) > np.pi / 2 - PART_OF_TURN).any():
            row = int(np.argmax(np.abs(lean)))
            raise InputError(
                f"axes: expected drill axes away from the rotation axis {self.rotation_vector.tolist()}; "
                f"row {row} leans {np.rad2deg(lean[row]):.3g} degrees"
            )
        tilt = np.arctan2(axes @ self.side_axis, axes @ self.rest_axis)
        centre = (points + self.burr_offset * axes) @ self.directions
        return np.column_stack([centre, tilt, lean])

    def turning_times(self, axes: np.ndarray) -> np.ndarray:
        """Seconds that the rotations take at least between consecutive drill axes.

        Parameters
        ----------
        axes : (n, 3) array
            Unit vectors from the burr's centre to the drill body.

        Returns
        -------
        (n - 1,) array
            The drill turns evenly on the great circle, so fast that the faster joint, where it is
            fastest, keeps `max_tilt_speed_deg`.
        """
        axes = np.asarray(axes, dtype=float)
        step, *shares = cut_turns(axes)
        begin, end = (turned(axes[step], axes[step + 1], share) for share in shares)
        before, after = (self.inverse(np.zeros_like(a), a)[:, 3:] for a in (begin, end))
        turn = np.abs((after - before + np.pi) % (2 * np.pi) - np.pi).max(axis=1, initial=0.0)
        longest, parts = np.zeros(len(axes) - 1), np.bincount(step, minlength=len(axes) - 1)
        np.maximum.at(longest, step, turn)
        return parts * longest / np.deg2rad(self.max_tilt_speed_deg)

    def places_in_turns(self, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where each turn is cut: (k,) steps, and (k,) shares of them between 0 and 1."""
        step, begin, _ = cut_turns(np.asarray(axes, dtype=float))
        return step[begin > 0], begin[begin > 0]
