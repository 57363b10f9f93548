"""Small volumes to plan on: a cone of target in a block of bone under air."""

import numpy as np

from study.volumes import PLANNING_NAMES, LabelVolume


def cone_volume(
    shape=(44, 46, 42), spacing=(0.4, 0.4, 0.4), depth=10.0, top=7.0, opening=0.35, air=5.0, undercut=0.0
):
    """Block of protected bone below `air` mm of air; a cone of target, drilled along +i.

    `undercut` mm widens the cone's lower half beyond its upper half.
    """
    i, j, k = (np.arange(n) * s for n, s in zip(shape, spacing, strict=True))
    x, y, z = np.meshgrid(i - air, j - j.mean(), k - k.mean(), indexing="ij")
    labels = np.where(x < 0, 0, 1)
    radius = top - opening * x + np.where(x > depth / 2, undercut, 0)
    labels[(x >= 0) & (x < depth) & (np.hypot(y, z) < radius)] = 2
    return LabelVolume(labels.astype(np.uint8), np.diag([*spacing, 1.0]), PLANNING_NAMES)


def small_cone(**changes):
    """A cone small enough to plan in a few hundredths of a second."""
    settings = {"shape": (30, 32, 30), "depth": 4.8, "top": 4.6, "air": 4.0} | changes
    return cone_volume(**settings)
