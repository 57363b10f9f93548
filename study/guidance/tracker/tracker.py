"""An optical tracker that errs as its causes say (Baron, section 3.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from study.errors import InputError
from study.guidance.tracker.markers import MarkerBody
from study.guidance.tracker.settings import TrackerSettings
from study.registration.rigid import checked_points
from study.transforms import checked_transforms


class Tracker:
    """One tracker: its distortion is drawn once and stays, jitter comes anew with every sphere and frame.

    Parameters
    ----------
    settings : TrackerSettings
    rng : anything `numpy.random.default_rng` takes
        Draws the distortion.

    Attributes
    ----------
    settings : TrackerSettings

    Examples
    --------
    >>> tracker = Tracker(TrackerSettings(distortion_mm=0.0, jitter_mm=(0, 0, 0), quantum_mm=0.0), rng=0)
    >>> from study.guidance.tracker import facing_pose
    >>> pose = facing_pose([0.0, 0.0, 1500.0])
    >>> bool(np.allclose(tracker.measured(MarkerBody.plate(), pose[None], rng=0)[0], pose))
    True
    """

    def __init__(self, settings: TrackerSettings | None = None, rng: object = None) -> None:
        self.settings = TrackerSettings() if settings is None else settings
        rng = np.random.default_rng(rng)
        waves = self.settings.waves
        # Waves with normally distributed directions and lengths sum up to a field whose correlation is the
        # normal curve that the settings promise; drawn in full also when their height is 0, so that a tracker
        # without distortion leaves a generator where one with it does.
        self._wave_vectors = rng.standard_normal((3, waves)) / self.settings.distortion_length_mm
        self._phases = rng.uniform(0.0, 2.0 * np.pi, waves)
        heights = rng.standard_normal((waves, 3))
        self._heights = heights * self.settings.distortion_mm * np.sqrt(2.0 / (3.0 * waves))

    def distortion(self, points: ArrayLike) -> np.ndarray:
        """(n, 3) mm: by how much the tracker misplaces (n, 3) points, camera frame; the same in each frame.

        Raises
        ------
        InputError
            If the shape is another or a number is not finite.
        """
        return self._misplaced(checked_points("points", points, least=0))

    def _misplaced(self, points: np.ndarray) -> np.ndarray:
        return np.cos(points @ self._wave_vectors + self._phases) @ self._heights

    def distorted(self, body: MarkerBody, T_cam_body: ArrayLike) -> np.ndarray:
        """Poses as measured with no noise: the body fitted to its misplaced spheres.

        Parameters
        ----------
        body : MarkerBody
        T_cam_body : (n, 4, 4) array
            True poses.

        Returns
        -------
        (n, 4, 4) array

        Raises
        ------
        InputError
            If a pose is not rigid.
        """
        spheres = body.placed(checked_transforms("T_cam_body", T_cam_body))
        return body.fitted(spheres + self._misplaced(spheres))

    def pose_covariance(self, body: MarkerBody, T_cam_body: ArrayLike) -> np.ndarray:
        """Covariance of one sample's white noise, to first order in the jitter.

        Parameters
        ----------
        body : MarkerBody
        T_cam_body : (n, 4, 4) array

        Returns
        -------
        (n, 6, 6) array
            Of the motion from the noiseless to the measured pose: rotation vector (rad) first, then
            translation of the body's origin (mm), both in the camera's axes. Rounding adds ``quantum^2 / 12``
            to each variance of the translation and is not in it.

        Raises
        ------
        InputError
            If a pose is not rigid.
        """
        T = checked_transforms("T_cam_body", T_cam_body)
        R = T[:, :3, :3]
        across = np.swapaxes(R, 1, 2)
        # Jitter in the body's axes; there the fit is the same for every pose.
        jitter = across * np.square(self.settings.jitter_mm) @ R
        parts = body.motion_of_displacements
        sums = np.einsum("mia,mjb->ijab", parts, parts).reshape(36, 9)
        motion = (jitter.reshape(-1, 9) @ sums.T).reshape(-1, 2, 3, 2, 3)
        out = np.empty_like(motion)
        for row in range(2):
            for column in range(2):
                out[:, row, :, column] = R @ motion[:, row, :, column] @ across
        return out.reshape(-1, 6, 6)

    def measured(
        self, body: MarkerBody, T_cam_body: ArrayLike, rng: object = None, samples: int = 1
    ) -> np.ndarray:
        """Poses as the tracker reports them: distorted, with jitter, their position rounded.

        Parameters
        ----------
        body : MarkerBody
        T_cam_body : (n, 4, 4) array
            True poses.
        rng : anything `numpy.random.default_rng` takes
        samples : int
            Frames of a marker at rest that are averaged, to first order in the jitter. Jitter dithers the
            rounding, so that the mean of several is not rounded.

        Returns
        -------
        (n, 4, 4) array

        Raises
        ------
        InputError
            If a pose is not rigid or there is no sample.
        """
        if isinstance(samples, bool) or int(samples) != samples or samples < 1:
            raise InputError(f"samples: expected a whole number of at least 1, got {samples!r}")
        rng = np.random.default_rng(rng)
        spheres = body.placed(checked_transforms("T_cam_body", T_cam_body))
        jitter = rng.standard_normal(spheres.shape) * self.settings.jitter_mm / np.sqrt(samples)
        poses = body.fitted(spheres + self._misplaced(spheres) + jitter)
        return self.rounded(poses) if samples == 1 else poses

    def rounded(self, poses: np.ndarray) -> np.ndarray:
        """The same (n, 4, 4) poses with positions rounded to the settings' quantum."""
        quantum = self.settings.quantum_mm
        if quantum > 0:
            poses = poses.copy()
            poses[:, :3, 3] = np.round(poses[:, :3, 3] / quantum) * quantum
        return poses
