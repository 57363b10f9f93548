"""Point damage risk by counting: in how many registrations error puts the structure where it is not.

Registration errors of a surface are not normal: where ICP stops early or in another valley they have
shoulders and tails of their own shape, which a covariance does not know. So voxels are ranked by the share of
registrations that bring the structure over them (Siebold, 4.2.4), counted over the whole structure instead of
its boundary, since a structure that is moved by more than its boundary's thickness leaves a gap there. What
few registrations reach is smoothed: single counts say next to nothing.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from study.margins.landing import _kernels
from study.margins.protrusion import appearance_counts, landing
from study.margins.region import Region
from study.threads import in_threads

#: Standard deviation of the Gaussian that smooths counts, voxels; wider ones blunt what many registrations
#: agree on.
SMOOTHING = 1.0


def coverage(region: Region, transforms: np.ndarray) -> np.ndarray:
    """(nx, ny, nz) array: smoothed share of registrations in which the structure appears in each voxel.

    Parameters
    ----------
    region : Region
    transforms : (n, 4, 4) array
        mm.
    """
    points = np.argwhere(region.solid).astype(float)
    counts = appearance_counts(region, transforms, points, np.zeros(region.shape, np.uint8))
    return _smoothed(counts / len(transforms), 0.0)


def loss(region: Region, transforms: np.ndarray) -> np.ndarray:
    """(nx, ny, nz) array: smoothed share of registrations in which each voxel lands outside the structure.

    Outside the structure it is 1.

    Parameters
    ----------
    region : Region
    transforms : (n, 4, 4) array
        mm.
    """
    voxels = np.argwhere(region.solid)
    moves = landing(region, transforms)
    found = []

    def part(piece: slice) -> None:
        counts = np.zeros(len(voxels), np.int32)
        _kernels.count_lost(moves[piece], voxels.astype(float), region.solid, counts)
        found.append(counts)

    in_threads(part, len(moves), least=500)
    share = np.ones(region.shape)
    share[tuple(voxels.T)] = sum(found[1:], found[0]) / len(transforms)
    return _smoothed(share, 1.0)


def _smoothed(share: np.ndarray, outside: float) -> np.ndarray:
    # Rounded, so that ties are ties whatever the order of summation.
    found = ndimage.gaussian_filter(share, SMOOTHING, mode="constant", cval=outside)
    return np.round(found, 9)


def millimetres_to(mask: np.ndarray, affine: np.ndarray) -> np.ndarray:
    """(nx, ny, nz) array: distance of voxel centres to the nearest one that is set, mm; 0 where set.

    Rounded, so that ties are ties whichever axis a distance is along.
    """
    axes = affine[:3, :3]
    steps = np.linalg.norm(axes, axis=0)
    if np.allclose(axes.T @ axes, np.diag(steps**2), atol=1e-6 * steps.max() ** 2):
        return np.round(ndimage.distance_transform_edt(~mask, sampling=steps), 9)
    tree = cKDTree(np.argwhere(mask) @ axes.T)
    voxels = np.argwhere(np.ones(mask.shape, bool))
    return np.round(tree.query(voxels @ axes.T, workers=-1)[0], 9).reshape(mask.shape)
