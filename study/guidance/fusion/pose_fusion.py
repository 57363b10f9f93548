"""The fusion as Python calls it; the loop of the virtual experiments calls the same kernels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from study.errors import InputError
from study.guidance.frames import checked_transform, checked_transforms, rigid
from study.guidance.fusion import _kernels
from study.guidance.fusion.model import printed_order, workspace
from study.guidance.fusion.orientation import ErrorStateFusion, EulerFusion
from study.guidance.fusion.settings import FusionSettings


@dataclass(frozen=True)
class Innovation:
    """How a measured pose agreed with what was predicted of it.

    Attributes
    ----------
    position, rotation : float or None
        Normalised innovations squared, of 3 degrees of freedom each; None when nothing was measured.
    accepted : bool
        Whether both were used. A pose of which one is beyond the gate still gives the other.
    """

    position: float | None = None
    rotation: float | None = None
    accepted: bool = False


class PoseFusion:
    """Two Kalman filters of a pose: tracker poses some steps old, velocities of now (equations 10-12).

    Parameters
    ----------
    settings : FusionSettings
    T0 : (4, 4) array
        Pose to begin with, at rest; mm.

    Attributes
    ----------
    settings : FusionSettings

    Raises
    ------
    InputError
        If the pose is not rigid.

    Examples
    --------
    >>> fusion = PoseFusion(FusionSettings(), np.eye(4))
    >>> for k in range(100):
    ...     measured = rigid(translation=[0.4 * (k - 2), 0, 0]) if k % 2 == 0 else None
    ...     innovation = fusion.step([20.0, 0, 0, 0, 0, 0], measured)
    >>> round(float(fusion.pose[0, 3]), 1)  # though the tracker saw 38.4 mm last
    39.6
    """

    def __init__(self, settings: FusionSettings, T0: ArrayLike) -> None:
        T0 = checked_transform("T0", T0)
        self.settings = settings
        self._x = np.zeros((3, settings.lags + 2))
        self._x[:, :-1] = T0[:3, 3, None]
        self._P = settings.first_covariances()[0]
        self._work = workspace(settings.lags)
        self._constants = (
            settings.sample_s, settings.process[0], settings.r_position, float(settings.r_velocity[0]),
        )  # fmt: skip
        self._gate = settings.largest_nis
        form = EulerFusion if settings.orientation == "euler" else ErrorStateFusion
        self._orientation = form(settings, T0[:3, :3])

    def step(self, velocity: ArrayLike, measured: ArrayLike | None = None) -> Innovation:
        """Go on by one step.

        Parameters
        ----------
        velocity : (6,) array
            From the encoders, now: mm/s, then rad/s, in the axes of the frame that poses lead to.
        measured : (4, 4) array, optional
            What the tracker delivered just now: the pose of `lags` steps ago, mm. None if nothing new.

        Raises
        ------
        InputError
            If a number is not finite or the pose not rigid; the state is as before.
        """
        fresh = measured is not None
        T = np.eye(4) if measured is None else np.asarray(measured, dtype=float)
        _, nis = self.run(np.asarray(velocity, dtype=float)[None], T[None], [fresh])
        if not fresh:
            return Innovation()
        position, rotation = nis[0].tolist()
        return Innovation(position, rotation, max(position, rotation) <= self._gate)

    def run(
        self, velocity: ArrayLike, measured: ArrayLike, fresh: ArrayLike
    ) -> tuple[np.ndarray, np.ndarray]:
        """Go on by a record of steps; the same as so many calls of `step`.

        Parameters
        ----------
        velocity : (n, 6) array
            As in `step`.
        measured : (n, 4, 4) array
            Latest pose that the tracker had delivered, mm; looked at only where fresh.
        fresh : (n,) bool array
            Whether it was delivered since the step before.

        Returns
        -------
        (n, 4, 4) array
            Fused poses, mm.
        (m, 2) array
            Normalised innovations squared of the m fresh rows: position, rotation; 3 degrees of freedom each.

        Raises
        ------
        InputError
            If the shapes do not go together, a number is not finite or a fresh pose not rigid; the state is
            as before.
        """
        velocity, T = np.array(velocity, dtype=float), np.array(measured, dtype=float)
        fresh = np.array(fresh, dtype=bool)
        n = len(fresh)
        if velocity.shape != (n, 6) or not np.isfinite(velocity).all():
            raise InputError(
                f"velocity: expected {n} x 6 finite numbers (mm/s, rad/s), got shape {velocity.shape}"
                + ("" if np.isfinite(velocity).all() else " with others among them")
            )
        if T.shape != (n, 4, 4):
            raise InputError(f"measured: expected {n} (4, 4) transforms, got shape {T.shape}")
        checked_transforms("measured", T[fresh])
        T[~fresh] = np.eye(4)
        nis, positions = np.empty(n), np.empty((n, 3))
        _kernels.fuse_positions(
            self._x, self._P, *self._constants, T[:, :3, 3].copy(), velocity[:, :3].copy(), fresh,
            self._gate, self._work, nis, positions,
        )  # fmt: skip
        rotations, turned = self._orientation.run(T[:, :3, :3], velocity[:, 3:].copy(), fresh)
        return rigid(rotations, positions), np.stack([nis, turned], axis=1)[fresh]

    @property
    def pose(self) -> np.ndarray:
        """(4, 4) pose of now, mm."""
        return rigid(self._orientation.matrix, self._x[:, 0])

    @property
    def velocity(self) -> np.ndarray:
        """(6,) mm/s, then rad/s."""
        return np.concatenate([self._x[:, -1], self._orientation.velocity])

    @property
    def state(self) -> np.ndarray:
        """(12,) state of equation 10: p_k, p_k-1, p_k-2 in mm and v_k in mm/s (more for more lags)."""
        return self._x.T.ravel()

    @property
    def covariance(self) -> np.ndarray:
        """(12, 12) covariance of the state, in the printed order."""
        return printed_order(self._P)

    @property
    def rotation_covariance(self) -> np.ndarray:
        """(12, 12) the same of the orientation: small rotations about the fixed axes (rad), then rad/s.

        In the form with Euler angles, of those.
        """
        return printed_order(self._orientation.covariances)
