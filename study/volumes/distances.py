"""Exact dilation by a ball that counts every voxel it overlaps."""

from __future__ import annotations

import numpy as np

from study.volumes import _kernels
from study.volumes.elements import ball_element, element_rows


def overlapped_by_ball(mask: np.ndarray, radius: float, spacing: np.ndarray) -> np.ndarray:
    """Voxel centres at which a ball of this radius would overlap a voxel of `mask`.

    The same as dilating `mask` by ``ball_element(radius, spacing)``, row by row of the element.

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
    rows = element_rows(ball_element(radius, spacing))
    grown = _kernels.dilate_by_rows(
        np.ascontiguousarray(mask, dtype=np.bool_).view(np.uint8), rows, int(rows[:, 2].max())
    )
    return grown.view(np.bool_)
