"""Compiling this room's kernels ahead of time."""

from __future__ import annotations

import numpy as np

from study.guidance.access.candidates import nearest_on_lines
from study.guidance.access.collision import collision_probability


def warm() -> None:
    """Call every kernel once with next to nothing."""
    entry, target = np.zeros(3), np.array([0.0, 0.0, 10.0])
    points = np.array([[3.0, 0.0, 5.0]])
    collision_probability({"point": points}, entry, target, np.zeros((1, 2, 3)), 1.0)
    nearest_on_lines(points, entry[None], target)
