"""A kidney of few voxels with a tumour that sticks out, on which fits and margins take no time."""

from functools import cache

import numpy as np

from study.registration import IcpSettings, SurfaceRegistration
from study.specimens import KidneyCase, SwabRule
from study.volumes import LabelVolume

NAMES = {"background": 0, "kidney": 1, "tumour": 2}


@cache
def small_kidney():
    """An ellipsoid, 30 x 22 x 40 mm, with a ball of 9 mm; the grid's axes are not those of the body."""
    affine = np.array([[0.0, -1.5, 0, 30], [1.5, 0, 0, -22], [0, 0, 1.5, -34], [0, 0, 0, 1]])
    empty = LabelVolume(np.zeros((30, 41, 46), np.uint8), affine, NAMES)
    points = empty.points(np.argwhere(np.ones(empty.shape, bool)))
    bean = np.linalg.norm(points / [15.0, 11.0, 20.0], axis=1) < 1 + 0.08 * np.sin(points[:, 2] / 5)
    ball = np.linalg.norm(points - [13.0, -4.0, 9.0], axis=1) < 4.5
    labels = np.where(ball, 2, bean).astype(np.uint8).reshape(empty.shape)
    return KidneyCase("small", "left", empty.with_labels(labels), swab_rule=SwabRule(points=150, step_mm=2.0))


@cache
def loose(iterations=4):
    """Its registration, stopped so early that a margin is needed."""
    case = small_kidney()
    return SurfaceRegistration(
        case.surface, case.swab, 1.5, 3.0, settings=IcpSettings(max_iterations=iterations), digitiser_std=0.0
    )


def tumour_points():
    volume = small_kidney().anatomy
    return volume.points(np.argwhere(volume.mask("tumour")))
