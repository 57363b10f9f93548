"""Which part of a kidney's surface a swab can touch at all."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from study.errors import InputError
from study.volumes import LabelVolume

if TYPE_CHECKING:
    import trimesh


def reachable_vertices(
    surface: trimesh.Trimesh, anatomy: LabelVolume, ball_mm: float = 10.0, tolerance_mm: float = 3.0
) -> np.ndarray:
    """Vertices that a ball can come near from outside; the walls of the sinus are not among them.

    A registration to nearest vertices that starts a centimetre too deep finds the walls of the sinus and
    may stay there, though no swab was ever traced on them. Leaving them out keeps it from that.

    Parameters
    ----------
    surface : trimesh.Trimesh
        mm.
    anatomy : LabelVolume
        With ``kidney`` and ``tumour``, whose surface it is.
    ball_mm : float
        Radius of the ball.
    tolerance_mm : float
        How far from the ball a vertex may be and still count.

    Returns
    -------
    (n,) bool array
        One a vertex.

    Raises
    ------
    InputError
        If a length is not positive and finite.
    """
    for name, value in (("ball_mm", ball_mm), ("tolerance_mm", tolerance_mm)):
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name}: expected mm above 0, got {value}")
    mask = anatomy.mask("kidney", "tumour")
    box = ndimage.find_objects(mask.astype(np.uint8))[0]
    pad = np.ceil((ball_mm + tolerance_mm) / anatomy.spacing).astype(int) + 2
    body = np.pad(mask[box], [(n, n) for n in pad])
    centres = ndimage.distance_transform_edt(~body, sampling=anatomy.spacing) >= ball_mm
    away = ndimage.distance_transform_edt(~centres, sampling=anatomy.spacing)
    start = np.array([part.start for part in box]) - pad
    place = anatomy.indices(surface.vertices) - start
    return ndimage.map_coordinates(away, place.T, order=1, mode="nearest") <= ball_mm + tolerance_mm
