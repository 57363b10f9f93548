"""Rounding the corners of a planned path (Siebold, 2.5.1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from study.errors import InputError
from study.robots import _kernels

if TYPE_CHECKING:
    from study.planners import Plan

_SAMPLES = 9  # of an arc, for the safety check; the kernel widens the burr by what lies between two
_STRAIGHT = 1e-6  # radians: less than this is no corner
_REVERSAL = np.deg2rad(175.0)  # an arc that turns back on itself would cut the far end of the path off


@dataclass(frozen=True)
class RoundingSettings:
    """How the joint trajectory rounds the corners of the planned path.

    Parameters
    ----------
    corner_tolerance : float
        Voxels (of the smallest spacing) between a corner and the arc that replaces it. The text
        names the rounding but prints no radius; half a voxel is the most that keeps the burr's
        centre, at a corner between two grid steps, over the voxels it was planned over. 0 rounds nothing.
    keep_unsafe_corners : bool
        Keep a corner whose arc would cut a protected voxel that the planned corner does not cut.
    keep_cutting_corners : bool
        Keep a corner at which the plan removes bone: the arc would leave some of it standing, and the
        shaft, planned for a place without it, would meet it later. Not printed.

    Raises
    ------
    InputError
        If the tolerance is negative or not finite.
    """

    corner_tolerance: float = 0.5
    keep_unsafe_corners: bool = True
    keep_cutting_corners: bool = True

    def __post_init__(self) -> None:
        if not np.isfinite(self.corner_tolerance) or self.corner_tolerance < 0:
            raise InputError(
                f"corner_tolerance: expected voxels of at least 0, got {self.corner_tolerance!r}"
            )


@dataclass(frozen=True, eq=False)
class RoundedPath:
    """A planned polyline with circular arcs in place of some corners.

    Attributes
    ----------
    points : (n, 3) array
        The planned points, mm.
    corners : (k,) int array
        Rows of `points` at which the path turns and may be rounded.
    reaches : (k,) array
        mm of either leg that the arc replaces; 0 where the corner is kept.
    turns : (k,) array
        Radians between the legs' directions.
    incoming, outgoing : (k, 3) arrays
        Unit directions of the legs.
    planned_s, rounded_s : (n,) arrays
        Length of the planned and of the rounded path up to each planned point, mm. A planned point
        that an arc passes by belongs to the place of the arc that divides it in the same ratio.
    saved : two (j,) arrays
        Planned length (mm, increasing) and what the rounding has saved by then (mm, linear between).
    """

    points: np.ndarray
    corners: np.ndarray
    reaches: np.ndarray
    turns: np.ndarray
    incoming: np.ndarray
    outgoing: np.ndarray
    planned_s: np.ndarray
    rounded_s: np.ndarray
    saved: tuple[np.ndarray, np.ndarray]

    @property
    def length_mm(self) -> float:
        """Length of the rounded path, mm."""
        return float(self.rounded_s[-1]) if self.rounded_s.size else 0.0

    @property
    def planned_length_mm(self) -> float:
        """Length of the planned path, mm."""
        return float(self.planned_s[-1]) if self.planned_s.size else 0.0

    @property
    def shortening(self) -> float:
        """Share of the planned length that the rounding saves."""
        return 1 - self.length_mm / self.planned_length_mm if self.planned_length_mm > 0 else 0.0

    def rounded_at(self, planned_s: np.ndarray) -> np.ndarray:
        """Length of the rounded path at places given by the length of the planned one, mm."""
        return planned_s - np.interp(planned_s, *self.saved)

    def at(self, steps: np.ndarray, planned_s: np.ndarray) -> np.ndarray:
        """Positions on the rounded path.

        Parameters
        ----------
        steps : (m,) int array
            Step each position belongs to: step j leads from planned point j to j + 1.
        planned_s : (m,) array
            Planned length at each position, within its step, mm.

        Returns
        -------
        (m, 3) array
            mm.
        """
        steps = np.minimum(steps, max(len(self.points) - 2, 0))
        start, end = self.points[steps], self.points[np.minimum(steps + 1, len(self.points) - 1)]
        length = self.planned_s[np.minimum(steps + 1, len(self.points) - 1)] - self.planned_s[steps]
        share = np.divide(
            planned_s - self.planned_s[steps], length, out=np.zeros(len(steps)), where=length > 0
        )
        out = start + np.clip(share, 0, 1)[:, None] * (end - start)
        rounded = np.flatnonzero(self.reaches > 0)
        if rounded.size:
            centre = self.planned_s[self.corners[rounded]]
            nearest = np.minimum(np.searchsorted(centre + self.reaches[rounded], planned_s), rounded.size - 1)
            offset = planned_s - centre[nearest]
            inside = np.flatnonzero(np.abs(offset) < self.reaches[rounded][nearest])
            corner = rounded[nearest[inside]]
            reach, turn = self.reaches[corner], self.turns[corner]
            u = self.incoming[corner]
            n = (self.outgoing[corner] - np.cos(turn)[:, None] * u) / np.sin(turn)[:, None]
            bend = reach / np.tan(turn / 2)
            angle = turn * (offset[inside] + reach) / (2 * reach)
            along, across = bend * np.sin(angle) - reach, bend * (1 - np.cos(angle))
            out[inside] = self.points[self.corners[corner]] + along[:, None] * u + across[:, None] * n
        return out


def _rounded(points: np.ndarray, geometry: tuple, planned_s: np.ndarray, reaches: np.ndarray) -> RoundedPath:
    corners, turns, incoming, outgoing = geometry
    on = reaches > 0
    centre, reach, turn = planned_s[corners[on]], reaches[on], turns[on]
    arc = reach / np.tan(turn / 2) * turn
    saved = np.cumsum(2 * reach - arc)
    # The rounded length over the planned one: slope 1 on the straight, arc / (2 reach) within a corner.
    knots = np.column_stack([centre - reach, centre + reach]).ravel()
    lost = np.column_stack([saved - (2 * reach - arc), saved]).ravel()
    knots, lost = np.concatenate([[0.0], knots]), np.concatenate([[0.0], lost])
    rounded_s = planned_s - np.interp(planned_s, knots, lost)
    return RoundedPath(
        points, corners, reaches, turns, incoming, outgoing, planned_s, rounded_s, (knots, lost)
    )


def round_corners(points: np.ndarray, axes: np.ndarray | None, tolerance: float) -> RoundedPath:
    """Replace the corners of a polyline by arcs that stay within `tolerance` of it.

    Each arc is tangent to both legs, so the direction of travel has no jump; it takes at most half
    of either straight run, so arcs never meet. Corners at which the drill rotates in place are
    kept, because the rotation was planned for that very position, and so are reversals.

    Parameters
    ----------
    points : (n, 3) array
        mm.
    axes : (n, 3) array or None
        Drill axes; a change of axis at one position is a rotation in place.
    tolerance : float
        mm, at least 0.

    Returns
    -------
    RoundedPath

    Raises
    ------
    InputError
        If points or axes are not finite (n, 3) arrays or the tolerance is negative.
    """
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0 or not np.isfinite(points).all():
        raise InputError(f"points: expected finite mm of shape (n, 3), got shape {points.shape}")
    if axes is not None and np.shape(axes) != points.shape:
        raise InputError(f"axes: expected shape {points.shape}, got {np.shape(axes)}")
    if not np.isfinite(tolerance) or tolerance < 0:
        raise InputError(f"tolerance: expected mm of at least 0, got {tolerance!r}")
    steps = np.diff(points, axis=0)
    lengths = np.sqrt(np.einsum("ij,ij->i", steps, steps))
    lengths[lengths < 1e-9] = 0.0
    planned_s = np.concatenate([[0.0], np.cumsum(lengths)])
    moving = np.flatnonzero(lengths)
    directions = steps[moving] / lengths[moving, None]
    u, w = directions[:-1], directions[1:]
    turns = np.arctan2(np.linalg.norm(np.cross(u, w), axis=1), np.einsum("ij,ij->i", u, w))
    corners = moving[1:]
    stops = np.zeros(corners.size, bool)
    if axes is not None:
        changed = np.concatenate([[0], np.cumsum(np.any(np.diff(axes, axis=0) != 0, axis=1))])
        stops = changed[corners] != changed[moving[:-1] + 1]
    vertex = (turns > _STRAIGHT) | stops
    corners, turns, u, w, stops = corners[vertex], turns[vertex], u[vertex], w[vertex], stops[vertex]
    runs = np.diff(np.concatenate([[0.0], planned_s[corners], planned_s[-1:]]))
    room = np.minimum(runs[:-1], runs[1:]) / 2
    roundable = ~stops & (turns > _STRAIGHT) & (turns < _REVERSAL) & (tolerance > 0)
    # An arc that replaces `reach` of either leg passes the corner at reach * tan(turn / 4).
    reaches = np.zeros(corners.size)
    reaches[roundable] = np.minimum(tolerance / np.tan(turns[roundable] / 4), room[roundable])
    return _rounded(points, (corners, turns, u, w), planned_s, reaches)


def rounding_is_safe(plan: Plan, path: RoundedPath) -> np.ndarray:
    """Which rounded corners cut no protected voxel beyond those the planned corner cuts.

    A voxel is cut where the burr's ball overlaps its box, as in `ball_element`. The ball is swept
    along the arc (at nine samples, widened by what it covers between two of them) and along the two
    legs that the arc replaces (samples only): the check errs towards keeping a corner. The volume's
    outside counts as protected. The drill's shaft moves with the burr by at most the corner
    tolerance and is not looked at here; `Milling.verify` replays it.

    Parameters
    ----------
    plan : Plan
        For its ``modified.volume`` and burr radius.
    path : RoundedPath
        Of the plan's points.

    Returns
    -------
    (k,) bool array
        One a corner of `path`; true also for corners that are kept.

    Raises
    ------
    InputError
        If the volume's axes are not perpendicular to one another.
    """
    volume = plan.modified.volume
    directions = volume.directions
    if not np.allclose(directions.T @ directions, np.eye(3), atol=1e-5):
        raise InputError("plan: expected a volume with perpendicular axes, its affine is sheared")
    safe = np.ones(path.corners.size, bool)
    on = np.flatnonzero(path.reaches > 0)
    if on.size == 0:
        return safe
    spacing = volume.spacing
    place = (path.points[path.corners[on]] - volume.affine[:3, 3]) @ directions
    voxels = np.rint(place / spacing).astype(np.int64)
    # Corners that differ only by whole voxels, or by the way along them, share one list of voxels.
    there, back = path.incoming[on] @ directions, path.outgoing[on] @ directions
    flip = ((there + back) @ np.array([1.0, np.sqrt(2), np.sqrt(3)]) < -1e-9)[:, None]
    there, back = np.where(flip, -back, there), np.where(flip, -there, back)
    describing = np.column_stack([place - voxels * spacing, there, back, path.reaches[on]])
    keys = np.rint(describing * 1e6).astype(np.int64)
    # One integer a row: np.unique over rows sorts by structured comparison, ten times slower.
    mixed = keys @ np.random.default_rng(0).integers(1, 2**61, size=keys.shape[1])
    _, first, kinds = np.unique(mixed, return_index=True, return_inverse=True)
    if not np.array_equal(keys[first][kinds], keys):  # two kinds fell on one integer
        _, first, kinds = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    kinds = kinds.ravel()
    described = describing[first]
    start, into, out_of, reach = described[:, :3], described[:, 3:6], described[:, 6:9], described[:, 9]
    turn = path.turns[on][first]
    normal = (out_of - np.cos(turn)[:, None] * into) / np.sin(turn)[:, None]
    geometry = (np.ascontiguousarray(a) for a in (start, into, normal, out_of, reach, turn))
    safe[on] = _kernels.corners_are_safe(
        volume.labels, volume.names["air"], volume.names["target"], voxels, kinds,
        np.argsort(kinds, kind="stable"), *geometry, spacing, float(plan.modified.burr_radius), _SAMPLES,
    )  # fmt: skip
    return safe


def removal_at_corners(path: RoundedPath, removed: np.ndarray) -> np.ndarray:
    """Bone that the plan removes on the legs each arc replaces.

    Parameters
    ----------
    path : RoundedPath
    removed : (n,) array
        mm^3 removed on the way to each planned point.

    Returns
    -------
    (k,) array
        mm^3, one a corner.
    """
    centre = path.planned_s[path.corners]
    total = np.concatenate([[0.0], np.cumsum(removed)])
    # Step j leads to point j + 1. The first step that reaches into the arc, and the last.
    first = np.searchsorted(path.planned_s, centre - path.reaches + 1e-9, side="right") - 1
    last = np.searchsorted(path.planned_s, centre + path.reaches - 1e-9, side="left") - 1
    first, last = np.minimum(first, path.corners - 1), np.maximum(last, path.corners)
    return np.maximum(total[last + 2] - total[first + 1], 0.0)


def round_plan(plan: Plan, settings: RoundingSettings | None = None) -> RoundedPath:
    """The plan's path with its corners rounded, unsafe ones kept.

    Parameters
    ----------
    plan : Plan
    settings : RoundingSettings, optional

    Returns
    -------
    RoundedPath
    """
    settings = RoundingSettings() if settings is None else settings
    tolerance = settings.corner_tolerance * float(plan.modified.volume.spacing.min())
    path = round_corners(plan.points, plan.axes, tolerance)
    keep = np.zeros(path.corners.size, bool)
    if settings.keep_cutting_corners:
        keep |= removal_at_corners(path, plan.removed) > 0
    if settings.keep_unsafe_corners:
        keep |= ~rounding_is_safe(plan, path)
    if keep.any():
        reaches = np.where(keep, 0.0, path.reaches)
        path = _rounded(
            path.points, (path.corners, path.turns, path.incoming, path.outgoing), path.planned_s, reaches
        )
    return path
