"""How large a tumour is and how much of it stands out of the kidney."""

from __future__ import annotations

import contextlib

import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.distance import pdist

from study.errors import LabelError
from study.volumes import LabelVolume


def exophytic_share(anatomy: LabelVolume) -> float:
    """Share of the tumour's surface that faces outside, 0 (endophytic) to 1.

    Parameters
    ----------
    anatomy : LabelVolume
        With ``background`` and ``tumour``; the sinus is background.

    Returns
    -------
    float
        Of the tumour's voxels that have a face to another label, the share that has one to background.

    Raises
    ------
    LabelError
        If no voxel is tumour.
    """
    tumour = _tumour(anatomy)
    rim = tumour & ~ndimage.binary_erosion(tumour)
    outside = ndimage.binary_dilation(anatomy.mask("background"))
    return float(np.count_nonzero(rim & outside) / np.count_nonzero(rim))


def tumour_sections(anatomy: LabelVolume) -> np.ndarray:
    """Largest distance across the tumour in any slice across each of the three grid axes.

    A small renal mass is one whose largest cross-sectional distance is at most 40 mm (Siebold, 4.1).

    Parameters
    ----------
    anatomy : LabelVolume
        With ``tumour``.

    Returns
    -------
    (3,) array
        mm, between voxel centres plus one voxel; in LPS order: sagittal, coronal, axial.

    Raises
    ------
    LabelError
        If no voxel is tumour.
    """
    indices = np.argwhere(_tumour(anatomy))
    out = np.zeros(3)
    for axis in range(3):
        others = [other for other in range(3) if other != axis]
        for slice_index in np.unique(indices[:, axis]):
            flat = (indices[indices[:, axis] == slice_index] * anatomy.spacing)[:, others]
            out[axis] = max(out[axis], _farthest(flat) + anatomy.spacing[others].mean())
    return out


def _tumour(anatomy: LabelVolume) -> np.ndarray:
    mask = anatomy.mask("tumour")
    if not mask.any():
        raise LabelError(f"expected voxels of tumour, got none in {anatomy!r}")
    return mask


def _farthest(points: np.ndarray) -> float:
    if len(points) > 3:
        with contextlib.suppress(QhullError):  # all on a line
            points = points[ConvexHull(points).vertices]
    return float(pdist(points).max(initial=0.0))
