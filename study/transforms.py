"""Rigid transforms as (4, 4) arrays, mm: made, checked, inverted, applied."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from study.errors import InputError

#: How far from rigid a transform, or from 1 a quaternion's length, may be: what six printed digits leave.
RIGID = 1e-5


def checked_transform(name: str, transform: ArrayLike) -> np.ndarray:
    """(4, 4) rigid transform.

    Raises
    ------
    InputError
        If it is not (4, 4), not finite, mirrors, scales or shears.
    """
    T = np.array(transform, dtype=float)
    if T.shape != (4, 4):
        raise InputError(f"{name}: expected a (4, 4) transform, got shape {T.shape}")
    if not np.isfinite(T).all():
        raise InputError(f"{name}: expected finite numbers, got {T.tolist()}")
    R = T[:3, :3]
    wrong = np.abs(R @ R.T - np.eye(3)).max()
    if wrong > RIGID or np.linalg.det(R) < 0 or not np.array_equal(T[3], [0, 0, 0, 1]):
        raise InputError(
            f"{name}: expected a rotation and a translation; R R^T is {wrong:.3g} off the unit matrix, "
            f"its determinant is {np.linalg.det(R):.3g} and the last row {T[3].tolist()}"
        )
    return T


def checked_transforms(name: str, transforms: ArrayLike) -> np.ndarray:
    """(n, 4, 4) rigid transforms, checked all at once: of poses there are many.

    Raises
    ------
    InputError
        If the shape is another or one of them is not rigid; says which.
    """
    T = np.array(transforms, dtype=float)
    if T.ndim != 3 or T.shape[1:] != (4, 4):
        raise InputError(f"{name}: expected (n, 4, 4) transforms, got shape {T.shape}")
    R = T[:, :3, :3]
    with np.errstate(invalid="ignore"):
        good = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2), initial=0.0) <= RIGID
        good &= (
            (np.linalg.det(R) > 0) & (T[:, 3] == [0, 0, 0, 1]).all(axis=1) & np.isfinite(T).all(axis=(1, 2))
        )
    for row in np.flatnonzero(~good):
        checked_transform(f"{name}[{row}]", T[row])
    return T


def rigid(
    rotation: Rotation | ArrayLike | None = None, translation: ArrayLike = (0.0, 0.0, 0.0)
) -> np.ndarray:
    """(..., 4, 4) transform of a rotation (scipy's, or (..., 3, 3) matrices) and a translation in mm."""
    if rotation is None:
        R = np.eye(3)
    else:
        R = rotation.as_matrix() if isinstance(rotation, Rotation) else np.asarray(rotation, dtype=float)
    t = np.asarray(translation, dtype=float)
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], t.shape[:-1]), 4, 4))
    T[..., :3, :3] = R
    T[..., :3, 3] = t
    T[..., 3, 3] = 1.0
    return T


def inverse(transform: np.ndarray) -> np.ndarray:
    """(..., 4, 4) inverses of rigid transforms."""
    R = np.swapaxes(transform[..., :3, :3], -1, -2)
    return rigid(R, -np.einsum("...ij,...j->...i", R, transform[..., :3, 3]))


def moved(transform: np.ndarray, points: ArrayLike) -> np.ndarray:
    """(n, 3) points, or one of shape (3,), in the frame that a transform leads to (equation 2)."""
    return np.asarray(points, dtype=float) @ transform[:3, :3].T + transform[:3, 3]
