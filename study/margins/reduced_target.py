"""Where the chapters meet: what margins leave of the volume to be milled (Siebold, figure 3.2)."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product

import numpy as np
from scipy import ndimage

from study.errors import LabelError
from study.margins.margin import SafetyMargin
from study.volumes import LabelVolume

# Voxels: what overlaps by less only touches.
_TOUCHING = 1e-6


def reduced_target(planning: LabelVolume, margins: Iterable[SafetyMargin]) -> LabelVolume:
    """The planning volume with margins and their structures protected.

    Parameters
    ----------
    planning : LabelVolume
        With labels ``target`` and ``protected``. Its grid may be another than the margins' (finer, coarser,
        turned), if the mm frame is the same: a target voxel of which a margin or structure takes any part is
        protected.
    margins : iterable of SafetyMargin

    Returns
    -------
    LabelVolume
        Target voxels in any margin or structure are ``protected``; all else stays.

    Raises
    ------
    LabelError
        If the planning volume lacks a label.
    """
    missing = {"target", "protected"} - set(planning.names)
    if missing:
        raise LabelError(f"planning: expected labels target and protected, got {sorted(planning.names)}")
    target = planning.mask("target")
    spared = np.zeros(planning.shape, bool)
    for margin in margins:
        same = planning.shape == margin.volume.shape and np.allclose(
            planning.affine, margin.volume.affine, rtol=0, atol=1e-6
        )
        spared |= margin.mask | margin.structure_mask if same else _overlapped(planning, margin, target)
    labels = planning.labels.copy()
    labels[spared & target] = planning.names["protected"]
    return planning.with_labels(labels)


def _overlapped(planning: LabelVolume, margin: SafetyMargin, wanted: np.ndarray) -> np.ndarray:
    """Those of the `wanted` planning voxels that share some volume with the margin or its structure.

    Two boxes are apart if and only if they are along a normal of one of their faces or along a normal to an
    edge of each (separating axes). All is done in voxels of the planning volume, whose own are unit cubes.
    """
    to_index = np.linalg.inv(planning.affine[:3, :3])
    edges = (to_index @ margin.volume.affine[:3, :3]).T  # of a margin's voxel, one a row
    faces = [np.cross(edges[k - 2], edges[k - 1]) for k in range(3)]
    both = [np.cross(unit, edge) for unit in np.eye(3) for edge in edges]
    axes = np.array([*np.eye(3), *faces, *both])
    lengths = np.linalg.norm(axes, axis=1)
    axes = axes[lengths > 1e-9] / lengths[lengths > 1e-9, None]
    apart = 0.5 * (np.abs(axes).sum(axis=1) + np.abs(axes @ edges.T).sum(axis=1)) - _TOUCHING
    most = np.ceil(0.5 * np.abs(edges).sum(axis=0)).astype(int)  # steps from a margin's voxel to one it meets

    middles = planning.indices(margin.volume.points(np.argwhere(margin.mask | margin.structure_mask)))
    nearest = np.rint(middles).astype(int)
    around = ndimage.maximum_filter(np.pad(wanted, [(n, n) for n in most]), size=tuple(2 * most + 1))
    useful = ((nearest >= -most) & (nearest < planning.shape + most)).all(axis=1)
    useful[useful] = around[tuple((nearest[useful] + most).T)]
    middles, nearest = middles[useful], nearest[useful]
    out = np.zeros(planning.shape, bool)
    for step in product(*(range(-n, n + 1) for n in most)):
        voxels = nearest + step
        meets = (np.abs((voxels - middles) @ axes.T) < apart).all(axis=1)
        meets &= ((voxels >= 0) & (voxels < planning.shape)).all(axis=1)
        out[tuple(voxels[meets].T)] = True
    return out & wanted
