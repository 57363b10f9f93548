"""The two guided robots as what they are made of: every cause with its unit, its value and a plausible range.

Nothing here was measured by drilling: no printed result of the experiments is among the causes. What the
text prints of the hardware is taken (cycles, delay, repeatability, a spec sheet); the rest are plausible
values for such equipment, the same for both systems unless the text tells them apart.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cache

import numpy as np
import pandas as pd
from scipy import stats

from study.errors import FileFormatError, InputError
from study.paths import data_path
from study.robots.arms import arm_names

SYSTEMS = ("hannover", "vanderbilt")
_COLUMNS = ["cause", "unit", *SYSTEMS, "low", "high", "known", "source"]
#: Causes that count something.
_WHOLE = ("hand_eye_poses", "touches", "touch_frames", "pivot_poses")
#: Causes that divide something: they cannot be 0.
_POSITIVE = (
    "tracker_depth_ratio",
    "tracker_distortion_length_mm",
    "tracker_cycle_s",
    "tracker_delay_s",
    "marker_size_mm",
    "robot_cycle_s",
    "hand_eye_poses",
    "hand_eye_turn_deg",
    "drive_lag_s",
    "touches",
    "touch_frames",
    "pivot_poses",
    "pivot_cone_deg",
    "force_length_mm",
    "bit_length_mm",
    "shank_mm",
    "insertion_mm_s",
)


@dataclass(frozen=True)
class GuidedSystem:
    """A robot, a tracker and a way to calibrate and register them, as causes of error.

    Standard deviations are of one axis unless said otherwise; `causes` tells where each value comes from.

    Attributes
    ----------
    name : str
    arm : str
        One of `study.robots.arms.arm_names`.
    calibration : str
        ``"bits"``: two bits of different length and a pointer (Hannover); ``"pivot"``: a marker pivoted about
        the tip (Vanderbilt); section 4.3.
    tracker_jitter_mm, ... : float
        The causes, in the order of `causes`.

    Raises
    ------
    InputError
        If there is no such arm or way of calibration, or a cause is negative, not finite, or zero where that
        has no meaning.
    """

    name: str
    arm: str
    calibration: str
    tracker_jitter_mm: float
    tracker_depth_ratio: float
    tracker_distortion_mm: float
    tracker_distortion_length_mm: float
    tracker_quantum_mm: float
    tracker_cycle_s: float
    tracker_delay_s: float
    marker_size_mm: float
    tip_lever_mm: float
    robot_repeatability_mm: float
    joint_bias_mrad: float
    link_error_mm: float
    axis_error_mrad: float
    hand_eye_poses: int
    hand_eye_turn_deg: float
    robot_cycle_s: float
    drive_lag_s: float
    pointer_tip_error_mm: float
    pointer_seating_mm: float
    touches: int
    touch_frames: int
    bit_length_error_mm: float
    pivot_poses: int
    pivot_cone_deg: float
    tool_axis_error_mrad: float
    calibration_force_n: float
    sphere_position_mm: float
    image_fle_mm: float
    lateral_force_n: float
    force_variation_n: float
    force_length_mm: float
    entry_slip_mm: float
    bit_length_mm: float
    shank_mm: float
    insertion_mm_s: float
    scan_reading_mm: float

    def __post_init__(self) -> None:
        if self.arm not in arm_names():
            raise InputError(f"arm: expected one of {', '.join(arm_names())}, got {self.arm!r}")
        if self.calibration not in ("bits", "pivot"):
            raise InputError(f"calibration: expected 'bits' or 'pivot', got {self.calibration!r}")
        for name in cause_names():
            value = getattr(self, name)
            if (
                isinstance(value, bool)
                or not isinstance(value, int | float | np.number)
                or not np.isfinite(value)
            ):
                raise InputError(f"{name}: expected a finite number, got {value!r}")
            if value < 0 or (value == 0 and name in _POSITIVE):
                least = "more than 0" if name in _POSITIVE else "at least 0"
                raise InputError(f"{name}: expected {least}, got {value!r}")
            if name in _WHOLE:
                if value != int(value):
                    raise InputError(f"{name}: expected a whole number, got {value!r}")
                object.__setattr__(self, name, int(value))

    def but(self, **changes: float | str) -> GuidedSystem:
        """The same system with some causes changed.

        Raises
        ------
        InputError
            If there is no such cause or its value has no meaning.
        """
        unknown = set(changes) - {field.name for field in fields(self)}
        if unknown:
            raise InputError(f"{', '.join(sorted(unknown))}: expected some of {', '.join(cause_names())}")
        return replace(self, **changes)

    def drawn(self, rng: object = None) -> GuidedSystem:
        """The same system with every cause that is not known drawn from its plausible range.

        Triangular between ``low`` and ``high``, with this system's value as the likeliest, in the logarithm,
        since these are sizes of errors of which the order is what is known; as they are where ``low`` is 0.
        What the ranges allow is what an experiment whose causes nobody wrote down can be compared with.

        Parameters
        ----------
        rng : anything `numpy.random.default_rng` takes
        """
        rng = np.random.default_rng(rng)
        table = _causes()
        unknown = table.index[table["known"] == "no"]
        shares = rng.uniform(size=len(unknown))
        drawn = {}
        for cause, share in zip(unknown, shares, strict=True):
            low, high = table.loc[cause, ["low", "high"]]
            mode = np.clip(getattr(self, cause), low, high)
            ends = np.array([low, mode, high], dtype=float)
            if low > 0:
                ends = np.log(ends)
            place = (ends[1] - ends[0]) / (ends[2] - ends[0])
            value = float(stats.triang.ppf(share, place, ends[0], ends[2] - ends[0]))
            drawn[cause] = float(np.exp(value)) if low > 0 else value
        return self.but(**drawn)

    @property
    def tracker_jitter_xyz_mm(self) -> tuple[float, float, float]:
        """Jitter of a sphere along the camera's axes; z is the line of sight."""
        across = self.tracker_jitter_mm
        return across, across, across * self.tracker_depth_ratio

    @property
    def bit_stiffness_n_mm(self) -> float:
        """Force at the tip that bends the bit by one mm: a steel cantilever, 3 E I / L^3."""
        steel = 200_000.0  # N/mm^2
        return 3.0 * steel * (np.pi * self.shank_mm**4 / 64.0) / self.bit_length_mm**3


