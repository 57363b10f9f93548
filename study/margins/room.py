"""Room for a margin: voxels beyond the edge of an image, when tissue there has to be removed too."""

from __future__ import annotations

import numpy as np

from study.errors import GeometryError
from study.margins.region import bounding_box, steps_per_mm
from study.volumes import LabelVolume

_EMPTY = ("background", "air")
#: A margin that needs more voxels to look at than this is no margin any more.
_MOST_VOXELS = 200_000_000


def with_room(
    volume: LabelVolume, mask: np.ndarray, reach: float, voxels: int = 4
) -> tuple[LabelVolume, np.ndarray, np.ndarray]:
    """Add empty voxels where a structure is nearer to the edge of its volume than a margin may reach.

    Parameters
    ----------
    volume : LabelVolume
    mask : (nx, ny, nz) bool array
        The structure.
    reach : float
        mm.
    voxels : int
        Beyond that.

    Returns
    -------
    volume : LabelVolume
        With ``background`` or ``air`` (or whatever label 0 is called) at the ends where room was missing.
    mask : bool array
        The structure in it.
    added : (3, 2) int array
        Voxels added at either end of each axis.

    Raises
    ------
    GeometryError
        If there is no such label, or so much room would take more memory than there is.
    """
    low, high = bounding_box(mask)
    wanted = np.ceil(reach * steps_per_mm(volume.affine)).astype(int) + voxels
    have = np.column_stack([low, np.array(mask.shape) - high])
    added = np.maximum(wanted[:, None] - have, 0)
    if not added.any():
        return volume, mask, added
    size = float(np.prod(np.array(mask.shape, dtype=float) + added.sum(axis=1)))
    if size > _MOST_VOXELS:
        raise GeometryError(
            f"room: expected a margin within the reach of the volume, got one of {reach:.1f} mm, for which "
            f"{size:.3g} voxels would have to be looked at"
        )
    names = {value: name for name, value in reversed(volume.names.items())}
    empty = next((name for name in _EMPTY if name in volume.names), names.get(0))
    if empty is None:
        raise GeometryError(
            f"room: a margin of {reach:.1f} mm leaves the volume by {added.tolist()} voxels (i, j, k; low "
            f"and high end), and there is no label 'background', 'air' or 0 to pad it with, only "
            f"{sorted(volume.names)}"
        )
    labels = np.pad(volume.labels, added, constant_values=volume.names[empty])
    affine = volume.affine.copy()
    affine[:3, 3] = volume.points(-added[:, 0].astype(float)[None])[0]
    return LabelVolume(labels, affine, volume.names), np.pad(mask, added), added


def without_room(mask: np.ndarray, added: np.ndarray) -> np.ndarray:
    """The part of a mask that belongs to the volume before `with_room`."""
    ends = np.array(mask.shape) - added[:, 1]
    return mask[tuple(slice(a, b) for a, b in zip(added[:, 0], ends, strict=True))]
