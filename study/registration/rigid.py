"""Rigid registration of corresponding points, in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from study.errors import InputError
from study.registration import _kernels
from study.threads import in_threads

#: Second singular value of centred points over the first: below it they count as collinear.
COLLINEAR = 1e-6


@dataclass(frozen=True, eq=False)
class RigidFit:
    """A rigid transform between corresponding points and what it leaves.

    Attributes
    ----------
    transform : (4, 4) array
        From the moving points' frame to the fixed ones', mm.
    residuals : (n, 3) array
        Transformed moving points minus fixed points, mm.
    weights : (n,) array
        Of the squared distances.
    """

    transform: np.ndarray
    residuals: np.ndarray
    weights: np.ndarray

    @property
    def fre(self) -> float:
        """Fiducial registration error: root of the (weighted) mean squared residual, mm."""
        return float(np.sqrt(self.weights @ (self.residuals**2).sum(axis=1) / self.weights.sum()))


def checked_points(name: str, points: ArrayLike, least: int = 1) -> np.ndarray:
    """(n, 3) finite float array of at least `least` points.

    Raises
    ------
    InputError
        If it is not.
    """
    points = np.array(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"{name}: expected an array of shape (n, 3) in mm, got shape {points.shape}")
    if len(points) < least:
        raise InputError(f"{name}: expected at least {least} points, got {len(points)}")
    if not np.isfinite(points).all():
        raise InputError(f"{name}: expected finite numbers, got {points[~np.isfinite(points)][0]}")
    return points


def checked_fiducials(name: str, points: ArrayLike) -> np.ndarray:
    """(n, 3) points that fix a rotation: three or more, not on one line.

    Raises
    ------
    InputError
        If they do not.
    """
    points = checked_points(name, points, least=3)
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[0] == 0 or spread[1] <= COLLINEAR * spread[0]:
        raise InputError(
            f"{name}: expected points that do not lie on one line; their spread is "
            f"{spread[0]:.3g} mm along it and {spread[1]:.3g} mm across: {points.round(3).tolist()}"
        )
    return points


def checked_weights(weights: ArrayLike | None, count: int) -> np.ndarray:
    """(n,) positive weights; all one when None.

    Raises
    ------
    InputError
        If the shape or a value is wrong.
    """
    if weights is None:
        return np.ones(count)
    weights = np.array(weights, dtype=float)
    if weights.shape != (count,) or not np.isfinite(weights).all() or (weights <= 0).any():
        raise InputError(f"weights: expected {count} positive numbers, got {weights.tolist()}")
    return weights


def register_points(moving: ArrayLike, fixed: ArrayLike, weights: ArrayLike | None = None) -> RigidFit:
    """Rigid transform that brings points onto the points they correspond to, by weighted least squares.

    Parameters
    ----------
    moving, fixed : (n, 3) arrays
        mm; three or more, not on one line.
    weights : (n,) array, optional
        Of the squared distances, positive; all alike by default.

    Returns
    -------
    RigidFit
        ``transform`` maps `moving` to `fixed`; a rotation and a translation, never a reflection.

    Raises
    ------
    InputError
        If the shapes differ, points are collinear or a value is not finite.
    """
    moving = checked_fiducials("moving", moving)
    fixed = checked_fiducials("fixed", fixed)
    if moving.shape != fixed.shape:
        raise InputError(f"fixed: expected shape {moving.shape} like moving, got {fixed.shape}")
    weights = checked_weights(weights, len(moving))
    transform = register_many(moving[None], fixed[None], weights)[0]
    residuals = moving @ transform[:3, :3].T + transform[:3, 3] - fixed
    return RigidFit(transform, residuals, weights)


def register_many(moving: np.ndarray, fixed: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(m, 4, 4) transforms of m sets of points, each as in `register_points`; inputs are not checked.

    Parameters
    ----------
    moving, fixed : (m, n, 3) arrays
        mm.
    weights : (n,) array
    """
    moving, fixed, weights = (np.ascontiguousarray(x, dtype=float) for x in (moving, fixed, weights))
    out = np.empty((len(moving), 4, 4))

    def part(piece: slice) -> None:
        _kernels.register_many(moving[piece], fixed[piece], weights, out[piece])

    in_threads(part, len(moving), least=5000)
    return out
