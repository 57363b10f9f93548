"""Point damage risk: what a single voxel near a structure puts at stake (Siebold, 3.2.3).

The smallest distance from a voxel's centre to the structure's surface, measured in standard deviations of the
registration error there (Mahalanobis), ranks the voxels; the chi-squared law with three degrees of freedom
turns it into an upper bound of the probability that registration error carries the voxel into the structure.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy import stats

from study.errors import InputError
from study.margins.distances import _kernels
from study.margins.region import Region
from study.registration.moments import DisplacementMoments

#: Covariances get this share of the largest variance along every axis, so that there is a (very long)
#: distance also along a direction in which nothing scatters.
_FLOOR = 1e-12


def euclidean() -> DisplacementMoments:
    """Moments under which the Mahalanobis distance is the distance in mm."""
    covariance = np.zeros((3, 4, 3, 4))
    for axis in range(3):
        covariance[axis, 3, axis, 3] = 1.0
    return DisplacementMoments(np.zeros(3), covariance.reshape(12, 12))


def widest_deviation(region: Region, moments: DisplacementMoments) -> float:
    """Largest standard deviation of the error in the box, along any direction, mm.

    Along a direction the variance is convex in the point, so that it is largest at a corner of the box.
    """
    box = np.array(list(product(*((-0.5, n - 0.5) for n in region.shape))))
    points = box @ region.affine[:3, :3].T + region.affine[:3, 3]
    return float(np.sqrt(np.linalg.eigvalsh(moments.at(points))[:, -1].max()))


def smallest_distances(
    region: Region, voxels: np.ndarray, moments: DisplacementMoments, cut: float
) -> np.ndarray:
    """Smallest Mahalanobis distance from voxels to the structure's surface.

    Parameters
    ----------
    region : Region
    voxels : (n, 3) int array
        Indices in the region's box.
    moments : DisplacementMoments
        Of the error; its covariance at a voxel's centre is the metric there.
    cut : float
        Standard deviations; from there on a distance is given as infinity.

    Returns
    -------
    (n,) array
        Standard deviations.

    Raises
    ------
    InputError
        If the error has no covariance at all.
    """
    widest = widest_deviation(region, moments)
    if not widest > 0:
        raise InputError("model: expected an error that moves something, got a covariance of 0")
    surface = np.empty(tuple(n + 1 for n in region.shape), np.uint8)
    _kernels.surface_corners(region.solid, surface)
    above, below = np.empty(surface.shape, np.int16), np.empty(surface.shape, np.int16)
    _kernels.next_along_lines(surface, above, below)
    floor = _FLOOR * widest**2
    columns, lengths = _columns(region.affine, cut * np.sqrt(widest**2 + floor))
    out = np.empty(len(voxels))
    _kernels.smallest_distances(
        voxels,
        above,
        below,
        np.ascontiguousarray(region.affine[:3, :3]),
        region.affine[:3, 3] - moments.centre,
        np.ascontiguousarray(moments.covariance).reshape(3, 4, 3, 4),
        floor,
        columns,
        lengths,
        cut,
        out,
    )
    return out


def _columns(affine: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """(m, 2) steps from a voxel to the lines of corners within `reach` mm, and their squared distances."""
    to_mm = affine[:3, :3]
    along = to_mm[:, 2] / np.linalg.norm(to_mm[:, 2])
    most = np.ceil(reach * np.linalg.norm(np.linalg.inv(to_mm), axis=1)[:2] + 0.5).astype(int)
    grid = np.stack(np.meshgrid(*(np.arange(1 - m, m + 1) for m in most), indexing="ij"), -1).reshape(-1, 2)
    across = (grid - 0.5) @ to_mm[:, :2].T
    across -= np.outer(across @ along, along)
    lengths = (across**2).sum(axis=1)
    order = np.argsort(lengths, kind="stable")
    return grid[order], lengths[order]


def point_damage_risk(distances: np.ndarray) -> np.ndarray:
    """Probability that a normal error is longer than so many standard deviations, in any direction.

    Parameters
    ----------
    distances : array
        Mahalanobis distances.

    Returns
    -------
    array
        An upper bound of the probability that the structure is damaged where the distance was measured.
    """
    return stats.chi2.sf(np.square(distances), 3)
