"""Drills and walls for the tests of linear access."""

from functools import cache

import numpy as np

from study.guidance.access import AccessSettings, NormalErrors, plan_access
from study.specimens import specimen

ENTRY, TARGET = np.array([-20.0, 3.0, 2.0]), np.array([5.0, -1.0, 0.5])
FEW = AccessSettings(samples=1500, simulated=4, refined=2)


def segment_distances(points, start, end):
    """Plain distances (m,) of points from one segment."""
    line = end - start
    share = np.clip((points - start) @ line / (line @ line), 0, 1)
    return np.linalg.norm(start + share[:, None] * line - points, axis=1)


@cache
def planned(name="TB14", std=0.15):
    return plan_access(specimen(name).anatomy, settings=FEW, errors=NormalErrors(std, std))


def wall(distance):
    """Points of a wall, so dense and wide that it is flat for a drill along x, at y = distance."""
    x, z = np.meshgrid(np.arange(-30, 30, 0.1), np.arange(-0.3, 0.31, 0.1))
    return np.column_stack([x.ravel(), np.full(x.size, distance), z.ravel()])
