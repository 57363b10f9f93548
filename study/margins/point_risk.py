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
from study.threads import in_threads

#: Covariances get this share of the largest variance along every axis, so that there is a (very long)
#: distance also along a direction in which nothing scatters.
_LEAST = 1e-12


def euclidean() -> DisplacementMoments:
    """Moments under which the Mahalanobis distance is the distance in mm."""
    covariance = np.zeros((3, 4, 3, 4))
    for axis in range(3):
        covariance[axis, 3, axis, 3] = 1.0
    return DisplacementMoments(np.zeros(3), covariance.reshape(12, 12))


def widest_deviations(points: np.ndarray, moments: DisplacementMoments) -> np.ndarray:
    """(m,) largest standard deviation of the error at (m, 3) points along any direction, mm.

    Along every direction the variance is convex in the point, so that in a box this is largest at a corner.
    """
    return np.sqrt(np.linalg.eigvalsh(moments.at(points))[:, -1].clip(0))


def widest_deviation(region: Region, moments: DisplacementMoments) -> float:
    """Largest standard deviation of the error in the box, along any direction, mm."""
    box = np.array(list(product(*((0, n) for n in region.shape))))
    return float(widest_deviations(region.corner_points(box), moments).max())


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
    in_voxels = _in_voxels(region, moments)
    corners = np.array(list(product(*((-0.5, n - 0.5) for n in region.shape), (1.0,))))
    across = np.einsum("mj,ajbk,mk->mab", corners, in_voxels[:2, :, :2], corners)
    largest = float(np.linalg.eigvalsh(across)[:, -1].max())
    least = _LEAST * largest
    columns, lengths = _columns(cut * np.sqrt(largest + least))
    out = np.empty(len(voxels))

    def part(piece: slice) -> None:
        _kernels.smallest_distances(
            voxels[piece], above, below, in_voxels, least, columns, lengths, cut, out[piece]
        )

    in_threads(part, len(voxels), least=5000)
    return out


def _in_voxels(region: Region, moments: DisplacementMoments) -> np.ndarray:
    """(3, 4, 3, 4) covariance of ``[G, u]`` for places and displacements in voxels of the region's box."""
    covariance = moments.about(region.affine[:3, 3]).covariance.reshape(3, 4, 3, 4)
    places = np.eye(4)
    places[:3, :3] = region.affine[:3, :3]
    steps = np.linalg.inv(region.affine[:3, :3])
    found = np.einsum("ra,ajbk,ju,kv,cb->rucv", steps, covariance, places, places, steps, optimize=True)
    return np.ascontiguousarray(found)


def _columns(reach: float) -> tuple[np.ndarray, np.ndarray]:
    """(m, 2) steps from a voxel to lines of corners within `reach` voxels, and their squared distances."""
    most = int(np.ceil(reach + 0.5))
    steps = np.arange(1 - most, most + 1)
    grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), -1).reshape(-1, 2)
    lengths = ((grid - 0.5) ** 2).sum(axis=1)
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
