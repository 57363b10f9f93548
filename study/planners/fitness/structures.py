"""A ready-made term that leaves bone around critical structures for last (Siebold, 2.5.3)."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from study.errors import InputError
from study.planners.fitness.terms import FitnessTerm


def leave_for_last(
    structure: np.ndarray,
    spacing: np.ndarray,
    weight: float,
    reach_mm: float = 5.0,
    burr_radius: float = 2.5,
    name: str = "leave for last",
) -> FitnessTerm:
    """Prefer candidates away from a structure, so that the bone around it goes last.

    The score is the gap between the burr, were it at the candidate, and the structure, over
    `reach_mm`: 0 where the burr touches the structure, 1 from `reach_mm` on.

    Parameters
    ----------
    structure : (nx, ny, nz) bool array
        On the grid of the volume that is planned on, such as
        ``specimen("TB03").anatomy.mask("facial_nerve")``. Join several with ``|``.
    spacing : (3,) array
        Of the grid, mm.
    weight : float
        Relative to the printed 1, 1, 10, 5, 1.
    reach_mm : float
        From the structure's surface to where it no longer matters.
    burr_radius : float
        mm; ``Drill().burr_radius`` by default.
    name : str

    Returns
    -------
    FitnessTerm

    Raises
    ------
    InputError
        If the structure has no voxel, or `reach_mm` or `burr_radius` is not above 0.
    """
    structure = np.asarray(structure, dtype=bool)
    if structure.ndim != 3 or not structure.any():
        raise InputError(
            "structure: expected an (nx, ny, nz) mask with a voxel set, got one of shape "
            f"{structure.shape} with {np.count_nonzero(structure)}"
        )
    for what, value in (("reach_mm", reach_mm), ("burr_radius", burr_radius)):
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{what}: expected mm above 0, got {value!r}")
    gap = ndimage.distance_transform_edt(~structure, sampling=spacing) - burr_radius
    return FitnessTerm(name, weight, np.clip(gap / reach_mm, 0.0, 1.0).astype(np.float32))
