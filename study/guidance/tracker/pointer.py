"""A tracked pointer that touches points (Baron, section 4.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from study.errors import InputError
from study.guidance.frames import checked_transform, inverse, rigid
from study.guidance.tracker.markers import MarkerBody, facing_pose
from study.guidance.tracker.tracker import Tracker
from study.registration.rigid import checked_points
from study.registration.sources import checked_vector
from study.transforms import checked_transforms

#: How far a hand turns a pointer away from the camera, rad: some 20 degrees.
TILT = np.radians(20.0)


def touch(
    tracker: Tracker,
    pointer: MarkerBody,
    T_pointer_tip: ArrayLike,
    points: ArrayLike,
    T_cam_ref: ArrayLike,
    *,
    seating_std_mm: float,
    samples: int = 1,
    rng: object = None,
    tip_error_mm: ArrayLike = (0.0, 0.0, 0.0),
    reference: MarkerBody | None = None,
    tilt_rad: float = TILT,
) -> np.ndarray:
    """Touch points with a tracked pointer, once each, and say where they are in a reference marker's frame.

    Equation 3: both markers are measured at the same time, and the tip goes into the reference's frame. For
    each touch the pointer is held anew, its marker turned to the camera but for a tilt of the hand.

    Parameters
    ----------
    tracker : Tracker
    pointer : MarkerBody
    T_pointer_tip : (4, 4) array
        True place of the tip in the pointer's frame.
    points : (n, 3) array
        True points, mm, camera frame; a point that is touched again is in the list again.
    T_cam_ref : (4, 4) or (n, 4, 4) array
        True pose of the reference's marker, the same for all touches or one for each.
    seating_std_mm : float
        By which the tip misses a point, one axis, anew with each touch.
    samples : int
        Frames a touch, averaged.
    rng : anything `numpy.random.default_rng` takes
    tip_error_mm : (3,) array
        By which the pointer's own calibration misses its tip, pointer's axes: the same in every touch.
    reference : MarkerBody, optional
        A plate of 80 mm by default.
    tilt_rad : float
        Largest turn of the pointer away from facing the camera, rad.

    Returns
    -------
    (n, 3) array
        mm, the reference's frame.

    Raises
    ------
    InputError
        If an argument is not what it should be.
    """
    rng = np.random.default_rng(rng)
    points = checked_points("points", points)
    tip = checked_transform("T_pointer_tip", T_pointer_tip)[:3, 3]
    error = checked_vector("tip_error_mm", tip_error_mm, "mm")
    refs = np.asarray(T_cam_ref, dtype=float)
    refs = checked_transforms("T_cam_ref", refs[None] if refs.ndim == 2 else refs)
    if len(refs) not in (1, len(points)):
        raise InputError(f"T_cam_ref: expected one pose or {len(points)}, one a point, got {len(refs)}")
    for name, value in (("seating_std_mm", seating_std_mm), ("tilt_rad", tilt_rad)):
        if not np.isfinite(value) or value < 0:
            raise InputError(f"{name}: expected a finite number of at least 0, got {value!r}")
    seated = points + rng.standard_normal(points.shape) * seating_std_mm
    away = rng.standard_normal(points.shape)
    away *= tilt_rad * rng.uniform(size=(len(points), 1)) / np.linalg.norm(away, axis=1, keepdims=True)
    R = facing_pose(points)[:, :3, :3] @ Rotation.from_rotvec(away).as_matrix()
    held = rigid(R, seated - R @ tip)
    seen = tracker.measured(pointer, held, rng, samples)
    where = np.broadcast_to(refs, (len(points), 4, 4))
    base = tracker.measured(MarkerBody.plate() if reference is None else reference, where, rng, samples)
    found = seen[:, :3, :3] @ (tip + error) + seen[:, :3, 3]
    return np.einsum("nij,nj->ni", inverse(base)[:, :3, :3], found - base[:, :3, 3])
