"""Small structures, and what margins around them are by brute force: plain numpy over the whole volume."""

import numpy as np
from scipy import ndimage
from scipy.spatial.transform import Rotation

from study.registration import CombinedErrors, ImageError, PointRegistration, RobotError
from study.volumes import LabelVolume

NAMES = {"air": 0, "nerve": 1}


def affine_of(spacing=(0.4, 0.4, 0.4), turn=(0, 0, 0), origin=(0, 0, 0), order=(0, 1, 2), flip=(1, 1, 1)):
    out = np.eye(4)
    out[:3, :3] = (Rotation.from_rotvec(turn).as_matrix() * flip)[:, list(order)] * spacing
    out[:3, 3] = origin
    return out


def volume_of(solid, affine=None):
    return LabelVolume(solid.astype(np.uint8), affine_of() if affine is None else affine, NAMES)


def tube(shape, start, stop):
    """Voxels that a straight line between two indices passes."""
    out = np.zeros(shape, bool)
    for share in np.linspace(0, 1, 400):
        out[tuple(np.rint(np.array(start) + share * (np.array(stop) - start)).astype(int))] = True
    return out


def blobs(shape, share, seed):
    field = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=shape), 1.7)
    return field > np.quantile(field, 1 - share)


def shell(shape, centre, inner, outer):
    far = np.linalg.norm(np.stack(np.indices(shape), -1) - centre, axis=-1)
    return (far >= inner) & (far <= outer)


def around(volume, fle=0.3, seed=0, **given):
    """A point registration with fiducials some way off the volume's middle."""
    middle = volume.points(np.array([volume.shape]) / 2 - 0.5)
    return PointRegistration(middle + np.random.default_rng(seed).normal(size=(5, 3)) * 15, fle, **given)


class Shifts:
    """An error source that only knows how to be drawn: shifts about a mean."""

    def __init__(self, mean, std):
        self.mean, self.std = mean, std

    def sample(self, n, rng=None):
        out = np.tile(np.eye(4), (n, 1, 1))
        out[:, :3, 3] = self.mean + np.random.default_rng(rng).normal(size=(n, 3)) * self.std
        return out


def cases():
    """Name, volume, error source."""
    one = volume_of(tube((16, 15, 17), (3, 4, 3), (12, 9, 13)))
    yield "tube", one, around(one)
    turned = affine_of((0.25, 0.5, 0.33), (0.4, -0.8, 1.9), (120, -40, 7), (2, 0, 1), (1, -1, 1))
    two = volume_of(blobs((14, 12, 16), 0.06, 1), turned)
    yield "oblique, anisotropic, several parts", two, around(two, (0.2, 0.4), 1)
    at_edge = volume_of(blobs((11, 12, 13), 0.3, 2), affine_of(origin=(5, 5, 5)))
    yield "at the edge on all sides", at_edge, around(at_edge, 0.4, 2)
    hollow = volume_of(shell((17, 17, 17), (8, 8, 8), 2.5, 4.5))
    yield "hollow", hollow, around(hollow, 0.25, 3)
    own = np.array(
        [np.diag([0.01, 0.04, 0.3]), np.diag([0.2, 0.01, 0.02]), *np.tile(np.eye(3) * 0.03, (3, 1, 1))]
    )
    yield "errors of every fiducial its own", one, around(one, 0.1, 4, image_covariances=own)
    yield "many voxels", one, around(one, 2.5, 5)
    centre = one.points(np.array([[2.0, 3, 15]]))[0]
    yield "turns of half a radian", two, RobotError(two.points(np.array([[3.0, 3, 3]]))[0], 0.3, 0.4)
    yield (
        "turns, shifts and scale",
        one,
        CombinedErrors(
            [
                around(one, 0.2, 6),
                ImageError(centre, scale_std=0.03, position_std=(0.05, 0.1, 0.2)),
                RobotError(centre, 0.1, 0.02, np.diag([0.01, 0.02, 0.03]), (5, 0, 0), 3.0),
            ]
        ),
    )
    yield "farther than it is thick", one, Shifts((0.0, 2.2, 0.1), 0.15)
    thin = volume_of(tube((72, 10, 11), (3, 4, 4), (68, 5, 7)), affine_of(turn=(0.1, 0, 0.2)))
    yield "longer than a block", thin, around(thin, 0.4, 7)
    tiny = volume_of(tube((12, 12, 12), (4, 5, 5), (8, 6, 5)) | tube((12, 12, 12), (4, 6, 6), (8, 6, 6)))
    yield "error far below a voxel", tiny, around(tiny, 0.02, 8)


CASES = {name: (volume, model) for name, volume, model in cases()}


# --- by brute force -------------------------------------------------------------------------------------


def touched(values, of_none):
    """For each lattice corner the largest value of the voxels that touch it."""
    padded = np.pad(values, 1, constant_values=of_none)
    parts = [
        padded[tuple(slice(o, o + n + 1) for o, n in zip(offset, values.shape, strict=True))]
        for offset in np.ndindex(2, 2, 2)
    ]
    return np.max(parts, axis=0)


def corner_hits(volume, solid, transforms):
    """(n, corners) bool: does a transform carry a lattice corner into a voxel of the structure?"""
    lattice = np.array(list(np.ndindex(*(n + 1 for n in solid.shape))))
    points = volume.points(lattice - 0.5)
    out = np.zeros((len(transforms), len(lattice)), bool)
    for found, transform in zip(out, transforms, strict=True):
        voxels = np.floor(volume.indices(points @ transform[:3, :3].T + transform[:3, 3]) + 0.5).astype(int)
        there = ((voxels >= 0) & (voxels < solid.shape)).all(axis=1)
        found[there] = solid[tuple(voxels[there].T)]
    return out


def needs_by_hand(ranks, hits):
    """(n,) largest rank of the voxels of which a transform carries a corner into the structure."""
    return (hits * touched(ranks, 0).reshape(-1)).max(axis=1)


def damaging_by_hand(solid, mask, hits):
    """(n,) bool: does tissue outside structure and margin get into the structure?"""
    milled = touched((~(solid | mask)).astype(int), 0).reshape(-1)
    return (hits & (milled > 0)).any(axis=1)


def surface_points(volume, solid):
    """Corners that touch voxels inside and outside, mm."""
    mixed = (touched(solid.astype(int), 0) > 0) & (touched((~solid).astype(int), 0) > 0)
    return volume.points(np.argwhere(mixed) - 0.5)


def distances_by_hand(volume, solid, voxels, covariances=None):
    """(n,) smallest distance from voxel centres to the surface, in mm or in standard deviations."""
    surface = surface_points(volume, solid)
    out = []
    for n, point in enumerate(volume.points(voxels.astype(float))):
        step = surface - point
        metric = np.eye(3) if covariances is None else np.linalg.inv(covariances[n])
        out.append(np.sqrt(np.einsum("ni,ij,nj->n", step, metric, step).min()))
    return np.array(out)
