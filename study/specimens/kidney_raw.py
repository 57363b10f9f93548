"""One kidney out of a segmented scan of both: the one with the tumour, on cubic voxels, with room around."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from study.errors import GeometryError, LabelError
from study.specimens.kidney_checks import FARTHEST_TUMOUR
from study.specimens.kidney_room import with_room
from study.volumes import LabelVolume, reoriented, resampled

_CORNERS = np.ones((3, 3, 3), bool)


def affected_kidney(scan: LabelVolume, source: str = "scan", spacing: float = 1.0) -> tuple[LabelVolume, str]:
    """Take the kidney that carries the largest tumour out of a scan.

    The other kidney and loose voxels become background; further tumours in the same kidney become
    kidney, for they are part of what is traced but not of what is removed. So do cavities inside and
    labels other than those two, such as cysts.

    Parameters
    ----------
    scan : LabelVolume
        With ``background``, ``kidney`` and ``tumour``, on any grid.
    source : str
        What errors call it.
    spacing : float
        mm of the new voxels, to the nearest that cuts the extent into whole voxels.

    Returns
    -------
    LabelVolume
        On axes as near to LPS as the scan's go, with the room of `with_room`; background is added where
        the scan ended before.
    str
        "left" if the other kidney lies to the right of it, "right" if to the left, "" if there is none.

    Raises
    ------
    GeometryError
        If no kidney lies within `FARTHEST_TUMOUR` of the tumour, or it is too small for the new voxels.
    LabelError
        If no voxel is tumour.
    """
    if not scan.mask("tumour").any():
        raise LabelError(f"{source}: expected voxels of tumour, got none")
    volume = reoriented(_around_labels(scan))
    tumour, kidney = (volume.names[name] for name in ("tumour", "kidney"))
    tumours, _ = ndimage.label(volume.labels == tumour, _CORNERS)
    largest = tumours == 1 + int(np.argmax(np.bincount(tumours.ravel())[1:]))
    organs, count = ndimage.label(volume.labels > 0, _CORNERS)
    sizes = np.bincount(organs.ravel(), weights=(volume.labels == kidney).ravel(), minlength=count + 1)
    own = int(organs[largest][0])
    if sizes[own] == 0:
        own = _nearest_kidney(volume, largest, organs, sizes, source)
    side = _side(volume, organs, own, sizes)
    keep = (organs == own) | largest
    labels = np.where(keep, kidney, 0).astype(np.uint8)
    labels[largest] = tumour
    one = with_room(volume.with_labels(labels), kidney_room=2.0 * spacing, tumour_room=2.0 * spacing)
    one = resampled(one, spacing)
    kept = one.labels == tumour
    if not kept.any():
        raise GeometryError(
            f"{source}: expected a tumour that is seen in voxels of {spacing:g} mm, got one of "
            f"{np.count_nonzero(largest)} voxels of {' x '.join(f'{step:.3g}' for step in volume.spacing)} mm"
        )
    # What is thinner than a voxel may have come loose; cavities are part of the kidney.
    found, _ = ndimage.label(one.labels > 0, _CORNERS)
    sizes = np.bincount(found.ravel())
    body = np.isin(found, [1 + int(np.argmax(sizes[1:])), *np.unique(found[kept])])
    labels = np.where(body, one.labels, 0).astype(np.uint8)
    labels[ndimage.binary_fill_holes(body) & ~body] = kidney
    return with_room(one.with_labels(labels)), side


def _around_labels(volume: LabelVolume) -> LabelVolume:
    """Only the part of a scan that has labels: the rest may be a whole body."""
    box = ndimage.find_objects((volume.labels > 0).astype(np.uint8))[0]
    affine = volume.affine.copy()
    affine[:3, 3] = volume.points(np.array([[part.start for part in box]], dtype=float))[0]
    return LabelVolume(np.ascontiguousarray(volume.labels[box]), affine, volume.names)


def _nearest_kidney(volume: LabelVolume, tumour, organs, sizes: np.ndarray, source: str) -> int:
    """Number of the piece with the kidney voxel that is nearest to the tumour."""
    distance, place = ndimage.distance_transform_edt(
        volume.labels != volume.names["kidney"], sampling=volume.spacing, return_indices=True
    )
    nearest = float(distance[tumour].min())
    if nearest > FARTHEST_TUMOUR:
        raise GeometryError(
            f"{source}: expected the tumour within {FARTHEST_TUMOUR} mm of a kidney, "
            f"got {nearest:.1f} mm to the nearest kidney voxel"
        )
    at = np.argwhere(tumour)[np.argmin(distance[tumour])]
    return int(organs[tuple(place[(slice(None), *at)])])


def _side(volume: LabelVolume, organs: np.ndarray, own: int, sizes: np.ndarray) -> str:
    other = sizes.copy()
    other[[0, own]] = 0
    # A stray piece of label is not a second kidney.
    if other.max(initial=0) < 0.1 * max(sizes[own], 1):
        return ""
    left = [
        float(volume.points(np.argwhere(organs == number)).mean(axis=0)[0])
        for number in (own, int(np.argmax(other)))
    ]
    return "left" if left[0] > left[1] else "right"
