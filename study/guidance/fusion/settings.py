"""What the fusion is told: its step, the tracker's delay, and how far to trust model and measurements."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from study.errors import InputError
from study.guidance.filters.noise import PoseNoise
from study.guidance.fusion.model import checked_lags, lags_of

ORIENTATIONS = ("error_state", "euler")


@dataclass(frozen=True)
class FusionSettings:
    """Settings of `PoseFusion` (Baron, section 5.3). All noise is given as standard deviations.

    The text takes the measurement noise from readings of the tracker (`with_noise`) and the process noise
    by trial, smaller than the measurement's; it prints no value of either.

    Attributes
    ----------
    sample_s : float
        T, s; printed.
    lags : int
        Steps by which the tracker is late; printed: 2, 40 ms. See `lags_of`.
    position_mm, rotation_rad : (3,) tuple
        Of one measured pose along, and about, the axes of the frame that poses lead to. The defaults are a
        tip 180 mm away from a marker of 80 mm.
    velocity_mm_s, velocity_rad_s : float
        Of the velocity from the encoders, along or about any axis: their resolution.
    process_position_mm, process_rotation_rad : float
        What the model misses of the motion in one step: arms that move by a few parts in a thousand more or
        less than they tell, and velocities that come a cycle late.
    process_velocity_mm_s, process_velocity_rad_s : float
        By how much the velocity changes in one step: 200 mm/s^2 make 4 mm/s in 0.02 s.
    orientation : {"error_state", "euler"}
        Small rotations from a quaternion, or as printed: Euler angles, yaw about z, pitch about the new y,
        roll about the new x (scipy's ``"ZYX"``), unwrapped. At a pitch of 90 degrees those fail.
    gate : float
        Chi-squared probability, 3 degrees of freedom: a measured position, or orientation, that lies
        outside of it is not used. 0 for no gate.

    Raises
    ------
    InputError
        If a value has no meaning.
    """

    sample_s: float = 0.02
    lags: int = 2
    position_mm: tuple[float, float, float] = (0.1, 0.1, 0.1)
    rotation_rad: tuple[float, float, float] = (0.001, 0.001, 0.001)
    velocity_mm_s: float = 0.1
    velocity_rad_s: float = 0.001
    process_position_mm: float = 0.05
    process_velocity_mm_s: float = 4.0
    process_rotation_rad: float = 0.0005
    process_velocity_rad_s: float = 0.04
    orientation: str = "error_state"
    gate: float = 0.0

    def __post_init__(self) -> None:
        lags_of(0.0, self.sample_s)
        object.__setattr__(self, "lags", checked_lags(self.lags))
        for name in ("position_mm", "rotation_rad"):
            value = np.array(getattr(self, name), dtype=float)
            if value.shape != (3,) or not np.isfinite(value).all() or (value <= 0).any():
                raise InputError(f"{name}: expected three numbers above 0, got {getattr(self, name)!r}")
            object.__setattr__(self, name, tuple(value.tolist()))
        for name in ("velocity_mm_s", "velocity_rad_s"):
            value = getattr(self, name)
            if not np.isfinite(value) or value <= 0:
                raise InputError(f"{name}: expected more than 0, got {value!r}")
        for name in ("position_mm", "velocity_mm_s", "rotation_rad", "velocity_rad_s"):
            value = getattr(self, f"process_{name}")
            if not np.isfinite(value) or value < 0:
                raise InputError(f"process_{name}: expected at least 0, got {value!r}")
        if self.orientation not in ORIENTATIONS:
            raise InputError(
                f"orientation: expected one of {', '.join(ORIENTATIONS)}, got {self.orientation!r}"
            )
        if not 0 <= self.gate < 1:
            raise InputError(f"gate: expected a probability of at least 0 and below 1, got {self.gate!r}")

    def with_noise(self, noise: PoseNoise) -> FusionSettings:
        """The same with the tracker's noise as read off poses at rest (`measured_noise`).

        Raises
        ------
        InputError
            If there was none along an axis.
        """
        return replace(self, position_mm=noise.position_mm, rotation_rad=noise.rotation_rad)

    @property
    def largest_nis(self) -> float:
        """Normalised innovation squared that the gate lets pass; inf without a gate."""
        return float(chi2.ppf(self.gate, 3)) if self.gate else np.inf

    @property
    def r_position(self) -> np.ndarray:
        """(3,) mm^2."""
        return np.square(self.position_mm)

    @property
    def r_rotation(self) -> np.ndarray:
        """(3,) rad^2."""
        return np.square(self.rotation_rad)

    @property
    def r_velocity(self) -> np.ndarray:
        """(2,) variances of the measured velocity, (mm/s)^2 and (rad/s)^2."""
        return np.square([self.velocity_mm_s, self.velocity_rad_s])

    @property
    def process(self) -> np.ndarray:
        """(2, 2) variances of a step: of position and velocity, then rotation and angular velocity."""
        return np.square(
            [
                [self.process_position_mm, self.process_velocity_mm_s],
                [self.process_rotation_rad, self.process_velocity_rad_s],
            ]
        )

    def first_covariances(self) -> tuple[np.ndarray, np.ndarray]:
        """(3, n, n) covariances of position and rotation when all that is known is one measured pose.

        It is `lags` steps old; since then the velocity has been anything within a step's change of 0.
        """
        # What the unknown velocity adds to each state, newest position first.
        growth = np.append(np.arange(self.lags, -1, -1) * self.sample_s, 1.0)
        known = np.append(np.ones(self.lags + 1), 0.0)
        return tuple(
            r[:, None, None] * np.outer(known, known) + (velocity + process[1]) * np.outer(growth, growth)
            for r, velocity, process in zip(
                (self.r_position, self.r_rotation), self.r_velocity, self.process, strict=True
            )
        )
