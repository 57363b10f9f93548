"""What a kidney's surface, swab and labels have to be; errors that say what they are instead."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from study.errors import GeometryError
from study.volumes import LabelVolume

if TYPE_CHECKING:
    import trimesh

#: mm between where surface or swab should lie and where they do, at most.
FARTHEST = 10.0
#: mm: farther from every kidney voxel than this a tumour is nobody's.
FARTHEST_TUMOUR = 5.0
#: Extent of a swab as a share of the kidney's.
SMALLEST_PART, LARGEST_PART = 0.1, 1.5
#: Spread across a line over that along it, below which points count as collinear.
COLLINEAR = 0.01


def checked_surface(
    surface: trimesh.Trimesh, source: str, anatomy: LabelVolume | None = None
) -> trimesh.Trimesh:
    """Return a surface if it is closed and every edge joins two triangles.

    Parameters
    ----------
    surface : trimesh.Trimesh
    source : str
        What the error calls it: a file or an argument.
    anatomy : LabelVolume, optional
        The labels that it should be the surface of.

    Raises
    ------
    GeometryError
        If it has no triangle, a vertex that is not finite, or edges that do not join two triangles, or
        if it does not lie where the labels do.
    """
    if len(surface.faces) == 0:
        raise GeometryError(f"{source}: expected a closed surface, got one without triangles")
    if not np.isfinite(surface.vertices).all():
        bad = np.count_nonzero(~np.isfinite(surface.vertices).all(axis=1))
        raise GeometryError(f"{source}: expected finite coordinates in mm, got {bad} vertices that are not")
    edges = surface.edges_sorted.astype(np.int64)
    counts = np.unique(edges[:, 0] * len(surface.vertices) + edges[:, 1], return_counts=True)[1]
    holes, joins = np.count_nonzero(counts == 1), np.count_nonzero(counts > 2)
    if holes or joins:
        raise GeometryError(
            f"{source}: expected a closed surface, got one of {len(surface.faces)} triangles "
            f"with {holes} edges at holes and {joins} edges that join more than two triangles"
        )
    if anatomy is not None:
        rim = _rim(anatomy, "kidney", "tumour")
        low, high = rim.min(axis=0), rim.max(axis=0)
        if max(np.abs(surface.bounds[0] - low).max(), np.abs(surface.bounds[1] - high).max()) > FARTHEST:
            raise GeometryError(
                f"{source}: expected a surface in the frame of the labels, in mm, "
                f"from {low.round(1).tolist()} to {high.round(1).tolist()}; got one "
                f"from {surface.bounds[0].round(1).tolist()} to {surface.bounds[1].round(1).tolist()}"
            )
    return surface


def checked_swab(swab: np.ndarray, source: str, anatomy: LabelVolume, aligned: bool = True) -> np.ndarray:
    """Return a swab if it can be one of a kidney's surface.

    Parameters
    ----------
    swab : (n, 3) array
        mm.
    source : str
        What the error calls it.
    anatomy : LabelVolume
        With ``kidney`` and ``tumour``.
    aligned : bool
        Whether the points are in the frame of the labels, so that they have to lie on the surface.

    Raises
    ------
    GeometryError
        If there are fewer than three points, one is not finite, they lie on a line, they span far
        more or less than a part of the kidney does, or most lie far from its surface.
    """
    if len(swab) < 3:
        raise GeometryError(f"{source}: expected three or more points, got {len(swab)}")
    if not np.isfinite(swab).all():
        bad = np.count_nonzero(~np.isfinite(swab).all(axis=1))
        raise GeometryError(
            f"{source}: expected finite coordinates in mm, got {bad} of {len(swab)} points that are not"
        )
    rim = _rim(anatomy, "kidney", "tumour")
    low, high = rim.min(axis=0), rim.max(axis=0)
    whole, part = np.linalg.norm(high - low), np.linalg.norm(np.ptp(swab, axis=0))
    if not SMALLEST_PART * whole <= part <= LARGEST_PART * whole:
        raise GeometryError(
            f"{source}: expected points in mm that span {SMALLEST_PART} to {LARGEST_PART} of the kidney's "
            f"{whole:.1f} mm, got {part:.4g} mm{_unit(part / whole)}"
        )
    spread = np.linalg.svd(swab - swab.mean(axis=0), compute_uv=False)
    if spread[1] < COLLINEAR * spread[0]:
        raise GeometryError(
            f"{source}: expected points that do not lie on a line, got {len(swab)} that span "
            f"{part:.1f} mm along it and {spread[1] / np.sqrt(len(swab)):.2g} mm (RMS) across"
        )
    if not aligned:
        return swab
    distance = float(np.median(cKDTree(rim).query(swab)[0]))
    if distance > FARTHEST:
        raise GeometryError(
            f"{source}: expected points within {FARTHEST} mm of the kidney's surface (median), in the frame "
            f"of the labels; got {distance:.1f} mm, around {swab.mean(axis=0).round(1).tolist()} "
            f"where the kidney is around {rim.mean(axis=0).round(1).tolist()} (a swab in another frame "
            "is read with aligned=False)"
        )
    return swab


def checked_tumour(anatomy: LabelVolume, source: str) -> None:
    """Check that the tumour is one of the kidney's.

    Raises
    ------
    GeometryError
        If no kidney voxel lies within `FARTHEST_TUMOUR` of it.
    """
    nearest = _gap(anatomy)
    if nearest > FARTHEST_TUMOUR:
        raise GeometryError(
            f"{source}: expected the tumour within {FARTHEST_TUMOUR} mm of the kidney, "
            f"got {nearest:.1f} mm to the nearest kidney voxel"
        )


def _gap(anatomy: LabelVolume) -> float:
    """Distance (mm) from the tumour to the nearest kidney voxel, between centres."""
    tumour, kidney = (_rim(anatomy, name) for name in ("tumour", "kidney"))
    return float(cKDTree(tumour).query(kidney)[0].min())


def _rim(anatomy: LabelVolume, *names: str) -> np.ndarray:
    """(n, 3) mm: centres of the outermost voxels of some labels taken together."""
    mask = anatomy.mask(*names)
    box = ndimage.find_objects(mask.astype(np.uint8))[0]
    rim = mask[box] & ~ndimage.binary_erosion(mask[box])
    return anatomy.points(np.argwhere(rim) + [part.start for part in box])


def _unit(ratio: float) -> str:
    """What the points' unit may be, from their extent over the kidney's; a swab spans about half of it."""
    for name, factor in (("metres", 1e-3), ("centimetres", 0.1), ("micrometres", 1e3)):
        if 0.1 * factor < ratio < 2 * factor:
            return f" (are they in {name}?)"
    return ""
