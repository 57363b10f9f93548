"""Directions about any axis, in any frame: what to ask a check for."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from study.collision.directions.space import cone_of_directions
from study.errors import InputError


def _turn_to(axis: np.ndarray) -> Rotation:
    """The shortest rotation that takes [0, -1, 0], the outward approach of canonical order, to an axis."""
    axis = np.asarray(axis, dtype=float)
    if axis.shape != (3,) or not np.isfinite(axis).all() or not axis.any():
        raise InputError(f"axis: expected a (3,) direction, got {axis}")
    outward = np.array([0.0, -1.0, 0.0])
    axis = axis / np.linalg.norm(axis)
    across = np.cross(outward, axis)
    sine = np.linalg.norm(across)
    if sine < 1e-12:
        return Rotation.identity() if axis[1] < 0 else Rotation.from_rotvec([np.pi, 0.0, 0.0])
    return Rotation.from_rotvec(across / sine * np.arctan2(sine, outward @ axis))


def cone_around(axis: np.ndarray, half_angle: float, spacing: float) -> np.ndarray:
    """(n, 3) unit vectors evenly spread within a cone about an axis, the axis first (radians)."""
    return _turn_to(axis).apply(cone_of_directions(half_angle, spacing).copy())


def window_around(axis: np.ndarray, half_width: float = np.deg2rad(2.5), samples: int = 18) -> np.ndarray:
    """The printed window of directions about a shaft (2.5.1).

    Parameters
    ----------
    axis : (3,) array
        The shaft's present direction.
    half_width : float
        Radians in both rotations; 2.5 degrees.
    samples : int
        Along each of the two; 18.

    Returns
    -------
    (samples^2, 3) array
        Unit vectors. With an even number the axis itself is not among them.
    """
    if not 0 < half_width < np.pi / 2 or samples < 2:
        raise InputError(
            f"window: expected 0 to 90 degrees and 2 samples or more, got {half_width}, {samples}"
        )
    offsets = np.linspace(-half_width, half_width, samples)
    tilt, tip = (a.ravel() for a in np.meshgrid(offsets, offsets, indexing="ij"))
    grid = np.column_stack([np.sin(tip), -np.cos(tip) * np.cos(tilt), np.cos(tip) * np.sin(tilt)])
    return _turn_to(axis).apply(grid)


def turned_aside(axes: np.ndarray, angle: float) -> np.ndarray:
    """(n, 3) unit vectors, each an `angle` in radians away from one of (n, 3) axes, all to the same side."""
    return np.array([_turn_to(axis).apply([np.sin(angle), -np.cos(angle), 0.0]) for axis in axes])
