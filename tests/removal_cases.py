"""Margins to be removed and regions to stay in, by brute force: plain numpy over the whole padded volume."""

import numpy as np
from margin_cases import CASES, affine_of, around, blobs, shell, tube, volume_of
from scipy import ndimage

from study.margins import GrowthSettings
from study.registration import RobotError

SHAPES = ("spatially_varying", "constant_thickness")
FEW = GrowthSettings(registrations=300, validation_registrations=200, violation_registrations=600)


def printed(**changes):
    """Chapter 4's loop with few registrations, which many batches have to make up for."""
    few = {"registrations": 300, "validation_registrations": 200, "violation_registrations": 120}
    return GrowthSettings.for_removal("published", **{**few, "least_transfer": 15, **changes})


def turning(volume, position_std=0.3, rotation_std=0.05, at=(0, 0, 0)):
    return RobotError(volume.points(np.array([at], float))[0], position_std, rotation_std)


def removal_cases():
    """Name, volume, error source; those of chapter 3 that are not slow, and thicker structures."""
    for name in CASES:
        if name not in ("longer than a block", "turns of half a radian"):
            yield name, *CASES[name]
    oblique = affine_of((0.5, 0.8, 0.6), (0.7, -0.3, 2.1), (-80, 33, 410), (1, 2, 0), (-1, 1, 1))
    ball = volume_of(shell((19, 17, 18), (9, 8, 9), 0, 5.4), oblique)
    yield "ball, oblique and flipped", ball, turning(ball)
    mirrored = volume_of(blobs((18, 19, 17), 0.2, 5), affine_of((0.4, 0.4, 1.1), flip=(1, 1, -1)))
    yield "blobs, mirrored", mirrored, around(mirrored, 0.2, 6)
    capsule = volume_of(shell((21, 21, 21), (10, 10, 10), 3.0, 7.5))
    yield "thick shell with a cavity", capsule, turning(capsule, 0.25)
    half = np.zeros((14, 13, 12), bool)
    half[:7, 3:11, 2:10] = True
    cut = volume_of(half, affine_of((0.5, 0.5, 0.5), origin=(3, 2, 1)))
    yield "cut off by the edge", cut, turning(cut, (0.5, 0.2, 0.3), 0.02)
    far = turning(ball, 0.3, 0.12, (-8, 0, 0))
    yield "turns about a far point", ball, far
    rod = volume_of(ndimage.binary_dilation(tube((24, 12, 13), (4, 5, 5), (19, 6, 7)), iterations=2))
    yield "rod", rod, around(rod, 0.15, 9)


REMOVALS = {name: (volume, model) for name, volume, model in removal_cases()}


def drawn(model, seed, registrations=300, fresh=200):
    """The registrations that a seed gives: those to grow on and those to validate on."""
    growing, validating = np.random.default_rng(seed).spawn(2)
    return model.sample(registrations, growing), model.sample(fresh, validating)


def boundary(solid):
    """(n, 3) voxels with a face outside the structure; outside the array all is outside."""
    room = np.pad(solid, 1)
    inner = room.copy()
    for axis in range(3):
        inner &= np.roll(room, 1, axis) & np.roll(room, -1, axis)
    return np.argwhere(room & ~inner) - 1


def wide(volume, array, voxels, fill=False):
    """An array over a volume with more voxels on all sides, and where its voxel (0, 0, 0) is."""
    return np.pad(array, voxels, constant_values=fill)


def voxels_of(volume, points):
    return np.floor(volume.indices(points) + 0.5).astype(int)


def looked_up(array, voxels, outside):
    """Values of an array at voxels, `outside` beyond it."""
    there = ((voxels >= 0) & (voxels < array.shape)).all(axis=-1)
    out = np.full(voxels.shape[:-1], outside)
    out[there] = array[tuple(voxels[there].T)]
    return out


def appearing_voxels(volume, solid, transforms):
    """(n, m, 3) voxels of the volume, or beyond, in which the boundary's centres appear."""
    points = volume.points(boundary(solid).astype(float))
    homogeneous = np.column_stack([points, np.ones(len(points))])
    return np.array(
        [voxels_of(volume, np.linalg.solve(transform, homogeneous.T).T[:, :3]) for transform in transforms]
    )


def landing_voxels(volume, voxels, transforms):
    """(n, m, 3) voxels of the volume, or beyond, in which centres of voxels land."""
    points = volume.points(voxels.astype(float))
    return np.array(
        [voxels_of(volume, points @ transform[:3, :3].T + transform[:3, 3]) for transform in transforms]
    )


def leaves(union, voxels):
    """(n,) bool: does any of a registration's voxels lie outside a union?"""
    return (~looked_up(union, voxels, False)).any(axis=1)


def in_given(margin, volume):
    """(n, 3) indices in the volume that was given of the voxels of a margin's own."""
    return np.rint(volume.indices(margin.volume.points(np.argwhere(margin.mask).astype(float)))).astype(int)


def box_of(margin, volume):
    """Index in a volume of the first voxel of the box in which a margin's voxels are ranked."""
    return np.rint(volume.indices(margin.choice.region.affine[:3, 3][None])[0]).astype(int)


def ranks_of(margin, volume):
    """When each voxel of a margin's box enters it, and where that box begins in a volume."""
    order, region = margin.choice.ranking.order, margin.choice.region
    ranks = np.full(region.shape, len(order) + 1)
    ranks.reshape(-1)[order] = np.arange(1, len(order) + 1)
    return ranks, box_of(margin, volume)


def without_cavities(union):
    """A union and all that it encloses, by faces."""
    parts, _ = ndimage.label(~np.pad(union, 1))
    return (parts != parts[0, 0, 0])[1:-1, 1:-1, 1:-1]
