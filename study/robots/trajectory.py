"""Joint trajectories: time-stamped samples of the four joints (Siebold, 2.4.1)."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
import pandas as pd

from study.errors import InputError
from study.files import written_whole
from study.robots.ansr import Ansr
from study.robots.rounding import RoundedPath

_ARC_SHARES = np.array([0.25, 0.5, 0.75])  # samples inside an arc; its ends are samples too


@dataclass(frozen=True, eq=False)
class JointTrajectory:
    """Joints over time. Between two samples every joint moves at constant speed.

    Attributes
    ----------
    time_s : (m,) array
        Seconds from the start, never decreasing.
    joints : (m, 4) array
        x, y, z of the rotation's centre in mm, tilt in radians.
    points : (m, 3) array
        Burr centres, mm, in the volume's frame.
    robot : Ansr
        Whose joints these are.
    """

    time_s: np.ndarray
    joints: np.ndarray
    points: np.ndarray
    robot: Ansr

    @property
    def duration_s(self) -> float:
        """Seconds from the first sample to the last."""
        return float(self.time_s[-1] - self.time_s[0])

    def at(self, time_s: np.ndarray) -> np.ndarray:
        """(k, 4) joints at (k,) times, held at the ends."""
        time_s = np.atleast_1d(np.asarray(time_s, dtype=float))
        return np.column_stack([np.interp(time_s, self.time_s, joint) for joint in self.joints.T])

    def to_frame(self) -> pd.DataFrame:
        """Columns time_s, x_mm, y_mm, z_mm, tilt_deg and the burr's burr_x_mm, burr_y_mm, burr_z_mm."""
        frame = pd.DataFrame({"time_s": self.time_s})
        frame[["x_mm", "y_mm", "z_mm"]] = self.joints[:, :3]
        frame["tilt_deg"] = np.rad2deg(self.joints[:, 3])
        frame[["burr_x_mm", "burr_y_mm", "burr_z_mm"]] = self.points
        return frame

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write `to_frame` to a file, whole or not at all."""
        with written_whole(path) as temporary:
            self.to_frame().to_csv(temporary, index=False, float_format="%.6f")


def joint_trajectory(
    path: RoundedPath, axes: np.ndarray, step_times: np.ndarray, robot: Ansr
) -> JointTrajectory:
    """Samples at every planned point and along every arc.

    Within a step the burr moves at constant speed and the tilt turns in proportion to the way.

    Parameters
    ----------
    path : RoundedPath
    axes : (n, 3) array
        Drill axes at the planned points.
    step_times : (n - 1,) array
        Seconds of each step.
    robot : Ansr

    Returns
    -------
    JointTrajectory

    Raises
    ------
    InputError
        If the shapes do not belong together or an axis is not the robot's (see `Ansr.inverse`).
    """
    n = len(path.points)
    if np.shape(axes) != (n, 3) or np.shape(step_times) != (n - 1,):
        raise InputError(
            f"axes, step_times: expected shapes ({n}, 3) and ({n - 1},), "
            f"got {np.shape(axes)} and {np.shape(step_times)}"
        )
    tilt = np.unwrap(robot.inverse(path.points, axes)[:, 3])
    clock = np.concatenate([[0.0], np.cumsum(step_times)])

    # Places inside steps at which the path begins, follows or leaves an arc.
    on = path.reaches > 0
    centre, reach = path.planned_s[path.corners[on]], path.reaches[on]
    shares = np.concatenate([[0.0], _ARC_SHARES, [1.0]])
    inside = (centre[:, None] + (2 * shares - 1) * reach[:, None]).ravel()
    steps = np.searchsorted(path.planned_s, inside, side="right") - 1
    new = (steps < n - 1) & (inside - path.planned_s[np.minimum(steps, n - 1)] > 1e-9)
    new &= path.planned_s[np.minimum(steps + 1, n - 1)] - inside > 1e-9
    inside, steps = inside[new], steps[new]

    at = np.concatenate([path.planned_s, inside])
    step = np.concatenate([np.arange(n), steps])
    length = path.planned_s[np.minimum(step + 1, n - 1)] - path.planned_s[step]
    share_planned = np.divide(at - path.planned_s[step], length, out=np.zeros(at.size), where=length > 0)
    order = np.argsort(step + share_planned, kind="stable")
    at, step = at[order], step[order]
    rounded = path.rounded_at(at)
    way = path.rounded_s[np.minimum(step + 1, n - 1)] - path.rounded_s[step]
    share = np.divide(rounded - path.rounded_s[step], way, out=np.zeros(at.size), where=way > 0)
    after = np.minimum(step + 1, n - 1)
    time = clock[step] + share * (clock[after] - clock[step])
    tilts = tilt[step] + share * (tilt[after] - tilt[step])
    points = path.at(step, at)
    side = np.cross(robot.rotation_vector, robot.rest_axis)
    drill = np.cos(tilts)[:, None] * robot.rest_axis + np.sin(tilts)[:, None] * side
    joints = robot.inverse(points, drill)
    joints[:, 3] = tilts
    return JointTrajectory(time, joints, points, robot)
