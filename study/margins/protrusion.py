"""Overall damage risk of tissue that must be removed: how often the structure protrudes from its margin.

What is removed is what appears inside structure and margin in the image. A registration shows a point of the
patient where the inverse of its transform puts it, so it does damage, that is, leaves a part of the structure
behind, when the centre of one of the structure's boundary voxels is put outside structure and margin
(Siebold, 4.2.3). Boundary voxels have a face outside the structure. Without registration error none of them
protrudes.

For a region to stay in, the other way round: a voxel of the region is lost when its centre lands, by the
transform, outside the structure.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy import ndimage

from study.errors import InputError
from study.margins.landing import _kernels
from study.margins.overall_risk import RiskEstimate
from study.margins.region import Region, bounding_box
from study.threads import in_threads
from study.volumes import LabelVolume

#: Volume of what a unit of volume becomes, from which on a transform has an inverse.
_SINGULAR = 1e-9


def boundary_centres(solid: np.ndarray) -> np.ndarray:
    """(n, 3) float array: indices of voxels that have a face outside; beyond the array all is outside."""
    solid = solid.astype(bool)
    return np.argwhere(solid & ~ndimage.binary_erosion(solid)).astype(float)


def appearing(region: Region, transforms: np.ndarray) -> np.ndarray:
    """(n, 3, 4) float array: where the patient's points appear in the image, from voxels to voxels.

    Parameters
    ----------
    region : Region
    transforms : (n, 4, 4) array
        Where an image point lands, mm.
    """
    return _in_voxels(region, inverted(transforms))


def farthest_moved(volume: LabelVolume, mask: np.ndarray, transforms: np.ndarray) -> tuple[np.ndarray, float]:
    """(n,) how far from itself any point of a structure's box appears in each registration, mm.

    And how much farther, at most, the centre of the voxel that it appears in is from the structure's surface.
    """
    low, high = bounding_box(mask)
    # The displacement is affine in the point, so that it is longest at a corner of the box.
    box = volume.points(np.array(list(product(*zip(low - 0.5, high - 0.5, strict=True)))))
    inverse = inverted(transforms)
    moved = np.einsum("nab,mb->nma", inverse[:, :3, :3], box) + inverse[:, None, :3, 3] - box
    return np.linalg.norm(moved, axis=2).max(axis=1), float(volume.spacing.sum())


def inverted(transforms: np.ndarray) -> np.ndarray:
    """(n, 4, 4) inverses.

    Raises
    ------
    InputError
        If a transform maps different points to one.
    """
    size = np.abs(np.linalg.det(transforms[:, :3, :3]))
    if not (size > _SINGULAR).all():
        n = int((~(size > _SINGULAR)).argmax())
        raise InputError(
            f"model: expected transforms that keep volumes apart from 0, got one that shrinks them to "
            f"{size[n]:.3g} times as much: {transforms[n].tolist()}"
        )
    return np.linalg.inv(transforms)


def landing(region: Region, transforms: np.ndarray) -> np.ndarray:
    """(n, 3, 4) float array: the transforms themselves, from voxels to voxels."""
    return _in_voxels(region, transforms)


def _in_voxels(region: Region, transforms: np.ndarray) -> np.ndarray:
    moved = np.linalg.inv(region.affine) @ transforms @ region.affine
    return np.ascontiguousarray(moved[:, :3])


def largest_protrusions(
    region: Region, rank: np.ndarray, transforms: np.ndarray, beyond: int = 1, first_only: bool = False
) -> np.ndarray:
    """For each registration the largest rank of a voxel in which the structure's boundary appears.

    Parameters
    ----------
    region : Region
    rank : (nx, ny, nz) int32 array
        0 in the structure.
    transforms : (n, 4, 4) array
        mm.
    beyond : int
        Rank of what is outside the region's box.
    first_only : bool
        Only ask whether there is one above 0.

    Returns
    -------
    (n,) int32 array
    """
    points, moves = boundary_centres(region.solid), appearing(region, transforms)
    out = np.empty(len(moves), np.int32)

    def part(piece: slice) -> None:
        _kernels.largest_ranks(moves[piece], points, rank, np.int64(beyond), first_only, out[piece])

    in_threads(part, len(moves), least=500)
    return out


def protrusion_risk(region: Region, union: np.ndarray, transforms: np.ndarray) -> RiskEstimate:
    """Share of registrations in which the structure's boundary leaves `union`, structure and margin.

    Parameters
    ----------
    region : Region
        What is outside its box is outside the union.
    union : (nx, ny, nz) uint8 array
    transforms : (n, 4, 4) array
        mm.
    """
    outside = (union == 0).astype(np.int32)
    hits = largest_protrusions(region, outside, transforms, first_only=True)
    return RiskEstimate(int(np.count_nonzero(hits)), len(transforms))


def largest_losses(
    region: Region, order: np.ndarray, ranks: np.ndarray, transforms: np.ndarray
) -> np.ndarray:
    """For each registration the largest rank of the structure's voxels that land outside it.

    Parameters
    ----------
    region : Region
    order : (m,) int array
        Flat indices of voxels of the structure.
    ranks : (m,) int array
        Above 0.
    transforms : (n, 4, 4) array
        mm.

    Returns
    -------
    (n,) int32 array
        0 where all land in the structure.
    """
    last_first = np.argsort(ranks, kind="stable")[::-1]
    points = np.column_stack(np.unravel_index(order[last_first], region.shape)).astype(float)
    ranks = np.ascontiguousarray(ranks[last_first], dtype=np.int32)
    moves = landing(region, transforms)
    out = np.empty(len(moves), np.int32)

    def part(piece: slice) -> None:
        _kernels.largest_lost(moves[piece], points, ranks, region.solid, out[piece])

    in_threads(part, len(moves), least=500)
    return out


def appearance_counts(
    region: Region, transforms: np.ndarray, points: np.ndarray, union: np.ndarray
) -> np.ndarray:
    """(nx, ny, nz) int32 array: registrations in which any of the points appears in each voxel.

    Parameters
    ----------
    region : Region
    transforms : (n, 4, 4) array
        mm.
    points : (m, 3) float array
        Voxels of the region.
    union : (nx, ny, nz) uint8 array
        Where nothing is counted.
    """
    moves = appearing(region, transforms)
    found = []

    def part(piece: slice) -> None:
        counts, seen = np.zeros(region.shape, np.int32), np.zeros(region.shape, np.int32)
        _kernels.count_violations(moves[piece], points, union, seen, counts)
        found.append(counts)

    in_threads(part, len(moves), least=500)
    return sum(found[1:], found[0])


def counted_violations(region: Region, union: np.ndarray, transforms: np.ndarray) -> np.ndarray:
    """(nx, ny, nz) int32 array: registrations in which the structure's boundary overlaps each voxel.

    Zero in `union`; the text's point damage risk is this over the number of registrations (4.2.4).
    """
    return appearance_counts(region, transforms, boundary_centres(region.solid), union)
