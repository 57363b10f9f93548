"""Random volumes for the tests of study.volumes."""

import numpy as np
from scipy.spatial.transform import Rotation

from study.volumes import LabelVolume


def random_affine(rng: np.random.Generator) -> np.ndarray:
    """An oblique, possibly mirrored, anisotropic frame with its origin up to 300 mm off."""
    directions = Rotation.random(rng=rng).as_matrix()[:, rng.permutation(3)] * rng.choice([-1, 1], 3)
    affine = np.eye(4)
    affine[:3, :3] = directions * rng.uniform(0.1, 3, 3)
    affine[:3, 3] = rng.uniform(-300, 300, 3)
    return affine


def random_volume(rng: np.random.Generator, values=(0, 1, 2, 7, 255)) -> LabelVolume:
    """A few voxels of any shape with all sorts of names, one of which has no voxel."""
    labels = rng.choice(values, tuple(rng.integers(1, 9, 3))).astype(np.uint8)
    names = {
        "air": 0,
        "facial nerve": 1,
        "Gehörgang": 2,
        'a "quoted" \\ name: with := colons': 7,
        "last": 255,
        "没有": 9,
    }
    return LabelVolume(labels, random_affine(rng), names)
