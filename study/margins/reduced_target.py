"""Where the chapters meet: what margins leave of the volume to be milled (Siebold, figure 3.2)."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product

import numpy as np

from study.errors import InputError, LabelError
from study.margins.margin import SafetyMargin
from study.volumes import LabelVolume

# Corners of a margin's voxel are looked up this share of it further in: what only touches does not overlap.
_INSIDE = 1e-6


def reduced_target(planning: LabelVolume, margins: Iterable[SafetyMargin]) -> LabelVolume:
    """The planning volume with margins and their structures protected.

    Parameters
    ----------
    planning : LabelVolume
        With labels ``target`` and ``protected``. Its grid may be another than the margins', if the mm frame
        is the same: a voxel is protected when a voxel of a margin or structure overlaps it.
    margins : iterable of SafetyMargin

    Returns
    -------
    LabelVolume
        Target voxels in any margin or structure are ``protected``; all else stays.

    Raises
    ------
    LabelError
        If the planning volume lacks a label.
    InputError
        If a margin's voxels are larger than the planning volume's by a tenth or more, so that some could be
        missed.
    """
    missing = {"target", "protected"} - set(planning.names)
    if missing:
        raise LabelError(f"planning: expected labels target and protected, got {sorted(planning.names)}")
    spared = np.zeros(planning.shape, bool)
    for margin in margins:
        union = margin.mask | margin.structure_mask
        same = planning.shape == margin.volume.shape and np.allclose(
            planning.affine, margin.volume.affine, rtol=0, atol=1e-6
        )
        spared |= union if same else _overlapped(planning, margin, union)
    labels = planning.labels.copy()
    labels[spared & planning.mask("target")] = planning.names["protected"]
    return planning.with_labels(labels)


def _overlapped(planning: LabelVolume, margin: SafetyMargin, union: np.ndarray) -> np.ndarray:
    """Voxels of the planning volume that hold the centre or a corner of a voxel in `union`."""
    ratio = margin.volume.spacing / planning.spacing
    if (ratio > 1.1).any():
        raise InputError(
            f"{margin.structure}: expected a margin on voxels no larger than the planning volume's "
            f"{planning.spacing.round(3).tolist()} mm, got {margin.volume.spacing.round(3).tolist()} mm"
        )
    out = np.zeros(planning.shape, bool)
    voxels = np.argwhere(union)
    half = 0.5 - _INSIDE
    for offset in [(0, 0, 0), *product((-half, half), repeat=3)]:
        index = np.floor(planning.indices(margin.volume.points(voxels + np.array(offset))) + 0.5).astype(int)
        index = index[((index >= 0) & (index < planning.shape)).all(axis=1)]
        out[tuple(index.T)] = True
    return out
