"""Iterative closest point fits of a swab to a surface's vertices, from many starts at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from study.errors import GeometryError, InputError
from study.registration.icp import _kernels
from study.registration.icp.nearest import SurfaceTree
from study.registration.icp.settings import IcpSettings
from study.registration.rigid import COLLINEAR
from study.threads import in_threads

#: Extent of a swab over that of its surface; outside one of the two is not in mm.
EXTENT_RATIOS = (0.02, 3.0)
#: How far a start's rotation times its transpose may be from the identity.
RIGID = 1e-6


@dataclass(frozen=True, eq=False)
class SurfaceFits:
    """Where iterative closest point fits ended.

    Attributes
    ----------
    transforms : (n, 4, 4) array
        From the swab as given, before its start, to the surface, mm.
    converged : (n,) bool array
        False where the iterations ran out, or all matches lay on one line so that no rotation fits best.
    iterations : (n,) int array
        Closed-form fits that were made.
    rms : (n,) array
        Root of the mean squared distance to the nearest vertices at the end, mm.
    settings : IcpSettings
        When they were to stop.
    """

    transforms: np.ndarray
    converged: np.ndarray
    iterations: np.ndarray
    rms: np.ndarray
    settings: IcpSettings

    def __len__(self) -> int:
        return len(self.transforms)


def register_surface(
    vertices: ArrayLike | SurfaceTree,
    swab: ArrayLike,
    starts: ArrayLike,
    settings: IcpSettings | None = None,
    kept: ArrayLike | None = None,
) -> SurfaceFits:
    """Fit a swab to a surface by point-to-point iterative closest point, once a start (Section 4.2.2).

    One iteration matches every swab point with its nearest vertex and takes the rigid transform that is
    the best for these matches in closed form. A fit has converged when no match changes, so that the
    transform is an exact fixed point, or when the last step is below both tolerances.

    Parameters
    ----------
    vertices : (v, 3) array or SurfaceTree
        The surface, mm. A tree is made once and used for several calls.
    swab : (p, 3) or (n, p, 3) array
        Points on the surface, mm; one swab for all starts or one each.
    starts : (n, 4, 4) array
        Rigid transforms that are applied to the swab before the fit.
    settings : IcpSettings, optional
        When to stop.
    kept : (n, v) bool array, optional
        Vertices that each start may be matched to; all by default.

    Returns
    -------
    SurfaceFits
        ``transforms`` are composed with their start.

    Raises
    ------
    InputError
        If a shape is wrong, a value not finite, a start not rigid, a swab on one line, or fewer than three
        vertices are kept.
    GeometryError
        If a swab is so small or large beside the surface that one of them cannot be in mm.
    """
    settings = IcpSettings() if settings is None else settings
    if not isinstance(settings, IcpSettings):
        raise InputError(f"settings: expected IcpSettings, got {type(settings).__name__}")
    tree = vertices if isinstance(vertices, SurfaceTree) else SurfaceTree.of(vertices)
    starts = checked_starts(starts)
    swabs = checked_swabs(swab, len(starts), tree.extent)
    masked = kept is not None
    kept = checked_kept(kept, len(starts), len(tree.points)) if masked else np.ones((1, 1), bool)

    centroids = swabs.mean(axis=1)
    centred = swabs - centroids[:, None]
    radii = np.linalg.norm(centred, axis=2)
    poses = np.empty((len(starts), 3, 4))
    poses[:, :, :3] = starts[:, :3, :3]
    poses[:, :, 3] = np.einsum("nij,nj->ni", starts[:, :3, :3], np.broadcast_to(centroids, (len(starts), 3)))
    poses[:, :, 3] += starts[:, :3, 3] - tree.origin
    limits = (
        int(settings.max_iterations),
        float(settings.translation_tolerance),
        float(settings.rotation_tolerance),
        float(np.abs(tree.boxes[1]).max() + radii.max()),
        settings.step == "closed_form",
    )
    ends = np.empty_like(poses)
    converged, iterations, rms = (np.empty(len(starts), kind) for kind in (bool, np.int64, float))

    def part(piece: slice) -> None:
        own = piece if len(centred) > 1 else slice(None)
        _kernels.fit_many(
            tree.arrays,
            np.take(kept[piece], tree.order, axis=1) if masked else kept,
            masked,
            centred[own],
            radii[own],
            poses[piece],
            limits,
            ends[piece],
            converged[piece],
            iterations[piece],
            rms[piece],
        )

    in_threads(part, len(starts), least=8)
    transforms = np.tile(np.eye(4), (len(starts), 1, 1))
    transforms[:, :3, :3] = ends[:, :, :3]
    transforms[:, :3, 3] = ends[:, :, 3] + tree.origin
    transforms[:, :3, 3] -= np.einsum(
        "nij,nj->ni", ends[:, :, :3], np.broadcast_to(centroids, (len(starts), 3))
    )
    return SurfaceFits(transforms, converged, iterations, rms, settings)


def checked_starts(starts: ArrayLike) -> np.ndarray:
    """(n, 4, 4) rigid transforms.

    Raises
    ------
    InputError
        If they are not.
    """
    starts = np.array(starts, dtype=float)
    if starts.ndim != 3 or starts.shape[1:] != (4, 4) or not len(starts):
        raise InputError(f"starts: expected at least one transform, shape (n, 4, 4), got {starts.shape}")
    finite = np.isfinite(starts).all(axis=(1, 2))
    if finite.all():
        turns = starts[:, :3, :3]
        rest = np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
        rigid = (rest <= RIGID) & (np.linalg.det(turns) > 0) & (starts[:, 3] == [0, 0, 0, 1]).all(axis=1)
    if not finite.all() or not rigid.all():
        n = int((~finite).argmax() if not finite.all() else (~rigid).argmax())
        raise InputError(
            f"starts: expected rigid transforms (a rotation, a shift in mm, last row 0 0 0 1); "
            f"number {n} is {starts[n].tolist()}"
        )
    return starts


def checked_swabs(swab: ArrayLike, starts: int, surface_extent: float) -> np.ndarray:
    """(1 or n, p, 3) swabs that fix a rotation and are about as large as their surface.

    Raises
    ------
    InputError
        If the shape is wrong, a value not finite, or a swab's points are fewer than three or on one line.
    GeometryError
        If a swab's extent cannot be in the same unit as its surface's.
    """
    swabs = np.array(swab, dtype=float)
    if swabs.ndim == 2:
        swabs = swabs[None]
    elif swabs.ndim == 3 and len(swabs) != starts:
        raise InputError(f"swab: expected one for all or one for each of {starts} starts, got {len(swabs)}")
    if swabs.ndim != 3 or swabs.shape[2] != 3:
        raise InputError(
            f"swab: expected shape (p, 3), or (n, p, 3) for one a start, in mm, got {np.shape(swab)}"
        )
    if swabs.shape[1] < 3:
        raise InputError(f"swab: expected at least 3 points, got {swabs.shape[1]}")
    finite = np.isfinite(swabs).all(axis=2)
    if not finite.all():
        n, p = np.argwhere(~finite)[0]
        raise InputError(f"swab: expected finite numbers, point {p} of swab {n} is {swabs[n, p].tolist()}")
    extents = np.linalg.norm(np.ptp(swabs, axis=1), axis=1)
    low, high = (ratio * surface_extent for ratio in EXTENT_RATIOS)
    wrong = (extents < low) | (extents > high)
    if wrong.any():
        n = int(wrong.argmax())
        raise GeometryError(
            f"swab: its extent is {extents[n]:.4g} and that of the surface {surface_extent:.4g}, "
            f"{extents[n] / surface_extent if surface_extent else np.inf:.3g} times as much; "
            f"expected both in mm and a ratio from {EXTENT_RATIOS[0]} to {EXTENT_RATIOS[1]}"
        )
    centred = swabs - swabs.mean(axis=1, keepdims=True)
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(centred.transpose(0, 2, 1) @ centred), 0))
    wrong = spread[:, 1] <= COLLINEAR * spread[:, 2]
    if wrong.any():
        n = int(wrong.argmax())
        raise InputError(
            f"swab: expected points that do not lie on one line; their spread is {spread[n, 2]:.3g} mm along "
            f"it and {spread[n, 1]:.3g} mm across (swab {n})"
        )
    return swabs


def checked_kept(kept: ArrayLike, starts: int, vertices: int) -> np.ndarray:
    """(n, v) bool array with three vertices or more for every start.

    Raises
    ------
    InputError
        If it is not.
    """
    kept = np.asarray(kept)
    if kept.dtype != bool or kept.shape != (starts, vertices):
        raise InputError(
            f"kept: expected a bool array of shape {(starts, vertices)} (starts, vertices), "
            f"got {kept.dtype} of shape {kept.shape}"
        )
    counts = np.count_nonzero(kept, axis=1)
    if (counts < 3).any():
        n = int((counts < 3).argmax())
        raise InputError(f"kept: expected at least 3 vertices for every start, start {n} has {counts[n]}")
    return kept
