"""What a robot at rest reads of its own noise."""

from __future__ import annotations

import numpy as np

from study.guidance.loop.settings import LoopSettings
from study.guidance.setting_up import SetUp
from study.registration.first_order import cross_matrices

#: A variance that a fusion can still divide by, where a simulation has no noise; mm^2 or rad^2.
_NOISELESS = 1e-12


def noise_readings(
    ready: SetUp, settings: LoopSettings, T_cam_markers: np.ndarray, covariances: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Variances for the fusion, thresholds for the filters, from the noise of a robot at rest.

    The text computes the fusion's measurement noise from such readings (section 5.3). Of the base's
    marker, filtered like the patient's, only the share of noise that is left counts.

    Parameters
    ----------
    ready : SetUp
    settings : LoopSettings
    T_cam_markers : (3, 4, 4) array
        Poses of the drill's, the base's and the patient's marker.
    covariances : (3, 6, 6) array
        Of their noise: rotation vector first, then translation, camera axes.

    Returns
    -------
    measurement : (4, 3) array
        Variances of position, velocity, rotation and angular velocity of the tip, axes of the robot's base.
    thresholds : (2, 2) array
        Distance (mm) and angle (rad) beyond which the base's and the patient's marker count as moving.
    """
    R_rob_cam = ready.scene.T_rob_cam[:3, :3]
    tip = (T_cam_markers[0] @ ready.T_tool_tcp)[:3, 3]
    left = settings.static_weight / (2.0 - settings.static_weight)
    total = np.zeros((6, 6))
    for marker, share in ((0, 1.0), (1, left)):
        to_tip = np.eye(6)
        to_tip[3:, :3] = -cross_matrices((tip - T_cam_markers[marker, :3, 3])[None])[0]
        total += share * to_tip @ covariances[marker] @ to_tip.T
    rotation, translation = (R_rob_cam @ part @ R_rob_cam.T for part in (total[:3, :3], total[3:, 3:]))
    rounding = ready.system.tracker_quantum_mm**2 / 12.0
    measurement = np.stack(
        [
            np.diag(translation) + rounding + _NOISELESS,
            np.full(3, settings.velocity_std_mm_s**2),
            np.diag(rotation) + _NOISELESS,
            np.full(3, settings.spin_std_rad_s**2),
        ]
    )
    traces = (
        np.trace(covariances[1:, 3:, 3:], axis1=1, axis2=2),
        np.trace(covariances[1:, :3, :3], axis1=1, axis2=2),
    )
    return measurement, settings.moving_stds * np.sqrt(
        np.column_stack([traces[0] + 3.0 * rounding, traces[1]])
    )
