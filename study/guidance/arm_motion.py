"""What an arm as it was built makes of commands that are meant for the arm on paper."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from study.guidance.systems import GuidedSystem
from study.registration.first_order import cross_matrices
from study.robots.arms import ArmErrors, SixAxisArm, arm, differential_gain

#: A repeatability is printed as mean plus three standard deviations of a 3-D distance (ISO 9283): with
#: normal errors so many of an axis' standard deviations.
REPEATABILITY_STDS = float(np.sqrt(8.0 / np.pi) + 3.0 * np.sqrt(3.0 - 8.0 / np.pi))


def built_arm(system: GuidedSystem, rng: np.random.Generator) -> SixAxisArm:
    """The system's arm as it was built, with joint zeros, links and axes a little off."""
    errors = ArmErrors(system.joint_bias_mrad * 1e-3, system.link_error_mm, system.axis_error_mrad * 1e-3)
    return errors.built(arm(system.arm), rng)


@lru_cache(maxsize=4096)
def _angles(name: str, pose: bytes) -> np.ndarray:
    return arm(name).inverse(np.frombuffer(pose).reshape(4, 4))


def nominal_angles(name: str, T_rob_ee: np.ndarray) -> np.ndarray:
    """(6,) joint angles of the arm on paper at a pose, kept: every experiment drills the same holes.

    Raises
    ------
    ReachError
        If it cannot take the pose.
    """
    return _angles(name, np.ascontiguousarray(T_rob_ee).tobytes())


def twist_gain(
    built: SixAxisArm, T_rob_ee: np.ndarray, T_ee_tcp: np.ndarray, believed_T_ee_tcp: np.ndarray
) -> np.ndarray:
    """(6, 6) twist of the tip that the arm makes over the one it is told, linear first, base axes.

    The control box turns a twist into joint speeds by the arm on paper and the believed lever; the arm as
    built makes another twist of them. It is near the unit matrix, which is why differential commands need no
    calibrated arm (Baron, section 3.1).

    Parameters
    ----------
    built : SixAxisArm
    T_rob_ee : (4, 4) array
        Pose at which it is wanted.
    T_ee_tcp, believed_T_ee_tcp : (4, 4) arrays
        Of the drill on the arm, true and by calibration.
    """
    q = nominal_angles(built.name, T_rob_ee)
    R = T_rob_ee[:3, :3]
    out, back = np.eye(6), np.eye(6)
    out[:3, 3:] = -cross_matrices((R @ T_ee_tcp[:3, 3])[None])[0]
    back[:3, 3:] = cross_matrices((R @ believed_T_ee_tcp[:3, 3])[None])[0]
    return np.ascontiguousarray(out @ differential_gain(arm(built.name), built, q) @ back)
