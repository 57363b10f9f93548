"""Label maps on other grids: another spacing, or axes in the order of the frame."""

from __future__ import annotations

from collections.abc import Sequence

import nibabel as nib
import numpy as np
from scipy import sparse

from study.errors import GeometryError, InputError
from study.volumes.file_checks import present_labels
from study.volumes.label_volume import LabelVolume

# Shares of labels that differ by less than this are a tie (they are sums in single precision).
_TIE = 1e-5


def resampled(
    volume: LabelVolume,
    spacing: float | Sequence[float],
    method: str = "smooth",
    *,
    priority: Sequence[str] = (),
) -> LabelVolume:
    """A label map on a finer or coarser grid of the same physical extent.

    The box that the voxels fill (from the outer face of the first voxel to that of the last) stays
    exactly the same. Along each axis it is cut into the whole number of voxels, at least one, that comes
    nearest to the spacing asked for: an extent of 10 mm at 3 mm gives 3 voxels of 3.333 mm. Hence
    ``spacing_new = n_old * spacing_old / n_new``, and the first voxel's centre moves by half the
    difference of the two spacings along each axis. Directions and names stay.

    Parameters
    ----------
    volume : LabelVolume
    spacing : float or (3,) floats
        mm along i, j, k.
    method : {"smooth", "nearest", "majority"}
        "smooth": every label's membership (0 or 1) is interpolated linearly between voxel centres and
        the label with the greatest share wins; for finer grids. "nearest": the label of the voxel that
        holds the new centre. "majority": the label that fills most of the new voxel's volume; for
        coarser grids, where the other two would sample a few voxels and skip the rest.
    priority : sequence of str, optional
        Names that win a tie, first to last. Ties among the rest go to the smaller label, background (0)
        last, so that protected bone wins over target and target over air.

    Returns
    -------
    LabelVolume

    Raises
    ------
    GeometryError
        If the spacing is not positive and finite.
    InputError
        If `method` is not one of the three.
    LabelError
        If `priority` holds a name the volume has not.
    """
    step = np.broadcast_to(np.asarray(spacing, dtype=float), (3,))
    if not np.isfinite(step).all() or (step <= 0).any():
        raise GeometryError(f"spacing: expected positive numbers of mm, got {np.asarray(spacing).tolist()}")
    if method not in ("smooth", "nearest", "majority"):
        raise InputError(f'method: expected "smooth", "nearest" or "majority", got {method!r}')
    for name in priority:
        volume.mask(name)
    old = np.array(volume.shape)
    new = np.maximum(np.rint(old * volume.spacing / step), 1).astype(int)
    ratio = old / new
    affine = volume.affine.copy()
    affine[:3, :3] *= ratio
    affine[:3, 3] = volume.points((ratio - 1)[None] / 2)[0]
    if method == "nearest":
        # Rounding must not move a centre that lies on a face to and fro: half a voxel goes up.
        centres = [
            np.minimum(np.floor((np.arange(n) + 0.5) * q + 1e-9).astype(int), o - 1)
            for n, o, q in zip(new, old, ratio, strict=True)
        ]
        return LabelVolume(volume.labels[np.ix_(*centres)], affine, volume.names)
    weights = [(_linear if method == "smooth" else _shares)(o, n) for o, n in zip(old, new, strict=True)]
    first = [volume.names[name] for name in priority]
    rest = [value for value in present_labels(volume.labels) if value not in first]
    order = first + sorted(rest, key=lambda value: (value == 0, value))
    labels = np.zeros(new, np.uint8)
    best = np.zeros(new, np.float32)
    for value in order:
        where, share = _share_of_label(volume.labels == value, weights)
        if share is None:
            continue
        better = share > best[where] + _TIE
        best[where][better] = share[better]
        labels[where][better] = value
    return LabelVolume(labels, affine, volume.names)


def reoriented(volume: LabelVolume) -> LabelVolume:
    """The same voxels at the same places, with axes permuted and flipped to come closest to LPS.

    Afterwards i runs as nearly as may be to the left, j to posterior and k to superior. No voxel is
    interpolated; an oblique volume stays oblique.
    """
    order = nib.orientations.io_orientation(volume.affine)
    labels = nib.orientations.apply_orientation(volume.labels, order)
    affine = volume.affine @ nib.orientations.inv_ornt_aff(order, volume.shape)
    return LabelVolume(np.ascontiguousarray(labels), affine, volume.names)


def _linear(old: int, new: int) -> sparse.csr_array:
    """(new, old) weights of linear interpolation at the new centres; constant beyond the last one."""
    place = np.clip((np.arange(new) + 0.5) * old / new - 0.5, 0, old - 1)
    below = np.minimum(place.astype(int), max(old - 2, 0))
    above = np.minimum(below + 1, old - 1)
    part = place - below
    rows = np.repeat(np.arange(new), 2)
    columns = np.stack([below, above], axis=1).ravel()
    values = np.stack([1 - part, part], axis=1).ravel()
    return sparse.csr_array((values.astype(np.float32), (rows, columns)), shape=(new, old))


def _shares(old: int, new: int) -> sparse.csr_array:
    """(new, old) share of each new voxel that lies in each old one."""
    rows, columns, values = [], [], []
    for index in range(new):
        low, high = index * old / new, (index + 1) * old / new
        for column in range(int(np.floor(low)), min(int(np.ceil(high)), old)):
            rows.append(index)
            columns.append(column)
            values.append((min(high, column + 1) - max(low, column)) / (high - low))
    return sparse.csr_array((np.array(values, np.float32), (rows, columns)), shape=(new, old))


def _share_of_label(
    mask: np.ndarray, weights: Sequence[sparse.csr_array]
) -> tuple[tuple[slice, slice, slice], np.ndarray | None]:
    """Where a label can occur on the new grid, and its share there."""
    where = []
    share = mask
    for axis in range(3):
        used = np.flatnonzero(mask.any(axis=tuple(other for other in range(3) if other != axis)))
        if used.size == 0:
            return (slice(0), slice(0), slice(0)), None
        columns = slice(used[0], used[-1] + 1)
        touching = weights[axis][:, columns]
        rows = np.flatnonzero(touching.sum(axis=1) > 0)
        if rows.size == 0:
            return (slice(0), slice(0), slice(0)), None
        where.append(slice(rows[0], rows[-1] + 1))
        front = np.moveaxis(share, axis, 0)[columns]
        flat = front.reshape(front.shape[0], -1).astype(np.float32)
        mixed = touching[where[-1]] @ flat
        share = np.moveaxis(mixed.reshape(-1, *front.shape[1:]), 0, axis)
    return tuple(where), share
