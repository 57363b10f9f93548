"""Room for a margin: voxels beyond the edge of an image, when tissue there has to be removed too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from study.errors import GeometryError
from study.margins.region import Region, bounding_box, steps_per_mm
from study.volumes import LabelVolume

_EMPTY = ("background", "air")
#: A margin that needs more voxels to look at than this is no margin any more.
_MOST_VOXELS = 10_000_000
#: Registrations that move a structure so many times as far as all others get no room of their own; those that
#: do so many times as far as the median one are called gross.
_GROSS, _FAR = 2.0, 5.0


def room_for(
    volume: LabelVolume, mask: np.ndarray, moved: np.ndarray, few: int, most: int, beyond: float
) -> float:
    """How far from a structure a margin to be removed is looked for, mm.

    Parameters
    ----------
    volume : LabelVolume
    mask : (nx, ny, nz) bool array
        The structure.
    moved : (n,) array
        How far each registration moves the structure, mm.
    few, most : int
        Registrations that get no room of their own, since what they move out of sight protrudes anyway:
        `few`, but up to `most` where these move the structure more than twice as far as all others.
    beyond : float
        Added, mm.

    Raises
    ------
    GeometryError
        If the remaining ones scatter so far that there are too many voxels to look at.
    """
    farthest = np.sort(moved)[::-1]
    longest = float(farthest[few] if farthest[few] <= _GROSS * farthest[most] else farthest[most])
    low, high = bounding_box(mask)
    size = np.prod(high - low + 2.0 * np.ceil((longest + beyond) * steps_per_mm(volume.affine)))
    if size > _MOST_VOXELS:
        usual = float(np.median(moved))
        limit = max(longest / 2, _FAR * usual)
        gross = int(np.count_nonzero(moved > limit))
        named = f"; {gross} of {len(moved)} are gross misregistrations, by more than {limit:.4g} mm"
        raise GeometryError(
            f"room: expected registrations of which all but {most} ask for at most {_MOST_VOXELS:.3g} voxels "
            f"to be looked at, got {size:.3g} voxels of {volume.spacing.round(3).tolist()} mm: they move the "
            f"structure by up to {longest:.4g} mm, the median one by {usual:.4g} mm{named if gross else ''}"
        )
    return longest + beyond


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
        If there is no such label.
    """
    low, high = bounding_box(mask)
    wanted = np.ceil(reach * steps_per_mm(volume.affine)).astype(int) + voxels
    have = np.column_stack([low, np.array(mask.shape) - high])
    added = np.maximum(wanted[:, None] - have, 0)
    if not added.any():
        return volume, mask, added
    # What is labelled 0 is empty by custom, but for a structure that is.
    named = [name for name, value in volume.names.items() if value == 0 and (volume.labels[mask] > 0).all()]
    empty = next((name for name in (*_EMPTY, *named) if name in volume.names), None)
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


def with_edge(region: Region) -> Region:
    """A box with one voxel more on all sides: the edge of a volume becomes a surface of what it cuts off."""
    affine = region.affine.copy()
    affine[:3, 3] -= affine[:3, :3].sum(axis=1)
    return replace(region, solid=np.pad(region.solid, 1), low=region.low - 1, affine=affine)
