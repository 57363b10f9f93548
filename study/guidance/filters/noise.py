"""Noise of a tracker, as read off a marker that does not move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from study.errors import InputError
from study.guidance.frames import checked_transforms

#: Readings below which a standard deviation is not worth its name: 20 % uncertain.
_LEAST = 12


@dataclass(frozen=True)
class PoseNoise:
    """Standard deviations of one measured pose, along and about the axes of the frame that poses lead to.

    Attributes
    ----------
    position_mm : (3,) tuple
    rotation_rad : (3,) tuple
        Of small rotation vectors.

    Raises
    ------
    InputError
        If a number is negative or not finite.
    """

    position_mm: tuple[float, float, float]
    rotation_rad: tuple[float, float, float]

    def __post_init__(self) -> None:
        for name in ("position_mm", "rotation_rad"):
            value = np.array(getattr(self, name), dtype=float)
            if value.shape != (3,) or not np.isfinite(value).all() or (value < 0).any():
                raise InputError(f"{name}: expected three numbers of at least 0, got {getattr(self, name)!r}")
            object.__setattr__(self, name, tuple(value.tolist()))

    @property
    def distance_mm(self) -> float:
        """Root mean squared 3-D distance of a measured position from the true one."""
        return float(np.linalg.norm(self.position_mm))

    @property
    def angle_rad(self) -> float:
        """Root mean squared angle of a measured orientation from the true one."""
        return float(np.linalg.norm(self.rotation_rad))


def measured_noise(poses: ArrayLike) -> PoseNoise:
    """Noise of a tracker from a recording of something at rest (5.3: "noise readings").

    Parameters
    ----------
    poses : (n, 4, 4) array
        Samples, mm; n of 12 or more. Held ones, repeated between samples, would count twice.

    Returns
    -------
    PoseNoise

    Raises
    ------
    InputError
        If there are too few, one is not rigid, or orientations are half a turn apart: nothing at rest.
    """
    T = checked_transforms("poses", poses)
    if len(T) < _LEAST:
        raise InputError(f"poses: expected {_LEAST} or more samples, got {len(T)}")
    turns = Rotation.from_matrix(T[:, :3, :3])
    small = (turns * turns.mean().inv()).as_rotvec()
    if np.abs(small).max() > 0.5:
        raise InputError(
            "poses: expected something at rest, got orientations up to "
            f"{np.degrees(np.linalg.norm(small, axis=1).max()):.0f} degrees from their mean"
        )
    return PoseNoise(tuple(T[:, :3, 3].std(axis=0, ddof=1)), tuple(small.std(axis=0, ddof=1)))
