"""How much empty space a kidney's volume has around what it shows."""

from __future__ import annotations

import numpy as np

from study.volumes import LabelVolume

#: mm from the tumour, and from the kidney, to the end of the grid; the margin grows in the first.
TUMOUR_ROOM = 42.0
KIDNEY_ROOM = 12.0


def with_room(
    volume: LabelVolume, tumour_room: float = TUMOUR_ROOM, kidney_room: float = KIDNEY_ROOM
) -> LabelVolume:
    """Cut a kidney's volume, or widen it with background, to the smallest grid with enough room.

    Parameters
    ----------
    volume : LabelVolume
        With ``background``, ``kidney`` and ``tumour``, at least one voxel of the last two each.
    tumour_room, kidney_room : float
        mm between their outermost voxel centres and the grid's, at least.
    """
    low, high = np.full(3, np.iinfo(int).max), np.full(3, np.iinfo(int).min)
    for name, room in (("tumour", tumour_room), ("kidney", kidney_room)):
        mask = volume.mask(name)
        voxels = np.ceil(room / volume.spacing - 1e-6).astype(int)
        for axis in range(3):
            used = np.flatnonzero(mask.any(axis=tuple(other for other in range(3) if other != axis)))
            low[axis] = min(low[axis], used[0] - voxels[axis])
            high[axis] = max(high[axis], used[-1] + voxels[axis] + 1)
    inside = tuple(slice(max(a, 0), min(b, n)) for a, b, n in zip(low, high, volume.shape, strict=True))
    missing = [(max(-a, 0), max(b - n, 0)) for a, b, n in zip(low, high, volume.shape, strict=True)]
    labels = np.pad(volume.labels[inside], missing, constant_values=volume.names["background"])
    affine = volume.affine.copy()
    affine[:3, 3] = volume.points(low.astype(float)[None])[0]
    return LabelVolume(labels, affine, volume.names)
