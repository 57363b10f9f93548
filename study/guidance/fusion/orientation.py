"""The orientation's filter in two forms: small rotations from a quaternion, and Euler angles as printed."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from study.guidance.fusion import _kernels
from study.guidance.fusion.model import workspace
from study.guidance.fusion.settings import FusionSettings

#: Yaw about z, then pitch about the new y, then roll about the new x (scipy: capital letters).
SEQUENCE = "ZYX"


class ErrorStateFusion:
    """Quaternions of the last steps, and the covariance of small rotations from them."""

    def __init__(self, settings: FusionSettings, R0: np.ndarray) -> None:
        self._q = np.tile(_quaternion(R0), (settings.lags + 1, 1))
        self.velocity = np.zeros(3)
        self.covariances = settings.first_covariances()[1]
        self._work = workspace(settings.lags)
        self._constants = _constants(settings)
        self._gate = settings.largest_nis

    def run(self, R: np.ndarray, velocity: np.ndarray, fresh: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotations (n, 3, 3) after each step, and NIS (n,) of 3 degrees of freedom, -1 if not fresh."""
        nis, out = np.empty(len(fresh)), np.empty((len(fresh), 4))
        _kernels.fuse_orientations(
            self._q, self.velocity, self.covariances, *self._constants,
            _quaternion(R), velocity, fresh, self._gate, self._work, nis, out,
        )  # fmt: skip
        return Rotation.from_quat(out, scalar_first=True).as_matrix(), nis

    @property
    def matrix(self) -> np.ndarray:
        """(3, 3) rotation of now."""
        return Rotation.from_quat(self._q[0], scalar_first=True).as_matrix()


class EulerFusion:
    """The position's filter once more, its states the Euler angles of the last steps and their rates.

    The angular velocity is turned into rates at the present angles. Near a pitch of 90 degrees yaw and roll
    become one: noise of the measured angles and rates grow without bound there, and the filter, whose noise
    stays as set, follows them.
    """

    def __init__(self, settings: FusionSettings, R0: np.ndarray) -> None:
        self._x = np.zeros((3, settings.lags + 2))
        self._x[:, :-1] = angles_near(R0, np.zeros(3))[:, None]
        self.covariances = settings.first_covariances()[1]
        self._work = workspace(settings.lags)
        self._constants = _constants(settings)
        self._gate = settings.largest_nis

    def run(self, R: np.ndarray, velocity: np.ndarray, fresh: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotations (n, 3, 3) after each step, and NIS (n,) of 3 degrees of freedom, -1 if not fresh."""
        nis, out = np.empty(len(fresh)), np.empty((len(fresh), 3))
        for k in range(len(fresh)):
            # The late pose will be compared with the state that the prediction makes the oldest.
            angles = angles_near(R[k], self._x[:, max(self._x.shape[1] - 3, 0)])
            rates = rates_of_velocity(self._x[:, 0], velocity[k])
            _kernels.fuse_positions(
                self._x, self.covariances, *self._constants,
                angles[None], rates[None], fresh[k : k + 1], self._gate, self._work, nis[k:], out[k:],
            )  # fmt: skip
        return Rotation.from_euler(SEQUENCE, out).as_matrix(), nis

    @property
    def matrix(self) -> np.ndarray:
        """(3, 3) rotation of now."""
        return Rotation.from_euler(SEQUENCE, self._x[:, 0]).as_matrix()

    @property
    def velocity(self) -> np.ndarray:
        """(3,) angular velocity of now, rad/s."""
        return velocity_of_rates(self._x[:, 0]) @ self._x[:, -1]


def _quaternion(R: np.ndarray) -> np.ndarray:
    return Rotation.from_matrix(R).as_quat(scalar_first=True)


def _constants(settings: FusionSettings) -> tuple:
    return settings.sample_s, settings.process[1], settings.r_rotation, float(settings.r_velocity[1])


def angles_near(R: np.ndarray, near: np.ndarray) -> np.ndarray:
    """(3,) Euler angles of a rotation matrix, unwrapped: each within half a turn of the given ones, rad."""
    angles = Rotation.from_matrix(R).as_euler(SEQUENCE, suppress_warnings=True)
    return angles + 2.0 * np.pi * np.round((near - angles) / (2.0 * np.pi))


def velocity_of_rates(angles: np.ndarray) -> np.ndarray:
    """(3, 3) matrix from rates of the angles to the angular velocity in the fixed axes, rad/s.

    Its columns are the axes about which the angles turn; at a pitch of 90 degrees two of them are parallel.
    """
    yaw, pitch, _ = angles
    return np.array(
        [
            [0.0, -np.sin(yaw), np.cos(yaw) * np.cos(pitch)],
            [0.0, np.cos(yaw), np.sin(yaw) * np.cos(pitch)],
            [1.0, 0.0, -np.sin(pitch)],
        ]
    )


def rates_of_velocity(angles: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """(3,) rates of the angles at an angular velocity, rad/s; the smallest where many would do."""
    return np.linalg.lstsq(velocity_of_rates(angles), velocity, rcond=1e-12)[0]
