"""How far an arm as built may be from its drawing: what tolerances leave, apart from repeatability."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from study.errors import InputError
from study.robots.arms.arm import AXES

if TYPE_CHECKING:
    from study.robots.arms.arm import SixAxisArm


@dataclass(frozen=True)
class ArmErrors:
    """Standard deviations of the errors of an arm that nobody calibrated.

    Plausible, not measured on these arms: the defaults leave the absolute error of a few tenths of a
    millimetre to one that small arms have before calibration, many times their repeatability.

    Parameters
    ----------
    joint_bias_std_rad : float
        Of a joint's zero, rad (plausible: 0 to 2e-3; mastering by marks or pins).
    offset_std_mm : float
        Of the place of a joint in the link before, mm an axis (plausible: 0 to 0.5; machined castings).
    offset_std_rad : float
        Of the direction of a joint's axis, rad about each of the two directions across it (plausible: 0 to
        1e-3). About the axis itself there is only the bias.

    Raises
    ------
    InputError
        If one is negative or not finite.
    """

    joint_bias_std_rad: float = 5e-4
    offset_std_mm: float = 0.2
    offset_std_rad: float = 2e-4

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            if not (np.isfinite(value) and value >= 0):
                raise InputError(f"{each.name}: expected a finite number of at least 0, got {value!r}")

    def sample(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """One arm's errors, for `SixAxisArm.with_errors`.

        Parameters
        ----------
        rng : numpy.random.Generator

        Returns
        -------
        joint_bias : (6,) array
            rad.
        offsets : (6, 6) array
            mm along and rad about the axes of each joint's frame.
        """
        bias = self.joint_bias_std_rad * rng.standard_normal(6)
        offsets = rng.standard_normal((6, 6)) * np.repeat([self.offset_std_mm, self.offset_std_rad], 3)
        offsets[:, 3:][AXES != 0] = 0.0
        return bias, offsets

    def built(self, nominal: SixAxisArm, rng: np.random.Generator) -> SixAxisArm:
        """An arm with errors drawn."""
        return nominal.with_errors(*self.sample(rng))
