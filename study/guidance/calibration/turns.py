"""Least squares over turned frames, which pivoting and hand-eye calibration share."""

from __future__ import annotations

import numpy as np

from study.errors import CalibrationError

#: Smallest root mean squared turn, rad, of the direction that turns least: two degrees.
LEAST_SPREAD = 0.035
#: Fewest poses: two leave no residual to judge by.
LEAST_POSES = 3


def turn_spread(rotations: np.ndarray) -> float:
    """Root mean squared angle, rad, by which the direction turns that turns least over the rotations.

    Zero where all turns are about one axis: that axis stays. It is sqrt(2) times the smallest singular value
    of the equations ``R_i x - y = c_i``, over sqrt(n).

    Parameters
    ----------
    rotations : (n, 3, 3) array
    """
    longest = np.linalg.svd(rotations.mean(axis=0), compute_uv=False)[0]
    return float(np.sqrt(max(0.0, 2.0 * (1.0 - longest))))


def checked_spread(what: str, rotations: np.ndarray, least: float = LEAST_SPREAD) -> float:
    """The spread of rotations, `turn_spread`, from which something can be told.

    Raises
    ------
    CalibrationError
        If there are too few of them or they turn too little about more than one axis.
    """
    if len(rotations) < LEAST_POSES:
        raise CalibrationError(f"{what}: expected at least {LEAST_POSES} poses, got {len(rotations)}")
    spread = turn_spread(rotations)
    if spread < least:
        raise CalibrationError(
            f"{what}: expected turns about two axes at least, so that every direction turns by "
            f"{np.degrees(least):.3g} degrees r.m.s.; one turns by {np.degrees(spread):.3g} degrees only "
            f"(smallest singular value {spread / np.sqrt(2):.3g}, needed {least / np.sqrt(2):.3g})"
        )
    return spread


def solve_turned(rotations: np.ndarray, sides: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least squares of ``R_i x - y = c_i``.

    Parameters
    ----------
    rotations : (n, 3, 3) array
        Turning about two axes at least.
    sides : (n, 3) array
        ``c_i``.

    Returns
    -------
    x, y : (3,) arrays
    """
    mean = rotations.mean(axis=0)
    turned = np.einsum("nji,nj->i", rotations, sides) / len(sides)
    x = np.linalg.solve(np.eye(3) - mean.T @ mean, turned - mean.T @ sides.mean(axis=0))
    return x, mean @ x - sides.mean(axis=0)


def equations(rotations: np.ndarray) -> np.ndarray:
    """(n, 3, 6) matrices ``[R_i, -1]`` of the equations that `solve_turned` solves."""
    rows = np.zeros((len(rotations), 3, 6))
    rows[:, :, :3] = rotations
    rows[:, :, 3:] = -np.eye(3)
    return rows


def sandwich(slope: np.ndarray, scores: np.ndarray, equations_each: int, unknowns: int) -> np.ndarray:
    """Covariance of estimates that make scores add up to 0, from the scores' own scatter.

    Takes errors of any shape, alike or not from pose to pose: a tracker errs more in depth than across, and
    a reference that is turned sees that in all directions.

    Parameters
    ----------
    slope : (p, p) array
        Derivative of the sum of the scores by the estimates.
    scores : (n, p) array
        Of each pose at the solution.
    equations_each, unknowns : int
        Equations a pose and unknowns that use up their freedom.

    Returns
    -------
    (p, p) array
    """
    n = len(scores)
    freedom = n * equations_each / (n * equations_each - unknowns)
    half = np.linalg.solve(slope, scores.T)
    return half @ half.T * freedom
