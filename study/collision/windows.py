"""4-DOF accessibility (2.2.3): slabs collapsed per shaft diameter, exact windows of accessible angles."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from study.collision import _kernels
from study.collision.drill import Drill
from study.errors import InputError


@lru_cache(maxsize=16)
def _tables(drill: Drill, steps: tuple[float, float, float], max_tilt: float, reach_mm: float):
    """Geometry of the collapsed check that does not depend on the bone."""
    step_layer, step_depth, step_lateral = steps
    sweep = float(np.sqrt(sum(step**2 for step in steps)))
    cylinders = np.array(drill.cylinders)
    # Between two positions one voxel apart the shaft stays within the union of both ends widened to
    # sqrt(R^2 + (step/2)^2) and started one step earlier; 0.27 leaves room for a sampled replay.
    radius = np.sqrt(cylinders[:, 0] ** 2 + 0.27 * sweep**2)
    start = np.maximum(cylinders[:, 1] - sweep, 0.0)
    half = np.ceil(radius / step_layer + 0.5).astype(np.int64) - 1
    inward = int(np.ceil(radius.max() / step_depth)) + 1
    rows = inward + int(np.ceil(reach_mm / step_depth)) + 2
    widest = reach_mm * np.tan(max_tilt) + radius.max() / np.cos(max_tilt)
    laterals = int(np.ceil(widest / step_lateral)) + 3
    tables = _kernels.interval_tables(
        (rows, laterals), inward, half, radius, start, step_layer, step_depth, step_lateral, drill.burr_radius
    )
    return half, radius, start, inward, tables


def build_shaft(solid: np.ndarray, steps: np.ndarray, drill: Drill, max_tilt: float) -> _kernels.Shaft:
    """Collapse a canonical volume for a drill.

    Parameters
    ----------
    solid : (layers, depths, laterals) uint8 array
        Non-zero where the shaft must not go.
    steps : (3,) array
        mm.
    drill : Drill
    max_tilt : float
        Radians.

    Returns
    -------
    study.collision._kernels.Shaft
        For `accessible_window` and `pose_is_free`; its slabs follow the milling.

    Raises
    ------
    InputError
        If the voxels are so small that a slab would hold more than 255 layers.
    """
    steps = np.asarray(steps, dtype=float)
    reach_mm = float(np.ceil(solid.shape[1] * steps[1] / 8) * 8)  # rounded, so that the tables can be reused
    half, radius, start, inward, tables = _tables(drill, tuple(steps.tolist()), float(max_tilt), reach_mm)
    if 2 * half.max() + 1 > 255:
        raise InputError(
            f"spacing: expected voxels of at least {2 * radius.max() / 253:.3f} mm along the rotation axis "
            f"for a shaft of {2 * drill.cylinders[-1][0]:g} mm, got {steps[0]:g} mm"
        )
    slab = np.empty((3, *solid.shape), np.uint8)
    bits = np.empty((3, *solid.shape[:2], (solid.shape[2] + 63) // 64), np.uint64)
    outermost = np.empty((3, solid.shape[0]), np.int64)
    _kernels.collapse_slabs(solid, half, slab, bits, outermost)
    return _kernels.Shaft(
        slab, bits, outermost, *tables, half, radius, start, inward,
        float(steps[0]), float(steps[1]), float(steps[2]), float(drill.burr_radius), float(max_tilt),
    )  # fmt: skip


def window(
    shaft: _kernels.Shaft,
    position: tuple[int, int, int],
    current: tuple[float, float] | None = None,
    min_width: float = 0.0,
    min_overlap: float = 0.0,
) -> tuple[float, float] | None:
    """The range of accessible angles of one canonical voxel, radians; None if there is none.

    Parameters
    ----------
    shaft : Shaft
        From `build_shaft`.
    position : (3,) ints
        Canonical voxel (layer, depth, lateral) of the burr's centre.
    current : (low, high), optional
        Range that the new one has to overlap; among several the one overlapping most is returned.
    min_width, min_overlap : float
        Radians (2.3.3).
    """
    low, high = current if current is not None else (-shaft.max_tilt, shaft.max_tilt)
    accessible, a, z = _kernels.accessible_window(
        shaft, *(int(p) for p in position), float(low), float(high), float(min_width), float(min_overlap)
    )
    return (a, z) if accessible else None
