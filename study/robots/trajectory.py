"""Joint trajectories: time-stamped samples of the joints (Siebold, 2.4.1)."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
import pandas as pd

from study.errors import InputError
from study.files import written_whole
from study.robots.ansr import Ansr
from study.robots.rounding import RoundedPath
from study.robots.turns import turned

_ARC_SHARES = np.array([0.25, 0.5, 0.75])  # samples inside an arc; its ends are samples too


@dataclass(frozen=True, eq=False)
class JointTrajectory:
    """Joints over time. Between two samples every joint moves at constant speed.

    Attributes
    ----------
    time_s : (m,) array
        Seconds from the start, never decreasing.
    joints : (m, 4) or (m, 5) array
        x, y, z of the rotations' centre in mm, tilt and, of a 5-axis robot, lean in radians.
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
        """(k, 4) or (k, 5) joints at (k,) times, held at the ends."""
        time_s = np.atleast_1d(np.asarray(time_s, dtype=float))
        return np.column_stack([np.interp(time_s, self.time_s, joint) for joint in self.joints.T])

    def to_frame(self) -> pd.DataFrame:
        """Columns time_s, those of the joints (`Ansr.joint_names`), burr_x_mm, burr_y_mm, burr_z_mm."""
        frame = pd.DataFrame({"time_s": self.time_s})
        frame[["x_mm", "y_mm", "z_mm"]] = self.joints[:, :3]
        frame[list(self.robot.joint_names[3:])] = np.rad2deg(self.joints[:, 3:])
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

    Within a step the burr moves at constant speed and the drill turns in proportion to the way, on the
    great circle between the planned axes. A turn of two joints has a sample every degree (`FiveAxis`).

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
    axes = np.asarray(axes, dtype=float)
    robot.inverse(path.points, axes)  # refuses what the robot cannot do, with the planned row
    clock = np.concatenate([[0.0], np.cumsum(step_times)])
    after = np.minimum(np.arange(n) + 1, n - 1)

    # Places inside steps at which the path begins, follows or leaves an arc.
    on = path.reaches > 0
    centre, reach = path.planned_s[path.corners[on]], path.reaches[on]
    shares = np.concatenate([[0.0], _ARC_SHARES, [1.0]])
    inside = (centre[:, None] + (2 * shares - 1) * reach[:, None]).ravel()
    steps = np.searchsorted(path.planned_s, inside, side="right") - 1
    new = (steps < n - 1) & (inside - path.planned_s[np.minimum(steps, n - 1)] > 1e-9)
    new &= path.planned_s[np.minimum(steps + 1, n - 1)] - inside > 1e-9
    inside, steps = inside[new], steps[new]
    length = path.planned_s[after] - path.planned_s
    share_inside = (inside - path.planned_s[steps]) / length[steps]
    turning, share_turning = robot.places_in_turns(axes)

    step = np.concatenate([np.arange(n), steps, turning])
    share_planned = np.concatenate([np.zeros(n), share_inside, share_turning])
    order = np.argsort(step + share_planned, kind="stable")
    step, share_planned = step[order], share_planned[order]
    at = path.planned_s[step] + share_planned * length[step]
    way = path.rounded_s[after[step]] - path.rounded_s[step]
    gone = path.rounded_at(at) - path.rounded_s[step]
    share = np.divide(gone, way, out=share_planned.copy(), where=way > 0)
    time = clock[step] + share * (clock[after[step]] - clock[step])
    points = path.at(step, at)
    joints = robot.inverse(points, turned(axes[step], axes[after[step]], share))
    joints[:, 3] = np.unwrap(joints[:, 3])
    return JointTrajectory(time, joints, points, robot)
