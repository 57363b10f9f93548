"""How the guided robot is run."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from study.errors import InputError
from study.guidance.control import ControlSettings
from study.guidance.safety import SafetySettings


@dataclass(frozen=True)
class LoopSettings:
    """How the robot is run: filters, fusion, control, guards, and the operator's habits.

    Attributes
    ----------
    control : ControlSettings
    safety : SafetySettings
    sample_s : float
        Of the fusion; printed: 0.02 s (section 5.3).
    static_weight, moving_weight, static_turn_weight, moving_turn_weight : float
        Weight of the new sample in the patient's filter (section 5.2).
    moving_stds : float
        Multiple of the measured noise beyond which the patient counts as moving.
    position_process_mm, velocity_process_mm_s, rotation_process_rad, spin_process_rad_s : float
        Standard deviations that the fusion's model gains in a step.
    velocity_std_mm_s, spin_std_rad_s : float
        Of the velocity by the encoders.
    gate : float
        Chance of refusing a right sample of the tracker; 0 refuses none.
    approach_mm : float
        Distance outside of the entry where the drill finds its line.
    wait_mm : float
        The operator goes on only while the tip is seen this close to its line.
    settle_s, stay_s : float
        Finding the line, at least, and at the end before coming back.
    retraction : float
        Speed of coming back over that of insertion.
    wander_s : float
        Over which the arm's repeatability error changes.
    """

    control: ControlSettings = field(default_factory=ControlSettings)
    safety: SafetySettings = field(default_factory=SafetySettings)
    sample_s: float = 0.02
    static_weight: float = 0.1
    moving_weight: float = 0.95
    static_turn_weight: float = 0.05
    moving_turn_weight: float = 0.9
    moving_stds: float = 5.0
    position_process_mm: float = 0.005
    velocity_process_mm_s: float = 1.0
    rotation_process_rad: float = 2e-5
    spin_process_rad_s: float = 5e-3
    velocity_std_mm_s: float = 0.05
    spin_std_rad_s: float = 2e-4
    gate: float = 1e-6
    approach_mm: float = 10.0
    wait_mm: float = 0.5
    settle_s: float = 2.0
    stay_s: float = 1.0
    retraction: float = 4.0
    wander_s: float = 2.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name in ("control", "safety"):
                continue
            if (
                not np.isfinite(value)
                or value < 0
                or (value == 0 and name not in ("gate", "settle_s", "stay_s"))
            ):
                raise InputError(f"{name}: expected a finite number above 0, got {value!r}")
        for name in ("static_weight", "moving_weight", "static_turn_weight", "moving_turn_weight", "gate"):
            if getattr(self, name) > 1:
                raise InputError(f"{name}: expected at most 1, got {getattr(self, name)!r}")

    @property
    def weights(self) -> np.ndarray:
        """(4,) of the new sample: position when static and moving, orientation when static and moving."""
        return np.array(
            [self.static_weight, self.moving_weight, self.static_turn_weight, self.moving_turn_weight]
        )

    @property
    def process(self) -> np.ndarray:
        """(2, 2) variances a step: of position and velocity, of rotation and angular velocity."""
        position = [self.position_process_mm, self.velocity_process_mm_s]
        return np.square([position, [self.rotation_process_rad, self.spin_process_rad_s]])
