"""The controller as Python calls it; the loop calls the same kernel."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from study.errors import InputError
from study.guidance.control import _kernels
from study.guidance.frames import checked_transform, quaternions


@dataclass(frozen=True)
class ControlSettings:
    """Gains and limits of the PI control of the drill's pose (Baron, section 5.1; values ours).

    The text drives the vector part of the error quaternion to zero, which is half the angle: gains here
    are those of the angle, so that position and orientation with the same gain close at the same rate.

    Attributes
    ----------
    position_gain, orientation_gain : float
        1/s: speed a mm, or a radian, of error.
    position_integral, orientation_integral : float
        1/s^2.
    speed_mm_s, speed_rad_s : float
        Most that is commanded.

    Raises
    ------
    InputError
        If a gain is negative or a limit not positive.
    """

    position_gain: float = 2.0
    position_integral: float = 0.5
    orientation_gain: float = 2.0
    orientation_integral: float = 0.5
    speed_mm_s: float = 20.0
    speed_rad_s: float = 0.2

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            least = "more than 0" if field.name.startswith("speed") else "at least 0"
            if not np.isfinite(value) or value < 0 or (value == 0 and least != "at least 0"):
                raise InputError(f"{field.name}: expected {least}, got {value!r}")

    @property
    def gains(self) -> np.ndarray:
        """(4,) position, its integral, orientation, its integral."""
        return np.array(
            [self.position_gain, self.position_integral, self.orientation_gain, self.orientation_integral]
        )

    @property
    def most(self) -> np.ndarray:
        """(2,) mm/s and rad/s."""
        return np.array([self.speed_mm_s, self.speed_rad_s])


class PoseController:
    """PI control of position and orientation; tells the robot how to move on, not where to go.

    Parameters
    ----------
    settings : ControlSettings, optional
    cycle_s : float
        Of the robot's control box, s: 0.012 or 0.04 (Baron, section 3.1).

    Raises
    ------
    InputError
        If the cycle is not positive.
    """

    def __init__(self, settings: ControlSettings | None = None, cycle_s: float = 0.012) -> None:
        if not np.isfinite(cycle_s) or cycle_s <= 0:
            raise InputError(f"cycle_s: expected more than 0 s, got {cycle_s!r}")
        self.settings = settings or ControlSettings()
        self.cycle_s = cycle_s
        self._integral = np.zeros(6)

    def step(self, actual: np.ndarray, desired: np.ndarray) -> np.ndarray:
        """(6,) twist for the next cycle, mm/s and rad/s, linear first, in the axes of the robot's base.

        Times the cycle it is the differential command; the rotation turns about the tip.

        Parameters
        ----------
        actual, desired : (4, 4) arrays
            ``T_rob_tcp``, equations 5 and 6.

        Raises
        ------
        InputError
            If one is not a rigid transform.
        """
        actual = checked_transform("actual", actual)
        desired = checked_transform("desired", desired)
        turn = np.eye(4)
        turn[:3, :3] = desired[:3, :3] @ actual[:3, :3].T
        twist = np.zeros(6)
        _kernels.steer_once(
            desired[:3, 3] - actual[:3, 3],
            quaternions(turn),
            self.settings.gains,
            self.settings.most,
            self.cycle_s,
            self._integral,
            twist,
        )
        return twist

    def reset(self) -> None:
        """Forget what was summed up: after a stop."""
        self._integral[:] = 0.0
