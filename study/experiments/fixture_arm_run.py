"""A UR5 that is led by hand over a bone: joints over time, and damping near a singular posture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from study.fixtures import Controller
from study.fixtures.arm import ArmController
from study.fixtures.hands import Hand
from study.robots.arms import guided_arm


def arm_holding(
    control: Controller, start: np.ndarray, upright: np.ndarray, name: str = "UR5"
) -> ArmController:
    """An arm in its ready posture beside the patient, so that the tool's tip is at its first place.

    Parameters
    ----------
    control : Controller
    start : (3,) array
        mm, the tip.
    upright : (3,) array
        Rotation vector of the tool's frame.
    name : str
        See `guided_arm`.
    """
    arm = guided_arm(name)
    T_ee_tool = np.eye(4)
    T_ee_tool[:3, :3] = Rotation.from_euler(
        "x", 180, degrees=True
    ).as_matrix()  # the shaft ends in the flange
    T_ee_tool[2, 3] = 110.0
    T_mesh_tool = np.eye(4)
    T_mesh_tool[:3, :3] = Rotation.from_rotvec(upright).as_matrix()
    T_mesh_tool[:3, 3] = start
    T_mesh_rob = T_mesh_tool @ np.linalg.inv(arm.forward(arm.ready) @ T_ee_tool)
    T_mesh_rob[:3, :3] = Rotation.from_matrix(T_mesh_rob[:3, :3]).as_matrix()
    return ArmController(arm, control, T_mesh_rob, T_ee_tool)


#: Joints of a UR5 whose elbow is nearly straight, degrees.
NEARLY_STRETCHED = (0.0, -52.0, 33.0, -134.0, -90.0, 0.0)


def arm_run(
    control: ArmController, hand: Hand, seconds: float, joints_deg: Sequence[float] | None = None
) -> tuple[pd.DataFrame, np.ndarray]:
    """Let a hand lead the arm, from its ready posture or from given joints.

    Returns
    -------
    log : pandas.DataFrame
        One row a cycle: ``time_s``, ``joint_1_deg`` ... before it, ``status``, ``clearance_mm``,
        ``singular_value``, ``damping``, ``fastest_pct`` (of a joint, of its greatest speed),
        ``deviation_mm``.
    poses : (n + 1, 3) or (n + 1, 6) array
        mm and rad.
    """
    arm, cycle_s = control.arm, control.cycle_s
    q, rows = np.array(arm.ready if joints_deg is None else np.deg2rad(joints_deg), dtype=float), []
    poses = [control.pose(q)]
    for k in range(round(seconds / cycle_s)):
        answer = control.step(q, np.asarray(hand.desired(k * cycle_s, poses[-1])) * cycle_s)
        rows.append(
            {
                "time_s": k * cycle_s,
                **{f"joint_{i + 1}_deg": value for i, value in enumerate(np.rad2deg(q))},
                "status": answer.step.status,
                "clearance_mm": answer.step.clearance,
                "singular_value": answer.singular_value,
                "damping": answer.damping,
                "fastest_pct": 100 * float(np.abs(answer.turns / (arm.speeds * cycle_s)).max()),
                "deviation_mm": answer.deviation_mm,
            }
        )
        q = q + answer.turns
        poses.append(control.pose(q))
    return pd.DataFrame(rows), np.array(poses)


def stretching_hand(control: ArmController, speed_mm_s: float = 30.0) -> Hand:
    """A hand that pulls the tool straight away from the arm's foot until the arm is stretched."""
    foot = control.held.T_mesh_rob[:3, 3]

    class Pull:
        def desired(self, time_s: float, pose: np.ndarray) -> np.ndarray:
            away = pose[:3] - foot
            out = np.zeros(len(pose))
            out[:3] = speed_mm_s * away / np.linalg.norm(away)
            return out

    return Pull()


def stretch_runs(
    control: Controller, start: np.ndarray, upright: np.ndarray, speeds: Sequence[float], seconds: float
) -> tuple[dict[float, pd.DataFrame], pd.DataFrame]:
    """Pull a nearly stretched arm away from its foot, at several speeds, far from any surface.

    Parameters
    ----------
    control : Controller
        Its fixtures and tool are taken; its longest motion is that of the speed.
    start, upright : (3,) arrays
        As `arm_holding`.
    speeds : sequence of float
        mm/s.
    seconds : float

    Returns
    -------
    logs : dict of float to pandas.DataFrame
        As `arm_run`, one a speed.
    table : pandas.DataFrame
        One row a speed: the least singular value, the greatest damping, the fastest joint in its greatest
        speed, in all and in the last quarter of the time.
    """
    logs, rows = {}, []
    for speed in speeds:
        loose = arm_holding(control, start, upright)
        own = Controller(control.fixtures, control.tool, max_step=speed * loose.cycle_s)
        arm = arm_holding(own, start, upright)
        logs[speed], _ = arm_run(arm, stretching_hand(arm, speed), seconds, NEARLY_STRETCHED)
        log = logs[speed]
        rows.append(
            {
                "pull_mm_s": speed,
                "least_singular_value": log["singular_value"].min(),
                "greatest_damping": log["damping"].max(),
                "fastest_joint_pct": log["fastest_pct"].max(),
                "fastest_in_the_end_pct": log["fastest_pct"].tail(len(log) // 4).max(),
            }
        )
    return logs, pd.DataFrame(rows)
