"""Milling as it proceeds: the bone that is left at moments of a plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.errors import InputError, PlanViolation
from study.planners import Plan
from study.planners import _kernels as planner_kernels
from study.volumes import LabelVolume


@dataclass(frozen=True, eq=False)
class MillingFrame:
    """A plan stopped on the way.

    Attributes
    ----------
    row : int
        Of the plan.
    position, axis : (3,) arrays
        Burr centre in mm, unit vector towards the drill body.
    remaining : LabelVolume
        air, protected, target; what is milled so far is air.
    removed_mm3 : float
        Bone removed so far.
    path_mm : float
        Way of the burr's centre so far.
    """

    row: int
    position: np.ndarray
    axis: np.ndarray
    remaining: LabelVolume
    removed_mm3: float
    path_mm: float


def milling_frames(plan: Plan, n: int = 6) -> list[MillingFrame]:
    """Stop a plan after each n-th of the bone that it removes.

    Parameters
    ----------
    plan : Plan
        With its volume.
    n : int
        How many frames; the last one is when the last bone has gone.

    Returns
    -------
    list of MillingFrame

    Raises
    ------
    InputError
        If `n` is less than 1, or the plan removes nothing or has no volume.
    PlanViolation
        If the plan does not remove what it says, or cuts protected bone.
    """
    total = float(plan.removed.sum())
    if n < 1 or total <= 0:
        raise InputError(f"expected at least 1 frame of a plan that removes bone, got {n} of {total:g} mm^3")
    volume = plan.volume
    removed = np.cumsum(plan.removed)
    way = np.concatenate([[0.0], np.cumsum(plan.step_lengths)])
    rows = np.searchsorted(removed, total * np.arange(1, n + 1) / n * (1 - 1e-12))
    solid = np.where(volume.mask("air"), 0, np.where(volume.mask("target"), 2, 1)).astype(np.uint8)
    points = volume.indices(plan.points) * volume.spacing
    axes = np.ascontiguousarray(plan.axes @ volume.directions)
    claimed = plan.removed / volume.voxel_volume
    hit = np.zeros(3, np.int64)
    frames, done = [], 0
    for row in rows:
        # from the last frame's row on, which has been replayed: the burr only sweeps on from there
        part = slice(max(done - 1, 0), row + 1)
        claims = claimed[part].copy()
        if done:
            claims[0] = 0.0
        status, failed, _, _ = planner_kernels.replay(
            solid, volume.spacing, points[part], axes[part], claims,
            plan.drill.burr_radius, np.empty((0, 3)), 0.0, hit,
        )  # fmt: skip
        if status != planner_kernels.FINE:
            raise PlanViolation(f"point {part.start + failed}: the replay stops; see Plan.verify()")
        done = row + 1
        left = volume.with_labels(solid.copy(), {"air": 0, "protected": 1, "target": 2})
        frames.append(
            MillingFrame(
                int(row), plan.points[row], plan.axes[row], left, float(removed[row]), float(way[row])
            )
        )
    return frames
