"""The patient's filter: heavy at rest, light when the patient moves (Baron, section 5.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from study.errors import InputError
from study.guidance.filters._kernels import filter_one
from study.guidance.filters.noise import PoseNoise
from study.guidance.frames import checked_transform, from_pose, pose_of


def new_sample_weight_of_position(alpha: float) -> float:
    """Weight of the new sample in equation 7: ``x = alpha x_before + (1 - alpha) x_new``.

    The printed 0.9 (static) and 0.05 (moving) are weights of 0.1 and 0.95.

    Raises
    ------
    InputError
        If alpha is not between 0 and 1.
    """
    return 1.0 - _checked_alpha(alpha)


def new_sample_weight_of_orientation(alpha: float) -> float:
    """Weight of the new sample in equation 9: SLERP from the filtered orientation with ``t = alpha``.

    A high alpha filters lightly here, the text says. The values are printed once more, in the same order and
    without telling which is which; a filter that is heavy at rest takes 0.05 static and 0.9 moving.

    Raises
    ------
    InputError
        If alpha is not between 0 and 1.
    """
    return _checked_alpha(alpha)


def _checked_alpha(alpha: float) -> float:
    if not np.isfinite(alpha) or not 0 <= alpha <= 1:
        raise InputError(f"alpha: expected a number from 0 to 1, got {alpha!r}")
    return float(alpha)


@dataclass(frozen=True)
class PatientFilterSettings:
    """Settings of `PatientFilter`, in weights of the new sample: small ones filter heavily.

    Attributes
    ----------
    position_static, position_moving, orientation_static, orientation_moving : float
        Above 0, at most 1; the printed values, both conventions mapped to this one.
    threshold : float
        The patient moves when a sample is farther from the last filtered pose than this many times the
        tracker's noise, root mean squared distance or angle. Not printed. At 4 a tracker three times as noisy
        in depth as across takes rest for motion twice in a hundred thousand samples.

    Raises
    ------
    InputError
        If a weight or the threshold has no meaning.
    """

    position_static: float = new_sample_weight_of_position(0.9)
    position_moving: float = new_sample_weight_of_position(0.05)
    orientation_static: float = new_sample_weight_of_orientation(0.05)
    orientation_moving: float = new_sample_weight_of_orientation(0.9)
    threshold: float = 4.0

    def __post_init__(self) -> None:
        for name in ("position_static", "position_moving", "orientation_static", "orientation_moving"):
            value = getattr(self, name)
            if not np.isfinite(value) or not 0 < value <= 1:
                raise InputError(f"{name}: expected a weight above 0 and at most 1, got {value!r}")
        if not np.isfinite(self.threshold) or self.threshold <= 0:
            raise InputError(f"threshold: expected more than 0, got {self.threshold!r}")

    @property
    def weights(self) -> np.ndarray:
        """(4,) as the kernel takes them: position static, moving, orientation static, moving."""
        return np.array(
            [self.position_static, self.position_moving, self.orientation_static, self.orientation_moving]
        )

    def thresholds(self, noise: PoseNoise) -> np.ndarray:
        """(2,) mm and rad from the filtered pose beyond which the patient moves."""
        return self.threshold * np.array([noise.distance_mm, noise.angle_rad])


class PatientFilter:
    """Low-pass of a patient's pose, equations 7 to 9, that lets motion through.

    Parameters
    ----------
    settings : PatientFilterSettings
    noise : PoseNoise
        Of the tracker (`measured_noise`).
    T0 : (4, 4) array, optional
        Pose to begin with, mm; without it the first sample's.

    Attributes
    ----------
    settings : PatientFilterSettings
    thresholds : (2,) array
        mm and rad.
    moving : bool
        Whether the last sample was taken for motion.

    Raises
    ------
    InputError
        If the pose is not rigid.
    """

    def __init__(
        self, settings: PatientFilterSettings, noise: PoseNoise, T0: ArrayLike | None = None
    ) -> None:
        self.settings = settings
        self.thresholds = settings.thresholds(noise)
        self.moving = False
        self._weights = settings.weights
        self._pose = None if T0 is None else pose_of(checked_transform("T0", T0))

    def step(self, T: ArrayLike) -> np.ndarray:
        """Filter one sample.

        Parameters
        ----------
        T : (4, 4) array
            Measured pose, mm.

        Returns
        -------
        (4, 4) array
            Filtered pose, mm.

        Raises
        ------
        InputError
            If it is not rigid; the filter is as before.
        """
        position, quaternion = pose_of(checked_transform("T", T))
        if self._pose is None:
            self._pose = position.copy(), quaternion.copy()
        self.moving = bool(filter_one(*self._pose, position, quaternion, self._weights, self.thresholds))
        return self.pose

    @property
    def pose(self) -> np.ndarray:
        """(4, 4) filtered pose, mm.

        Raises
        ------
        InputError
            If there was no sample yet.
        """
        if self._pose is None:
            raise InputError("pose: expected at least one sample before")
        position, quaternion = self._pose
        return from_pose(position, quaternion)
