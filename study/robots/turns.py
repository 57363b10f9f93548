"""Turns of the drill on great circles, as they are planned and replayed."""

from __future__ import annotations

import numpy as np

#: Radians that a turn of two joints is cut into; see `study.robots.FiveAxis`.
PART_OF_TURN = np.deg2rad(1.0)


def angles_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(m,) radians between unit vectors (m, 3), exact for small angles too."""
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ij,ij->i", a, b))


def turned(start: np.ndarray, end: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Unit vectors on great circles.

    Parameters
    ----------
    start, end : (m, 3) arrays
        Unit vectors, not opposite.
    share : (m,) array
        0 for the start, 1 for the end.

    Returns
    -------
    (m, 3) array
    """
    angle = angles_between(start, end)
    small = angle < 1e-9
    sine = np.where(small, 1.0, np.sin(angle))
    first = np.where(small, 1 - share, np.sin((1 - share) * angle) / sine)
    second = np.where(small, share, np.sin(share * angle) / sine)
    out = first[:, None] * start + second[:, None] * end
    return out / np.linalg.norm(out, axis=1)[:, None]


def cut_turns(axes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Every turn between consecutive axes in equal parts of at most `PART_OF_TURN`.

    Parameters
    ----------
    axes : (n, 3) array
        Unit vectors.

    Returns
    -------
    step : (k,) int array
        Which turn a part belongs to; turn j leads from axis j to j + 1. No part where nothing turns.
    begin, end : (k,) arrays
        Share of the turn at which the part begins and ends.
    """
    angle = angles_between(axes[:-1], axes[1:])
    parts = np.ceil(angle / PART_OF_TURN - 1e-9).astype(int)
    step = np.repeat(np.arange(len(angle)), parts)
    part = np.arange(step.size) - np.repeat(np.cumsum(parts) - parts, parts)
    return step, part / parts[step], (part + 1) / parts[step]
