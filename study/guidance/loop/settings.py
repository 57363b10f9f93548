"""How the guided robot is run."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from study.errors import InputError
from study.guidance.control import ControlSettings
from study.guidance.filters import PatientFilterSettings
from study.guidance.fusion import FusionSettings
from study.guidance.safety import SafetySettings


def drilling_fusion() -> FusionSettings:
    """The fusion's settings for drilling, a motion of a millimetre a second that its model meets well.

    The process noise is what repeatability and drives leave in a step at that speed; with it the innovations
    are as large as the fusion expects. The gate refuses one right sample of the tracker in a million.
    """
    return FusionSettings(
        velocity_mm_s=0.05,
        velocity_rad_s=2e-4,
        process_position_mm=0.005,
        process_velocity_mm_s=1.0,
        process_rotation_rad=2e-5,
        process_velocity_rad_s=5e-3,
        gate=1.0 - 1e-6,
    )


def drilling_filters() -> PatientFilterSettings:
    """The filters of patient and base for drilling.

    A threshold above their default: half a metre from the base's marker, a sample of its orientation that is
    taken for motion and let through would move the desired tip by a millimetre.
    """
    return PatientFilterSettings(threshold=6.0)


@dataclass(frozen=True)
class LoopSettings:
    """How the robot is run: filters, fusion, control, guards, and the operator's habits.

    Attributes
    ----------
    control : ControlSettings
    safety : SafetySettings
    patient : PatientFilterSettings
        Of the filters of the patient's and of the base's marker.
    fusion : FusionSettings
        Its measurement noise and lags are taken from the tracker, not from here.
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
    feed_forward : float
        Share of the desired tip's own speed that is told to the robot in advance, 0 to 1. With none the
        integral learns that speed, and the drill goes too deep until it has forgotten it: 0.4 mm at 1 mm/s.
        The text tells of PI alone, and of an operator who can slow down.

    Raises
    ------
    InputError
        If a number is negative or not finite, or zero where that has no meaning, or the orientation is fused
        as Euler angles, which the compiled loop does not know.
    """

    control: ControlSettings = field(default_factory=ControlSettings)
    safety: SafetySettings = field(default_factory=SafetySettings)
    patient: PatientFilterSettings = field(default_factory=drilling_filters)
    fusion: FusionSettings = field(default_factory=drilling_fusion)
    approach_mm: float = 10.0
    wait_mm: float = 0.5
    settle_s: float = 2.0
    stay_s: float = 1.0
    retraction: float = 4.0
    wander_s: float = 2.0
    feed_forward: float = 1.0

    def __post_init__(self) -> None:
        for name in ("approach_mm", "wait_mm", "settle_s", "stay_s", "retraction", "wander_s"):
            value = getattr(self, name)
            can_be_0 = name in ("settle_s", "stay_s")
            if not np.isfinite(value) or value < 0 or (value == 0 and not can_be_0):
                least = "at least" if can_be_0 else "more than"
                raise InputError(f"{name}: expected a finite number of {least} 0, got {value!r}")
        if not 0 <= self.feed_forward <= 1:
            raise InputError(f"feed_forward: expected 0 to 1, got {self.feed_forward!r}")
        if self.fusion.orientation != "error_state":
            raise InputError(f"fusion: expected orientation 'error_state', got {self.fusion.orientation!r}")
