"""Calibration of a drill by two bits with balls at their tips (Baron, section 4.3: Hannover's way)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from study.errors import CalibrationError, InputError
from study.guidance.calibration.tool_frame import T_tool_tcp_from
from study.registration.first_order import cross_matrices
from study.registration.rigid import checked_points

#: Smallest difference of the bits' lengths, mm: one ball's diameter.
LEAST_DIFFERENCE = 5.0


@dataclass(frozen=True, eq=False)
class BitCalibration:
    """The drill's tip and direction in the frame of its marker.

    Attributes
    ----------
    T_tool_tcp : (4, 4) array
        See `T_tool_tcp_from`.
    residual : float
        Measured distance of the balls minus the known difference of the bits' lengths, mm.
    scatter_rms : float
        Root of the mean squared distance of a touch from the centre of its ball's touches, mm, corrected
        for the centre being theirs.
    covariance : (6, 6) array
        Of a small motion of the tcp frame: rotation vector (rad) first, then translation of the tip (mm),
        the tool's axes. From the scatter of the touches, to first order; what all touches share (pointer
        tip, distortion, lengths of the bits) is not in it, nor is the turn about the bit, which is agreed
        and not measured.
    """

    T_tool_tcp: np.ndarray
    residual: float
    scatter_rms: float
    covariance: np.ndarray


def calibrate_bits(
    short_ball_tool: ArrayLike,
    long_ball_tool: ArrayLike,
    short_mm: float,
    long_mm: float,
    drill_mm: float,
    tolerance_mm: float = 1.0,
    touch_std_mm: float | None = None,
) -> BitCalibration:
    """Find tip and direction of a drill from balls at the tips of two bits in the same holder.

    The bit's axis goes through the centres of both balls; the drill's tip lies on it, as far from them as
    the lengths say. Where the balls' measured distance is not the known one, the difference is shared by
    both balls according to their touches.

    Parameters
    ----------
    short_ball_tool, long_ball_tool : (k, 3) arrays
        Centre of the ball as touched again and again, mm, frame of the drill's marker.
    short_mm, long_mm : float
        From the stop in the holder to the centre of the ball.
    drill_mm : float
        From the same stop to the drill's tip.
    tolerance_mm : float
        Largest residual that is taken.
    touch_std_mm : float, optional
        Of one touch along one axis. From the touches' scatter by default, which takes two of a ball.

    Returns
    -------
    BitCalibration

    Raises
    ------
    CalibrationError
        If the bits differ too little in length, the balls are not as far apart as their lengths say, or no
        ball was touched twice and `touch_std_mm` is not given.
    InputError
        If a length or a touch is not what it should be.
    """
    touches = [
        checked_points("short_ball_tool", short_ball_tool),
        checked_points("long_ball_tool", long_ball_tool),
    ]
    lengths = np.array([short_mm, long_mm], dtype=float)
    if not np.isfinite([*lengths, drill_mm]).all() or min(*lengths, drill_mm) < 0:
        raise InputError(
            f"short_mm, long_mm, drill_mm: expected lengths in mm, got {short_mm}, {long_mm}, {drill_mm}"
        )
    if not lengths[1] - lengths[0] >= LEAST_DIFFERENCE:
        raise CalibrationError(
            f"long_mm - short_mm: expected at least {LEAST_DIFFERENCE} mm to tell the axis by, "
            f"got {lengths[1] - lengths[0]:.3g} mm"
        )
    counts = np.array([len(part) for part in touches])
    centres = np.array([part.mean(axis=0) for part in touches])
    span = centres[1] - centres[0]
    distance = float(np.linalg.norm(span))
    residual = distance - float(lengths[1] - lengths[0])
    if not abs(residual) <= tolerance_mm:
        raise CalibrationError(
            f"balls: expected {lengths[1] - lengths[0]:.3f} mm between them, within {tolerance_mm} mm, "
            f"as the bits' lengths say; measured {distance:.3f} mm"
        )
    axis = span / distance
    share = counts / counts.sum()
    tip = share @ centres + (drill_mm - share @ lengths) * axis
    one_touch, scatter = _touch_covariance(touches, touch_std_mm)
    across = np.eye(3) - np.outer(axis, axis)
    motion = np.zeros((6, 6))
    for sign, part, count in zip((-1.0, 1.0), share, counts, strict=True):
        turn = sign * across / distance
        moved = np.vstack(
            [cross_matrices(axis) @ turn, part * np.eye(3) + (drill_mm - share @ lengths) * turn]
        )
        motion += moved @ (one_touch / count) @ moved.T
    return BitCalibration(T_tool_tcp_from(tip, axis), residual, scatter, motion)


def _touch_covariance(touches: list[np.ndarray], std: float | None) -> tuple[np.ndarray, float]:
    """(3, 3) covariance of one touch, mm^2, and the touches' root mean squared scatter, mm."""
    freedom = sum(len(part) - 1 for part in touches)
    centred = np.vstack([part - part.mean(axis=0) for part in touches])
    pooled = centred.T @ centred / max(freedom, 1)
    scatter = float(np.sqrt(np.trace(pooled)))
    if std is not None:
        if not np.isfinite(std) or std < 0:
            raise InputError(f"touch_std_mm: expected mm of at least 0, got {std!r}")
        return np.eye(3) * std**2, scatter
    if freedom == 0:
        raise CalibrationError(
            "touches: expected two of a ball at least, to tell their scatter, or touch_std_mm; "
            "got one of each ball"
        )
    return pooled, scatter
