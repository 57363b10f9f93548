"""Point damage risk: what a single voxel near a structure puts at stake (Siebold, 3.2.3).

The smallest distance from a voxel's centre to the structure's surface, measured in standard deviations of the
registration error there (Mahalanobis), ranks the voxels; the chi-squared law with three degrees of freedom
turns it into an upper bound of the probability that registration error carries the voxel into the structure.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
from scipy import stats

from study.errors import InputError
from study.margins.distances import _kernels
from study.margins.region import Region
from study.registration.moments import DisplacementMoments
from study.threads import in_threads

# An error that hardly scatters in some direction (variance below this share of the largest) has no useful
# distances along it: every variance is raised by a hundredth of the largest then, a deviation of a tenth.
_NARROW = 1e-3
_BLIND = 1e-2
# Else only by what keeps rounding from making a variance negative.
_LEAST = 1e-12
# Lines from which on it is asked whether there are fewer surface corners than lines.
_MANY_COLUMNS = 300


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


def reach_of_metric(region: Region, moments: DisplacementMoments) -> Callable[[np.ndarray], np.ndarray]:
    """From (m, 3) points to (m,) mm: how far one standard deviation reaches there, at most."""
    *_, least = _in_voxels(region, moments)
    added = least * np.linalg.norm(region.affine[:3, :3], 2) ** 2
    return lambda points: np.sqrt(widest_deviations(points, moments) ** 2 + added)


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
        Standard deviations; from there on a distance is given as infinity. Where the error hardly scatters in
        some direction a tenth of the largest deviation is added there, in quadrature.

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
    lattice = tuple(n + 1 for n in region.shape)
    above, below = np.empty(lattice, np.int16), np.empty(lattice, np.int16)
    _kernels.surface_along_lines(region.solid, above, below)
    in_voxels, largest, least = _in_voxels(region, moments)
    columns, lengths = _columns(cut * np.sqrt(largest + least))
    corners = np.empty((0, 3), np.int64)
    if len(columns) > _MANY_COLUMNS:
        every = np.argwhere(below == np.arange(lattice[2]))
        corners = every if len(every) < len(columns) else corners
    out = np.empty(len(voxels))

    def part(piece: slice) -> None:
        _kernels.smallest_distances(
            voxels[piece], above, below, in_voxels, least, columns, lengths, corners, cut, out[piece]
        )

    in_threads(part, len(voxels), least=5000)
    return out


def _in_voxels(region: Region, moments: DisplacementMoments) -> tuple[np.ndarray, float, float]:
    """Covariance of ``[G, u]`` for places and displacements in voxels of the region's box, (3, 4, 3, 4).

    With it the largest variance in the box, and what is added to variances along the axes, in voxels. The
    latter depends on the structure alone, not on how much of its surroundings the box holds.
    """
    covariance = moments.about(region.affine[:3, 3]).covariance.reshape(3, 4, 3, 4)
    places = np.eye(4)
    places[:3, :3] = region.affine[:3, :3]
    steps = np.linalg.inv(region.affine[:3, :3])
    found = np.einsum("ra,ajbk,ju,kv,cb->rucv", steps, covariance, places, places, steps, optimize=True)

    def variances(low: np.ndarray, high: np.ndarray) -> np.ndarray:
        corners = np.array(
            list(product(*zip(low - 0.5, (low + high - 1) / 2, high - 0.5, strict=True), (1.0,)))
        )
        return np.linalg.eigvalsh(np.einsum("mj,ajbk,mk->mab", corners, found, corners))

    largest = variances(np.zeros(3), np.array(region.shape))[:, -1].max()
    here = variances(region.extent[:, 0], region.extent[:, 1] + 1)
    blind = here[:, 0].min() < _NARROW * here[:, -1].max()
    least = here[:, -1].max() * (_BLIND if blind else _LEAST)
    return np.ascontiguousarray(found), float(largest), float(least)


def _columns(reach: float) -> tuple[np.ndarray, np.ndarray]:
    """(m, 2) steps from a voxel to lines of corners within `reach` voxels, and their squared distances."""
    most = int(np.ceil(reach + 0.5))
    steps = np.arange(1 - most, most + 1)
    grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), -1).reshape(-1, 2)
    lengths = ((grid - 0.5) ** 2).sum(axis=1)
    order = np.argsort(lengths, kind="stable")
    return grid[order], lengths[order]


def all_distances(
    region: Region, voxels: np.ndarray, moments: DisplacementMoments, expected: float = 0.0
) -> np.ndarray:
    """As `smallest_distances`, however large; `expected` tells where to begin looking."""
    out = np.full(len(voxels), np.inf)
    cut = 1.5 * expected or 4.0
    while (far := np.flatnonzero(np.isinf(out))).size:
        out[far] = smallest_distances(region, np.ascontiguousarray(voxels[far]), moments, cut)
        cut *= 2
    return out


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
