"""The swab: points that a tool tip passes while it traces the exposed surface of a kidney."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from study.errors import GeometryError, InputError
from study.specimens.kidney_checks import checked_surface
from study.specimens.kidney_depth import DepthMap, depth_map

if TYPE_CHECKING:
    import trimesh

_FINE = 0.25  # mm between the places at which a line is measured before it is cut into steps


@dataclass(frozen=True)
class SwabRule:
    """Which part of a surface is traced, and how densely.

    Siebold (4.3.1) traces "roughly half of the top surface" of each kidney; the rest is the rule by which
    the swabs of the prepared public cases were made.

    Parameters
    ----------
    looking : (3,) tuple
        Direction of view onto the exposed side, LPS; backwards, onto the anterior side, by default.
    slope_deg : float
        Steepest surface that is traced, against the plane of view.
    share : float
        Of the visible surface's area that is traced, 0 to 1.
    points : int
        How many there are, about: decides how far the lines are apart.
    step_mm : float
        Between points along a line, on the surface.
    noise_mm : float
        Standard deviation of the digitiser's noise along each axis; 0 for points on the surface.
    pixel_mm : float
        Of the map on which the visible surface is found.

    Raises
    ------
    InputError
        If a value is not finite or outside its range.
    """

    looking: tuple[float, float, float] = (0.0, 1.0, 0.0)
    slope_deg: float = 65.0
    share: float = 0.5
    points: int = 700
    step_mm: float = 1.5
    noise_mm: float = 0.3
    pixel_mm: float = 0.5

    def __post_init__(self) -> None:
        looking = np.asarray(self.looking, dtype=float)
        if looking.shape != (3,) or not np.isfinite(looking).all() or not looking.any():
            raise InputError(f"looking: expected a finite (3,) direction, got {self.looking}")
        limits = {
            "slope_deg": (5.0, 85.0),
            "share": (0.05, 1.0),
            "points": (3, 100_000),
            "step_mm": (0.1, 20.0),
            "noise_mm": (0.0, 10.0),
            "pixel_mm": (0.1, 3.0),
        }
        for name, (low, high) in limits.items():
            if not low <= getattr(self, name) <= high:
                raise InputError(f"{name}: expected {low} to {high}, got {getattr(self, name)}")


def trace_swab(surface: trimesh.Trimesh, near: np.ndarray, rule: SwabRule | None = None, rng=0) -> np.ndarray:
    """Trace a part of the exposed surface of a kidney in serpentine lines.

    The exposed surface is what is seen from one side and not too steep, its largest piece. Of it a
    window along the kidney's long axis is traced, as near to the tumour as the ends allow.

    Parameters
    ----------
    surface : trimesh.Trimesh
        Closed surface of the kidney with its tumour, mm, LPS.
    near : (3,) array
        mm; the tumour's middle.
    rule : SwabRule, optional
    rng : anything `numpy.random.default_rng` takes
        Of the digitiser's noise.

    Returns
    -------
    (n, 3) array
        mm, in tracing order; about ``rule.points`` of them.

    Raises
    ------
    InputError
        If `near` is not a finite point.
    GeometryError
        If the surface is not closed, or nothing of it is exposed.
    """
    rule = SwabRule() if rule is None else rule
    near = np.asarray(near, dtype=float)
    if near.shape != (3,) or not np.isfinite(near).all():
        raise InputError(f"near: expected a finite (3,) point in mm, got {near.tolist()}")
    checked_surface(surface, "surface")
    view = depth_map(surface, rule.looking, rule.pixel_mm)
    patch, area = _exposed(view, rule)

    along = _long_axis(surface, view.axes[:2])
    turn = np.array([[along[1], -along[0]], along])  # picture -> (across, along)
    place = view.centres(patch) @ turn.T
    low, high = _window(place[:, 1], area[patch], float((view.axes[:2] @ near) @ along), rule.share)

    inside = (place[:, 1] >= low) & (place[:, 1] <= high)
    span = place[inside, 0].min() - rule.pixel_mm, place[inside, 0].max() + rule.pixel_mm
    # Lines as far apart as makes the number of points come out: what a line holds hardly depends on
    # where it lies, so that a trial set tells.
    trial = _lines(view, patch, turn, np.linspace(low, high, 41), span)
    length = np.trapezoid([_length(line) for line in trial], np.linspace(low, high, 41))
    count = max(round((high - low) * rule.points * rule.step_mm / max(length, 1e-9)), 1)
    heights = low + (np.arange(count) + 0.5) * (high - low) / count
    points = _serpentine(_lines(view, patch, turn, heights, span), rule.step_mm)
    if len(points) < 3:
        raise GeometryError(
            f"surface: expected a visible piece that holds three points or more, got {len(points)}"
        )
    return points + rule.noise_mm * np.random.default_rng(rng).standard_normal(points.shape)


def _exposed(view: DepthMap, rule: SwabRule) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of the largest visible piece that is not too steep, and mm^2 of surface in every pixel."""
    steepest = np.tan(np.deg2rad(rule.slope_deg))
    rise = np.hypot(*np.gradient(view.depth, view.pixel_mm))
    # Where one part ends before another the depth jumps, which the slope misses at tips and corners.
    none = np.isnan(view.depth)
    nearest = ndimage.minimum_filter(np.where(none, -np.inf, view.depth), 3)
    farthest = ndimage.maximum_filter(np.where(none, np.inf, view.depth), 3)
    jump = (farthest - nearest) / (2 * np.sqrt(2) * view.pixel_mm)
    flat = (np.nan_to_num(rise, nan=np.inf) <= steepest) & (jump <= steepest)
    area = np.where(flat, np.sqrt(1 + np.where(flat, rise, 0) ** 2), 0) * view.pixel_mm**2
    pieces, count = ndimage.label(flat)
    if count == 0:
        raise GeometryError(
            f"surface: expected a side not steeper than {rule.slope_deg} degrees seen along {rule.looking}, "
            "got none"
        )
    sizes = ndimage.sum_labels(area, pieces, np.arange(1, count + 1))
    return pieces == 1 + int(np.argmax(sizes)), area


