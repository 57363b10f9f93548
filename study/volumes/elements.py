"""Structuring elements: the set of voxels a ball overlaps (Siebold, 2.2.1-2.2.2)."""

from __future__ import annotations

import numpy as np

from study.errors import InputError


def ball_element(radius: float, spacing: np.ndarray, *, overlap: bool = True) -> np.ndarray:
    """Voxels overlapped by a ball that is centred on a voxel's centre.

    A voxel is a closed box; it is overlapped when its nearest point lies strictly inside the ball
    (touching is not cutting). With ``overlap=False`` a voxel counts when its centre is inside, the
    usual element of image processing, which lets a real burr cut voxels it does not hold.

    Parameters
    ----------
    radius : float
        mm.
    spacing : (3,) array
        Voxel size in mm.

    Returns
    -------
    (2 a + 1, 2 b + 1, 2 c + 1) bool array
        The element, its centre voxel in the middle.

    Raises
    ------
    InputError
        If radius or spacing is not positive and finite.
    """
    spacing = np.broadcast_to(np.asarray(spacing, dtype=float), (3,))
    if not np.isfinite(radius) or radius <= 0:
        raise InputError(f"radius: expected a positive number of mm, got {radius}")
    if not np.isfinite(spacing).all() or (spacing <= 0).any():
        raise InputError(f"spacing: expected three positive numbers of mm, got {spacing.tolist()}")
    reach = np.floor(radius / spacing + 0.5).astype(int)
    axes = [np.abs(np.arange(-n, n + 1)) for n in reach]
    nearest = [
        np.maximum(axis - 0.5, 0) * step if overlap else axis * step
        for axis, step in zip(axes, spacing, strict=True)
    ]
    x, y, z = np.meshgrid(*nearest, indexing="ij", sparse=True)
    return x**2 + y**2 + z**2 < radius**2 * (1 - 1e-12)


def element_rows(element: np.ndarray) -> np.ndarray:
    """Rows of a symmetric convex element along its last axis.

    Parameters
    ----------
    element : (2 a + 1, 2 b + 1, 2 c + 1) bool array
        As from `ball_element`.

    Returns
    -------
    (m, 3) int64 array
        Offsets along the first two axes, and how far the row reaches to either side along the last.
    """
    middle = np.array(element.shape) // 2
    reach = element[:, :, middle[2] :].sum(axis=2) - 1
    first, second = np.nonzero(reach >= 0)
    rows = np.column_stack([first - middle[0], second - middle[1], reach[first, second]])
    return rows.astype(np.int64)
