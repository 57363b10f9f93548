"""A segmented bone together with its planning volume and its fiducials."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.errors import InputError, LabelError
from study.specimens.orientation import check_side, lateral_direction, surgical_view
from study.specimens.parameters import TemporalBoneParameters
from study.specimens.target import TargetRule
from study.volumes import LabelVolume

# Six places on a ring about the middle of the opened surface: angle from posterior towards superior
# (degrees), distance from the axis and height above the surface (mm). No two of the gaps between
# them are alike, so that no reordering fits another.
_RING = ((15, 22, 20), (75, 28, 22), (135, 24, 18), (195, 30, 21), (259, 23, 19), (315, 25, 23))


@dataclass(frozen=True, eq=False)
class Specimen:
    """A temporal bone, procedural or real, ready to be planned on.

    Attributes
    ----------
    name : str
    side : {"right", "left"}
    anatomy : LabelVolume
        Anatomical labels, LPS.
    planning : LabelVolume
        ``air``, ``protected``, ``target`` on the same grid.
    fiducials : (n, 3) array
        mm, in the same frame.
    rule : TargetRule or None
        What made the target; None if the target was read from a file.
    parameters : TemporalBoneParameters or None
        What made the bone; None for a real one.
    """

    name: str
    side: str
    anatomy: LabelVolume
    planning: LabelVolume
    fiducials: np.ndarray
    rule: TargetRule | None = None
    parameters: TemporalBoneParameters | None = None

    def __post_init__(self) -> None:
        check_side(self.side)
        if self.planning.shape != self.anatomy.shape or not np.allclose(
            self.planning.affine, self.anatomy.affine, atol=1e-3
        ):
            raise InputError(
                f"{self.name}: expected anatomy and planning volume on one grid, got "
                f"{self.anatomy.shape} and {self.planning.shape}"
            )
        fiducials = np.array(self.fiducials, dtype=float)
        if fiducials.ndim != 2 or fiducials.shape[1] != 3 or not np.isfinite(fiducials).all():
            raise InputError(f"{self.name}: expected fiducials of shape (n, 3), got {fiducials.shape}")
        fiducials.flags.writeable = False
        object.__setattr__(self, "fiducials", fiducials)

    @property
    def approach(self) -> np.ndarray:
        """(3,) unit vector from outside into the bone."""
        return -lateral_direction(self.side)


def fiducial_ring(planning: LabelVolume, side: str) -> np.ndarray:
    """Six fiducials around and above the opening, as on a frame that is fixed to the head.

    Parameters
    ----------
    planning : LabelVolume
        With a target.
    side : {"right", "left"}

    Returns
    -------
    (6, 3) array
        mm; 22 to 30 mm from the lateral axis through the centroid of the target's lateral surface,
        18 to 23 mm outside it, all gaps between them different. They may lie outside the image.

    Raises
    ------
    LabelError
        If the volume has no target.
    """
    outwards = lateral_direction(side)
    view = surgical_view(planning, side)
    target = view.turned(planning.mask("target"))
    columns = target.any(axis=0)
    if not columns.any():
        raise LabelError("expected a planning volume with target voxels, got none")
    # The most lateral target voxel of every column across the approach.
    surface = np.zeros(target.shape, bool)
    surface[np.argmax(target, axis=0)[columns], *np.nonzero(columns)] = True
    centre = planning.points(np.argwhere(view.back(surface))).mean(axis=0)
    angle, radius, height = np.array(_RING, dtype=float).T
    across = radius[:, None] * np.column_stack(
        [np.zeros(len(angle)), np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))]
    )
    return centre + across + height[:, None] * outwards
