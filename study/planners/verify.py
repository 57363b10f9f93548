"""Replay of a plan without the planner: it cuts only what it may, and the shaft stays free."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from study.errors import PlanViolation
from study.planners import _kernels

if TYPE_CHECKING:
    from study.planners.plan import Plan


def verify_plan(plan: Plan) -> pd.Series:
    """Sweep burr and shaft along every segment of a plan.

    The burr is a ball, moved along the straight segments; a targeted voxel is milled when the moving
    ball overlaps it. The shaft is three finite cylinders, tested against the cubes of all voxels that
    are solid after the burr has swept the segment. Nothing of the planner's bookkeeping is used: no
    windows, slabs, masks or canonical frames.

    Parameters
    ----------
    plan : Plan
        With its volume.

    Returns
    -------
    pandas.Series
        points, poses_checked, removed_mm3, remaining_target_mm3.

    Raises
    ------
    PlanViolation
        If the burr touches protected bone or leaves the image, the shaft touches unmilled bone, or
        the volume removed at a point is not what the plan says. The message names the point and voxel.
    InputError
        If the plan has no volume.
    """
    volume = plan.volume
    air, target = volume.mask("air"), volume.mask("target")
    solid = np.where(air, 0, np.where(target, 2, 1)).astype(np.uint8)
    spacing = volume.spacing
    points = volume.indices(plan.points) * spacing
    axes = plan.axes @ volume.directions
    norms = np.linalg.norm(axes, axis=1)
    if np.abs(norms - 1).max() > 1e-6:
        raise PlanViolation(
            f"axes: expected unit vectors, got lengths {norms.min():.6g} to {norms.max():.6g}"
        )
    axes = np.ascontiguousarray(axes / norms[:, None])
    removed = plan.removed / volume.voxel_volume
    cylinders = np.array(plan.drill.cylinders)
    corners = np.array([[-0.5] * 3, np.array(volume.shape) - 0.5]) * spacing
    farthest = np.linalg.norm(np.maximum(np.abs(points - corners[0]), np.abs(points - corners[1])), axis=1)
    lever = min(float(farthest.max()), float(cylinders[-1, 2]))
    hit = np.zeros(3, np.int64)
    status, row, count, poses = _kernels.replay(
        solid, spacing, points, axes, removed, plan.drill.burr_radius, cylinders, lever, hit
    )
    if status != _kernels.FINE:
        where = f"point {row} of {len(points)} at {np.round(plan.points[row], 3).tolist()} mm"
        voxel = hit.tolist()
        raise PlanViolation(
            {
                _kernels.CUT_PROTECTED: f"{where}: the burr cuts protected voxel {voxel}",
                _kernels.LEFT_IMAGE: f"{where}: the burr leaves the image at voxel {voxel}",
                _kernels.SHAFT_HIT: f"{where}: the shaft touches unmilled voxel {voxel}",
                _kernels.WRONG_REMOVAL: (
                    f"{where}: the burr removes {count} voxels, the plan says {removed[row]:.6g}"
                ),
            }[status]
        )
    left = np.count_nonzero(solid == 2) * volume.voxel_volume
    if plan.remaining is not None:
        claimed = plan.remaining.volume_mm3("target")
        if not np.array_equal(plan.remaining.mask("target"), solid == 2):
            raise PlanViolation(
                f"remaining: the plan says {claimed:.3f} mm^3 of target, the replay {left:.3f}"
            )
    return pd.Series(
        {
            "points": len(points),
            "poses_checked": poses,
            "removed_mm3": float(plan.removed.sum()),
            "remaining_target_mm3": float(left),
        }
    )
