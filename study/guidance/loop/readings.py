"""What a robot at rest reads of its own noise."""

from __future__ import annotations

import numpy as np

from study.guidance.filters import PatientFilterSettings, PoseNoise
from study.guidance.setting_up import SetUp
from study.registration.first_order import cross_matrices

#: Noise that a fusion can still divide by, where a simulation has none; mm or rad.
_NOISELESS = 1e-6


def marker_noise(ready: SetUp, covariance: np.ndarray) -> PoseNoise:
    """Noise of a marker at rest, camera axes: its (6, 6) covariance, rotation vector first, and rounding."""
    rounding = ready.system.tracker_quantum_mm**2 / 12.0
    variances = np.diag(covariance)
    return PoseNoise(tuple(np.sqrt(variances[3:] + rounding)), tuple(np.sqrt(variances[:3])))


def tip_noise(
    ready: SetUp, patient: PatientFilterSettings, T_cam_markers: np.ndarray, covariances: np.ndarray
) -> PoseNoise:
    """Noise of the tip's pose at rest as the robot sees it, axes of its base.

    The text computes the fusion's measurement noise from such readings (section 5.3). Of the base's
    marker, filtered like the patient's, only the share of noise that is left counts.

    Parameters
    ----------
    ready : SetUp
    patient : PatientFilterSettings
    T_cam_markers : (2, 4, 4) array
        Poses of the drill's and the base's marker.
    covariances : (2, 6, 6) array
        Of their noise: rotation vector first, then translation, camera axes.
    """
    R_rob_cam = ready.scene.T_rob_cam[:3, :3]
    tip = (T_cam_markers[0] @ ready.T_tool_tcp)[:3, 3]
    left = patient.position_static / (2.0 - patient.position_static)
    total = np.zeros((6, 6))
    for marker, share in ((0, 1.0), (1, left)):
        to_tip = np.eye(6)
        to_tip[3:, :3] = -cross_matrices((tip - T_cam_markers[marker, :3, 3])[None])[0]
        total += share * to_tip @ covariances[marker] @ to_tip.T
    rotation, translation = (
        np.diag(R_rob_cam @ part @ R_rob_cam.T) for part in (total[:3, :3], total[3:, 3:])
    )
    rounding = ready.system.tracker_quantum_mm**2 / 12.0
    return PoseNoise(
        tuple(np.maximum(np.sqrt(translation + rounding), _NOISELESS)),
        tuple(np.maximum(np.sqrt(rotation), _NOISELESS)),
    )