@cache
def _causes() -> pd.DataFrame:
    path = data_path("guidance_causes.csv")
    table = pd.read_csv(path)
    if list(table.columns) != _COLUMNS or table["cause"].duplicated().any() or table.isna().any(axis=None):
        raise FileFormatError(
            f"{path}: expected columns {_COLUMNS} and one full line a cause, got {list(table)}"
        )
    return table.set_index("cause")


def causes() -> pd.DataFrame:
    """Every cause: its unit, its value in both systems, a plausible range, and where it comes from.

    Returns
    -------
    pandas.DataFrame
        Indexed by cause; columns ``unit``, ``hannover``, ``vanderbilt``, ``low``, ``high``, ``known``
        (``"yes"`` where it is printed or chosen by who runs the experiment) and ``source``.
    """
    return _causes().copy()


def cause_names() -> tuple[str, ...]:
    """Names of the causes in order."""
    return tuple(_causes().index)


def system(name: str, **changes: float | str) -> GuidedSystem:
    """One of the two systems of the text, as its causes.

    Parameters
    ----------
    name : str
        ``"hannover"`` (KUKA KR 3, ARTtrack2) or ``"vanderbilt"`` (Mitsubishi RV-3S, Polaris Spectra).
    **changes
        Causes to set otherwise.

    Raises
    ------
    InputError
        If there is no such system or cause.

    Examples
    --------
    >>> round(system("vanderbilt", calibration_force_n=3.0).bit_stiffness_n_mm, 1)
    7.2
    """
    if name not in SYSTEMS:
        raise InputError(f"system: expected one of {', '.join(SYSTEMS)}, got {name!r}")
    values = {
        cause: int(value) if cause in _WHOLE else float(value) for cause, value in _causes()[name].items()
    }
    arm, way = {"hannover": ("KR3", "bits"), "vanderbilt": ("RV-3S", "pivot")}[name]
    return GuidedSystem(name, arm, way, **values).but(**changes)