def _long_axis(surface: trimesh.Trimesh, picture: np.ndarray) -> np.ndarray:
    """(2,) unit vector along which the surface spreads most in the picture, upwards."""
    flat = surface.triangles_center @ picture.T
    weights = surface.area_faces / surface.area
    flat = (flat - weights @ flat) * np.sqrt(weights)[:, None]
    along = np.linalg.svd(flat, full_matrices=False)[2][0]
    return along if along[1] >= 0 else -along


def _window(along: np.ndarray, area: np.ndarray, wanted: float, share: float) -> tuple[float, float]:
    """Ends of the stretch that holds a share of the area, its middle as near to `wanted` as may be."""
    order = np.argsort(along, kind="stable")
    along = along[order]
    below = np.cumsum(area[order]) / area.sum()
    starts = np.linspace(0.0, 1.0 - share, 201)
    low, high = np.interp(starts, below, along), np.interp(starts + share, below, along)
    best = int(np.argmin(np.abs(0.5 * (low + high) - wanted)))
    return float(low[best]), float(high[best])


def _lines(
    view: DepthMap, patch: np.ndarray, turn: np.ndarray, heights: np.ndarray, span: tuple[float, float]
) -> list[list[np.ndarray]]:
    """For every height along the axis: the runs of (n, 3) surface points across it, close together."""
    across = np.arange(span[0], span[1] + _FINE, _FINE)
    out = []
    for height in heights:
        flat = np.column_stack([across, np.full(across.size, height)]) @ turn
        points, on = view.surface_points(flat, patch)
        edges = np.flatnonzero(np.diff(np.r_[0, on.astype(int), 0]))
        out.append([points[a:b] for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a > 1])
    return out


def _length(runs: list[np.ndarray]) -> float:
    return float(sum(np.linalg.norm(np.diff(run, axis=0), axis=1).sum() for run in runs))


def _serpentine(lines: list[list[np.ndarray]], step: float) -> np.ndarray:
    """Points a step apart along the lines, every other line backwards."""
    out = []
    for number, runs in enumerate(lines):
        for run in runs if number % 2 == 0 else [run[::-1] for run in reversed(runs)]:
            gone = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(run, axis=0), axis=1))])
            # The rest of the run that is no whole step is left over at both ends alike.
            at = np.arange(0.5 * (gone[-1] % step), gone[-1] + 1e-9, step)
            out.append(np.column_stack([np.interp(at, gone, run[:, axis]) for axis in range(3)]))
    return np.concatenate(out) if out else np.zeros((0, 3))
