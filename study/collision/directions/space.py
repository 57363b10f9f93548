"""Unmilled bone prepared for the 5-DOF check: rows of bits, a distance field, the cone of directions."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from study.collision.directions.field import _kernels
from study.collision.drill import Drill
from study.errors import InputError

SIGHT = 10.0  # mm up to which the distance field is exact; wider looks make longer steps in open air
#: A turn is checked at directions so close that nothing the shaft can meet moves by more than this share
#: of `sweep`. The replay of a plan uses steps of the same size, widened as well: 0.72^2 / 4 twice is 0.26.
TURN_SHARE = 0.72
LEAST_TURN = 1e-4  # radians, where there is no sweep to share
PATIENCE = 4000  # voxels milled before the field is brought up to date; only the speed depends on it


@lru_cache(maxsize=8)
def _cone(max_tilt: float, spacing: float) -> np.ndarray:
    n = int(np.floor(max_tilt / spacing + 1e-9))
    aside = np.arange(-n, n + 1) * spacing
    x, y = (a.ravel() for a in np.meshgrid(aside, aside, indexing="ij"))
    polar = np.hypot(x, y)
    inside = polar <= max_tilt + 1e-9
    x, y, polar = x[inside], y[inside], polar[inside]
    order = np.lexsort((y, x, np.round(polar, 9)))
    x, y, polar = x[order], y[order], polar[order]
    scale = np.sinc(polar / np.pi)
    directions = np.column_stack([x * scale, -np.cos(polar), y * scale])
    directions.flags.writeable = False
    return directions


def cone_of_directions(max_tilt: float, spacing: float) -> np.ndarray:
    """Directions in which the drill may point, evenly spread about the approach.

    Parameters
    ----------
    max_tilt : float
        Radians, the cone's half angle.
    spacing : float
        Radians between neighbours.

    Returns
    -------
    (n, 3) array
        Unit vectors [layer, depth, lateral] from the burr towards the drill body, the approach itself
        first, then outwards. They include tilts about either grid axis.
    """
    if not 0 < max_tilt < np.pi / 2 or not spacing > 0:
        raise InputError(
            f"cone: expected a half angle between 0 and 90 degrees and a spacing above 0, "
            f"got {np.degrees(max_tilt):g} and {np.degrees(spacing):g} degrees"
        )
    return _cone(float(max_tilt), float(spacing))


def build_free_space(
    solid: np.ndarray,
    steps: np.ndarray,
    drill: Drill,
    max_tilt: float,
    spacing: float = np.deg2rad(2.5),
    sweep: float | None = None,
) -> _kernels.FreeSpace:
    """Prepare a canonical volume for the 5-DOF check.

    Parameters
    ----------
    solid : (layers, depths, laterals) uint8 array
        Non-zero where the shaft must not go. Kept, not copied: the milling changes it.
    steps : (3,) array
        mm.
    drill : Drill
    max_tilt : float
        Radians from the approach, the cone in which `nearest_free` searches.
    spacing : float
        Radians between the directions it tries.
    sweep : float, optional
        mm by which the burr may move or the shaft's far end turn between two poses that are tested; the
        cylinders are widened to sqrt(R^2 + 0.27 sweep^2) and made `sweep` longer at both ends, so that
        the motion between two free poses is free. 0 for the drill as it is; one voxel diagonal by default.

    Returns
    -------
    study.collision.directions.field._kernels.FreeSpace
    """
    steps = np.ascontiguousarray(steps, dtype=float)
    sweep = float(np.linalg.norm(steps)) if sweep is None else float(sweep)
    cylinders = np.array(drill.cylinders)
    cylinders[:, 0] = np.sqrt(cylinders[:, 0] ** 2 + 0.27 * sweep**2)
    cylinders[:, 1] = np.maximum(cylinders[:, 1] - sweep, 0.0)
    cylinders[:, 2] += sweep
    bits = np.empty((*solid.shape[:2], (solid.shape[2] + 63) // 64), np.uint64)
    _kernels.pack_bits(solid, bits)
    distance = np.zeros(solid.shape, np.uint8)
    shape = np.array(solid.shape, np.int64)
    _kernels.raise_distance(solid, steps, distance, np.zeros(3, np.int64), shape, SIGHT)
    dirty = np.stack([shape, np.zeros(3, np.int64)])
    lever = min(float(cylinders[-1, 2]), float(np.linalg.norm(shape * steps)))
    directions = cone_of_directions(max_tilt, spacing)
    n = len(directions)
    return _kernels.FreeSpace(
        solid=solid,
        bits=bits,
        distance=distance,
        dirty=dirty,
        counts=np.zeros(4, np.int64),
        rays=np.ascontiguousarray(directions.T, dtype=np.float32),
        keys=np.empty(n, np.int32),
        witnesses=np.empty(2 * n, np.int32),
        cylinders=cylinders,
        steps=steps,
        burr_radius=float(drill.burr_radius),
        directions=directions,
        max_tilt=float(max_tilt),
        turn_step=max(TURN_SHARE * sweep / lever, LEAST_TURN),
        patience=PATIENCE,
    )
