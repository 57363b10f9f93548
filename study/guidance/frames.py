"""Frames of the guided robot, and the transforms between them (Baron, section 4, figure 3).

``T_to_from`` maps coordinates in frame ``from`` to frame ``to``: a (4, 4) rigid transform, mm, so that
neighbouring names cancel in a product, ``T_cam_tool @ T_tool_tcp = T_cam_tcp``. Frames are

| name | rigidly fixed to |
|---|---|
| cam | the optical tracker's camera |
| rob | the robot's base, and the marker on it |
| ee | the robot's end effector |
| tool | the marker on the drill |
| tcp | the drill: origin at the tip (tool centre point), z along the bit from the body to the tip |
| pat | the marker on the patient, or on the phantom |
| img | the image in which the trajectory was planned |

Quaternions have their scalar part first, [q0, qx, qy, qz], as the paper prints them (equation 1); this
module is the only place that meets scipy, whose order is the other.
"""

from __future__ import annotations

from collections import deque
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from study.errors import InputError
from study.registration.sources import checked_vector
from study.transforms import RIGID, checked_transform, checked_transforms, inverse, moved, rigid

__all__ = [
    "FrameGraph",
    "actual_tcp",
    "checked_quaternion",
    "checked_transform",
    "checked_transforms",
    "desired_tcp",
    "difference",
    "from_pose",
    "inverse",
    "moved",
    "pose_of",
    "quaternions",
    "rigid",
]


def checked_quaternion(name: str, quaternion: ArrayLike) -> np.ndarray:
    """(4,) unit quaternion, scalar part first and not negative.

    Raises
    ------
    InputError
        If it is not of four finite numbers and unit length.
    """
    q = np.array(quaternion, dtype=float)
    if q.shape != (4,) or not np.isfinite(q).all():
        raise InputError(f"{name}: expected four finite numbers q0, qx, qy, qz, got {q.tolist()}")
    length = float(np.linalg.norm(q))
    if abs(length - 1.0) > RIGID:
        raise InputError(
            f"{name}: expected a unit quaternion q0, qx, qy, qz, got length {length:.6g}: {q.tolist()}"
        )
    return q / (length if q[0] >= 0 else -length)


def from_pose(position: ArrayLike, quaternion: ArrayLike) -> np.ndarray:
    """(4, 4) transform of a measured pose (Baron, equations 1 and 2).

    Parameters
    ----------
    position : (3,) array
        mm.
    quaternion : (4,) array
        q0, qx, qy, qz of unit length.

    Raises
    ------
    InputError
        If the quaternion's length is not 1 or a number is not finite.
    """
    q = checked_quaternion("quaternion", quaternion)
    return rigid(Rotation.from_quat(q[[1, 2, 3, 0]]), checked_vector("position", position, "mm"))


def quaternions(transforms: np.ndarray) -> np.ndarray:
    """(..., 4) unit quaternions q0, qx, qy, qz of rigid transforms, q0 not negative."""
    last = Rotation.from_matrix(transforms[..., :3, :3]).as_quat(canonical=True)
    return last[..., [3, 0, 1, 2]]


def pose_of(transform: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) in mm and quaternion (4,) of a rigid transform; the inverse of `from_pose`."""
    return transform[..., :3, 3].copy(), quaternions(transform)


def difference(actual: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far poses of one frame lie from others: rotation vectors (..., 3) in rad, distances (..., 3) in mm.

    Both in the axes of the frame that the transforms lead to: ``actual = wanted`` turned, then shifted.
    """
    turn = Rotation.from_matrix(actual[..., :3, :3] @ np.swapaxes(wanted[..., :3, :3], -1, -2))
    return turn.as_rotvec(), actual[..., :3, 3] - wanted[..., :3, 3]


def actual_tcp(T_cam_rob: np.ndarray, T_cam_tool: np.ndarray, T_tool_tcp: np.ndarray) -> np.ndarray:
    """T_rob_tcp, where the drill is: equation 5, missing in our copy of the text, from the frames.

    ``T_rob_tcp = T_cam_rob^-1 T_cam_tool T_tool_tcp``: both markers are measured, the calibration is fixed.
    """
    return inverse(T_cam_rob) @ T_cam_tool @ T_tool_tcp


def desired_tcp(
    T_cam_rob: np.ndarray, T_cam_pat: np.ndarray, T_pat_img: np.ndarray, T_img_tcp: np.ndarray
) -> np.ndarray:
    """T_rob_tcp, where the drill should be: equation 6, missing in our copy of the text, from the frames.

    ``T_rob_tcp,des = T_cam_rob^-1 T_cam_pat T_pat_img T_img_tcp,des``: T_pat_img is the registration, the
    last factor the plan. The text's registration section names the inverse, T_img_pat.
    """
    return inverse(T_cam_rob) @ T_cam_pat @ T_pat_img @ T_img_tcp


class FrameGraph:
    """Frames and the transforms known between them; any other follows from those on the way.

    Examples
    --------
    >>> frames = FrameGraph()
    >>> frames.add("cam", "rob", rigid(translation=[0, 0, 1500]))
    >>> frames.add("rob", "ee", rigid(translation=[450, 0, 300]))
    >>> frames.transform("cam", "ee")[:3, 3].tolist()
    [450.0, 0.0, 1800.0]
    """

    def __init__(self) -> None:
        self._known: dict[str, dict[str, np.ndarray]] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Frames, in the order of their first mention."""
        return tuple(self._known)

    def add(self, to: str, frm: str, transform: ArrayLike) -> None:
        """Say, or say anew, how two frames lie to each other.

        Parameters
        ----------
        to, frm : str
            Frames.
        transform : (4, 4) array
            ``T_to_from``, mm.

        Raises
        ------
        InputError
            If it is not rigid, both names are the same, or other transforms already say it.
        """
        T = checked_transform(f"T_{to}_{frm}", transform)
        if to == frm:
            raise InputError(f"T_{to}_{frm}: expected two different frames")
        if frm not in self._known.get(to, {}) and self._way(to, frm) is not None:
            raise InputError(f"T_{to}_{frm}: already follows from others: {' - '.join(self._way(to, frm))}")
        self._known.setdefault(to, {})[frm] = T
        self._known.setdefault(frm, {})[to] = inverse(T)

    def transform(self, to: str, frm: str) -> np.ndarray:
        """(4, 4) ``T_to_from``, mm.

        Raises
        ------
        InputError
            If a frame is unknown or nothing connects the two.
        """
        for name in (to, frm):
            if name not in self._known:
                raise InputError(f"frame {name!r}: expected one of {', '.join(self._known) or 'none yet'}")
        way = self._way(to, frm)
        if way is None:
            raise InputError(f"T_{to}_{frm}: no known transforms connect the two frames")
        T = np.eye(4)
        for here, there in pairwise(way):
            T = T @ self._known[here][there]
        return T

    def _way(self, start: str, end: str) -> list[str] | None:
        """Frames from one to another, both included; None when not connected."""
        before: dict[str, str] = {start: start}
        waiting = deque([start])
        while waiting and end not in before:
            here = waiting.popleft()
            for there in self._known.get(here, {}):
                if there not in before:
                    before[there] = here
                    waiting.append(there)
        if end not in before:
            return None
        way = [end]
        while way[-1] != start:
            way.append(before[way[-1]])
        return way[::-1]
