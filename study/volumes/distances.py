"""Exact dilation by a ball that counts every voxel it overlaps."""

from __future__ import annotations

import numpy as np

from study.volumes import _kernels


def overlapped_by_ball(mask: np.ndarray, radius: float, spacing: np.ndarray) -> np.ndarray:
    """Voxel centres at which a ball of this radius would overlap a voxel of `mask`.

    The same as dilating `mask` by ``ball_element(radius, spacing)``, in three separable passes.

    Parameters
    ----------
    mask : (nx, ny, nz) bool array
    radius : float
        mm.
    spacing : (3,) array
        mm.

    Returns
    -------
    (nx, ny, nz) bool array
    """
    spacing = np.asarray(spacing, dtype=float)
    weights = []
    for step in spacing:
        reach = int(np.floor(radius / step + 0.5))
        weights.append((np.maximum(np.arange(reach + 1) - 0.5, 0) * step) ** 2)
    squared = _kernels.squared_distance_to_boxes(np.ascontiguousarray(mask, dtype=np.bool_), *weights)
    return squared < radius**2 * (1 - 1e-12)
