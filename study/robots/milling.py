"""Predicted milling: path length, time and speed of a plan on a robot (Siebold, 2.4.1 and 2.5.1)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from study.errors import InputError
from study.robots.ansr import Ansr
from study.robots.feed import FeedSettings, weighted_removal
from study.robots.five_axis import FiveAxis
from study.robots.rounding import RoundedPath, RoundingSettings, round_plan
from study.robots.trajectory import JointTrajectory, joint_trajectory

if TYPE_CHECKING:
    from study.planners import Plan


@dataclass(frozen=True, eq=False)
class Motion:
    """What the feed rate acts on: the steps between planned points.

    Attributes
    ----------
    lengths : (m,) array
        mm of rounded path in each step; 0 where the drill rotates in place.
    removed : (m,) array
        mm^3 of bone of relative density 1 removed in each step.
    turning_times : (m,) array
        Seconds the rotation of each step takes at least.
    """

    lengths: np.ndarray
    removed: np.ndarray
    turning_times: np.ndarray

    def times(self, feed: FeedSettings) -> np.ndarray:
        """(m,) seconds of each step: of its travel or its rotation, whichever takes longer."""
        return np.maximum(self.lengths / feed.speeds(self.removed, self.lengths), self.turning_times)

    def mean_speed(self, feed: FeedSettings) -> float:
        """Length over time, mm/s; 0 for a motion that takes no time."""
        time = float(self.times(feed).sum())
        return float(self.lengths.sum()) / time if time > 0 else 0.0


@dataclass(frozen=True, eq=False)
class Milling:
    """What a robot makes of a plan.

    Attributes
    ----------
    plan : Plan
    robot : Ansr
    feed : FeedSettings
    path : RoundedPath
        The path the burr's centre follows.
    removed : (n,) array
        mm^3 of bone (of relative density 1) removed on arriving at each planned point.
    """

    plan: Plan
    robot: Ansr
    feed: FeedSettings
    path: RoundedPath
    removed: np.ndarray

    @cached_property
    def motion(self) -> Motion:
        """The steps between planned points."""
        turning = self.robot.turning_times(self.plan.axes)
        return Motion(np.diff(self.path.rounded_s), self.removed[1:], turning)

    @property
    def speeds(self) -> np.ndarray:
        """(n - 1,) mm/s the feed rate allows in each step."""
        return self.feed.speeds(self.motion.removed, self.motion.lengths)

    @cached_property
    def step_times(self) -> np.ndarray:
        """(n - 1,) seconds of each step."""
        return self.motion.times(self.feed)

    @property
    def path_length_mm(self) -> float:
        """Length of the rounded path, mm (the printed milling path length)."""
        return self.path.length_mm

    @property
    def time_s(self) -> float:
        """Predicted milling time, s."""
        return float(self.step_times.sum())

    @property
    def mean_speed_mm_per_s(self) -> float:
        """Rounded length over time, mm/s; 0 for a plan that does not move."""
        return self.path_length_mm / self.time_s if self.time_s > 0 else 0.0

    @property
    def rotation_time_s(self) -> float:
        """Seconds in which the burr stands and the drill turns."""
        return float(self.step_times[self.motion.lengths == 0].sum())

    @cached_property
    def trajectory(self) -> JointTrajectory:
        """Joints over time."""
        return joint_trajectory(self.path, self.plan.axes, self.step_times, self.robot)

    def verify(self) -> pd.Series:
        """Replay burr and shaft along the trajectory, chords of its arcs included, as `Plan.verify` does.

        The plan was verified along its own corners; this says that rounding them broke nothing. It
        does so by default, because corners at which bone is removed are kept (`RoundingSettings`).

        Returns
        -------
        pandas.Series
            As of `Plan.verify`.

        Raises
        ------
        PlanViolation
            If the burr cuts protected bone or the shaft meets unmilled bone.
        """
        points, axes = self.robot.forward(self.trajectory.joints)
        driven = replace(self.plan, points=points, axes=axes, removed=np.zeros(len(points)), remaining=None)
        everywhere = np.ones(self.plan.modified.volume.shape)
        return replace(driven, removed=weighted_removal(driven, everywhere)).verify()

    def summary(self) -> pd.Series:
        """The columns of tables A.1 and A.2 that the robot decides (lengths truly in mm)."""
        return pd.Series(
            {
                "milling_path_length_mm": self.path_length_mm,
                "predicted_milling_time_s": self.time_s,
                "average_milling_speed_mm_per_s": self.mean_speed_mm_per_s,
            }
        )


def predict_milling(
    plan: Plan,
    robot: Ansr | None = None,
    feed: FeedSettings | None = None,
    density: np.ndarray | None = None,
    rounding: RoundingSettings | None = None,
) -> Milling:
    """Round the plan's corners, set the feed rate from the bone removed, and add up the time.

    Parameters
    ----------
    plan : Plan
        The printed 5-DOF tables leave these columns empty: the text's robot has 4 axes.
    robot : Ansr, optional
        By default ``Ansr.for_plan(plan)``, for a plan of 5 degrees of freedom the hypothetical
        ``FiveAxis.for_plan(plan)``, whose rotations are as fast.
    feed : FeedSettings, optional
    density : (nx, ny, nz) array, optional
        Relative bone density on the volume's grid (`relative_density` makes it from a CT). Without
        it all bone has density 1 and ``plan.removed`` counts.
    rounding : RoundingSettings, optional

    Returns
    -------
    Milling

    Raises
    ------
    InputError
        If the robot cannot follow the plan or `density` does not fit its volume.
    """
    if robot is None:
        robot = (FiveAxis if plan.dof == 5 else Ansr).for_plan(plan)
    feed = FeedSettings() if feed is None else feed
    removed = plan.removed if density is None else weighted_removal(plan, density)
    removed = np.asarray(removed, dtype=float)
    if removed.shape != (len(plan.points),) or not (removed >= 0).all():
        raise InputError(f"plan.removed: expected {len(plan.points)} volumes of at least 0 mm^3")
    robot.inverse(plan.points, plan.axes)  # refuses what the robot cannot do
    return Milling(plan, robot, feed, round_plan(plan, rounding), removed)
