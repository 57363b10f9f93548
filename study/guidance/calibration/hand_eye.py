"""Calibration of the marker on an arm's end effector from known rotations (Baron, section 4.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from study.errors import InputError
from study.guidance.calibration.turns import (
    LEAST_SPREAD,
    checked_spread,
    equations,
    sandwich,
    solve_turned,
)
from study.guidance.frames import rigid
from study.registration.first_order import cross_matrices
from study.transforms import checked_transforms

# Turns by nearly half a revolution have no certain axis.
_HALF_TURN = np.radians(170.0)
# Of the rotations' refinement; two are enough in practice.
_STEPS = 10


@dataclass(frozen=True, eq=False)
class HandEyeCalibration:
    """Where the marker sits on the end effector, and the camera beside the robot.

    Attributes
    ----------
    T_ee_tool, T_rob_cam : (4, 4) arrays
    rotation_residuals : (n, 3) array
        Rotation vectors from the marker's pose as measured to that by the robot, rad, robot's axes.
    translation_residuals : (n, 3) array
        The same of its position, mm.
    covariance : (6, 6) array
        Of a small motion of the tool in the frame of the end effector: rotation vector (rad) first, then
        translation (mm), the end effector's axes. From the residuals, to first order.
    spread : float
        Root mean squared turn of the direction that turned least, rad.
    """

    T_ee_tool: np.ndarray
    T_rob_cam: np.ndarray
    rotation_residuals: np.ndarray
    translation_residuals: np.ndarray
    covariance: np.ndarray
    spread: float

    @property
    def rotation_rms(self) -> float:
        """Root mean squared rotation residual, rad."""
        return float(np.sqrt((self.rotation_residuals**2).sum(axis=1).mean()))

    @property
    def translation_rms(self) -> float:
        """Root mean squared translation residual, mm."""
        return float(np.sqrt((self.translation_residuals**2).sum(axis=1).mean()))


def calibrate_hand_eye(
    T_rob_ee: ArrayLike, T_cam_tool: ArrayLike, least_spread: float = LEAST_SPREAD
) -> HandEyeCalibration:
    """Find ``T_ee_tool`` from poses known to the robot and measured by the tracker at the same time.

    ``T_rob_ee,i T_ee_tool = T_rob_cam T_cam_tool,i``, first the rotations, then the translations by linear
    least squares. The rotations start from relative motions, ``A_ij X = X B_ij``, whose rotation vectors the
    tool's orientation brings onto each other, and are refined on all poses alike.

    Parameters
    ----------
    T_rob_ee : (n, 4, 4) array
        From the robot's joints; three or more, turned about two axes at least.
    T_cam_tool : (n, 4, 4) array
        From the tracker.
    least_spread : float
        Smallest `turn_spread` that is taken, rad.

    Returns
    -------
    HandEyeCalibration

    Raises
    ------
    CalibrationError
        If the poses are too few or turn too little about more than one axis; says how much they do.
    InputError
        If a pose is not rigid or there are not as many of both.
    """
    robot = checked_transforms("T_rob_ee", T_rob_ee)
    camera = checked_transforms("T_cam_tool", T_cam_tool)
    if len(robot) != len(camera):
        raise InputError(f"T_cam_tool: expected {len(robot)} poses like T_rob_ee, got {len(camera)}")
    R = robot[:, :3, :3]
    spread = checked_spread("T_rob_ee", R, least_spread)
    checked_spread("T_cam_tool", camera[:, :3, :3], least_spread)
    tool, cam = _rotations(R, camera[:, :3, :3])
    turn = _rotation_residuals(R, tool, camera[:, :3, :3], cam)
    seen = camera[:, :3, 3] @ cam.T
    t_tool, t_cam = solve_turned(R, seen - robot[:, :3, 3])
    shift = R @ t_tool + robot[:, :3, 3] - seen - t_cam
    return HandEyeCalibration(
        rigid(tool, t_tool), rigid(cam, t_cam), turn, shift, _covariance(R, seen, turn, shift), spread
    )


def _rotations(robot: np.ndarray, camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """R_ee_tool and R_rob_cam, (3, 3) each, that bring the rotations of both closest to each other."""
    first, second = np.triu_indices(len(robot), 1)
    by_robot = Rotation.from_matrix(np.swapaxes(robot[first], 1, 2) @ robot[second]).as_rotvec()
    by_camera = Rotation.from_matrix(np.swapaxes(camera[first], 1, 2) @ camera[second]).as_rotvec()
    certain = np.linalg.norm(by_robot, axis=1) < _HALF_TURN
    if certain.sum() < 2:  # all are far turned: better an uncertain start than none
        certain[:] = True
    tool = Rotation.align_vectors(by_robot[certain], by_camera[certain])[0].as_matrix()
    cam = Rotation.from_matrix(robot @ tool @ np.swapaxes(camera, 1, 2)).mean().as_matrix()
    for _ in range(_STEPS):
        off = _rotation_residuals(robot, tool, camera, cam)
        x, y = solve_turned(robot, -off)
        tool = Rotation.from_rotvec(x).as_matrix() @ tool
        cam = Rotation.from_rotvec(y).as_matrix() @ cam
        if np.abs([x, y]).max() < 1e-12:
            break
    return tool, cam


def _rotation_residuals(
    robot: np.ndarray, tool: np.ndarray, camera: np.ndarray, cam: np.ndarray
) -> np.ndarray:
    """(n, 3) rotation vectors of ``R_rob_ee R_ee_tool (R_rob_cam R_cam_tool)^-1``."""
    return Rotation.from_matrix(robot @ tool @ np.swapaxes(camera, 1, 2) @ cam.T).as_rotvec()


def _covariance(robot: np.ndarray, seen: np.ndarray, turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """(6, 6) of R_ee_tool and t_ee_tool; the translations come after the rotations and carry their error."""
    rows = equations(robot)
    normal = np.einsum("nij,nik->jk", rows, rows)
    slope = np.zeros((12, 12))
    slope[:6, :6] = slope[6:, 6:] = normal
    # A small turn of the camera shifts every position it has seen.
    slope[6:, 3:6] = np.einsum("nij,nik->jk", rows, cross_matrices(seen))
    scores = np.hstack([np.einsum("nij,ni->nj", rows, turn), np.einsum("nij,ni->nj", rows, shift)])
    both = sandwich(slope, scores, 6, 12)
    keep = [0, 1, 2, 6, 7, 8]
    return both[np.ix_(keep, keep)]
