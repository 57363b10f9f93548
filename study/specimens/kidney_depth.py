"""What is seen of a surface from one side: how deep it lies behind every point of a picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True, eq=False)
class DepthMap:
    """Depth of the first surface along parallel lines of sight.

    Attributes
    ----------
    axes : (3, 3) array
        Unit vectors, one a row: right and up in the picture, and the direction of view.
    origin : (2,) array
        mm, of the first pixel's centre, right and up.
    pixel_mm : float
    depth : (nr, nu) array
        mm along the direction of view; NaN where nothing is seen.
    """

    axes: np.ndarray
    origin: np.ndarray
    pixel_mm: float
    depth: np.ndarray

    def centres(self, mask: np.ndarray) -> np.ndarray:
        """(n, 2) mm of the pixels in a mask, right and up."""
        return self.origin + self.pixel_mm * np.argwhere(mask)

    def surface_points(self, flat: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The surface seen at (n, 2) places in the picture, and whether the pixel there is in a mask.

        Returns
        -------
        (n, 3) array
            mm; bilinear between pixels, NaN where nothing is seen.
        (n,) bool array
        """
        index = ((flat - self.origin) / self.pixel_mm).T
        depth = ndimage.map_coordinates(self.depth, index, order=1, cval=np.nan)
        nearest = np.rint(index).astype(int)
        inside = ((nearest >= 0) & (nearest < np.array(mask.shape)[:, None])).all(axis=0)
        on = np.zeros(len(flat), bool)
        on[inside] = mask[tuple(nearest[:, inside])]
        points = np.column_stack([flat, depth]) @ self.axes
        return points, on & np.isfinite(depth)


def depth_map(surface: trimesh.Trimesh, looking, pixel_mm: float) -> DepthMap:
    """Look at a surface from far away.

    Parameters
    ----------
    surface : trimesh.Trimesh
        mm.
    looking : (3,) sequence of floats
        Direction of view, any length. Up in the picture is superior, or anterior when looking along it.
    pixel_mm : float
    """
    forward = np.asarray(looking, dtype=float)
    forward = forward / np.linalg.norm(forward)
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.9 else np.array([0.0, -1.0, 0.0])
    up = up - (up @ forward) * forward
    up /= np.linalg.norm(up)
    axes = np.array([np.cross(forward, up), up, forward])
    placed = surface.vertices @ axes.T
    low, high = placed[:, :2].min(axis=0), placed[:, :2].max(axis=0)
    origin = (np.floor(low / pixel_mm) - 2) * pixel_mm
    shape = tuple(np.ceil((high - origin) / pixel_mm).astype(int) + 3)

    corners = placed[surface.faces]
    corners[..., :2] = (corners[..., :2] - origin) / pixel_mm
    first = np.ceil(corners[..., :2].min(axis=1)).astype(int)
    counts = np.floor(corners[..., :2].max(axis=1)).astype(int) - first + 1
    depth = np.full(shape, np.inf)
    # All pixels of a triangle's box at once, a group of triangles for every size of box.
    for size in np.unique(counts, axis=0):
        if (size <= 0).any():
            continue
        group = np.flatnonzero((counts == size).all(axis=1))
        offsets = np.stack(np.meshgrid(*map(np.arange, size), indexing="ij"), axis=-1).reshape(-1, 2)
        pixels = first[group][:, None] + offsets
        here = _depths(corners[group], pixels)
        hit = np.isfinite(here)
        np.minimum.at(depth, tuple(pixels[hit].T), here[hit])
    return DepthMap(axes, origin, float(pixel_mm), np.where(np.isfinite(depth), depth, np.nan))


def _depths(corners: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """(t, m) depth of (t, 3, 3) triangles at (t, m, 2) pixels; NaN where a pixel is not in its triangle."""
    a, b, c = (corners[:, None, n] for n in range(3))
    u, v = b - a, c - a
    area = u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
    away = pixels - a[..., :2]
    with np.errstate(divide="ignore", invalid="ignore"):
        s = (away[..., 0] * v[..., 1] - away[..., 1] * v[..., 0]) / area
        t = (u[..., 0] * away[..., 1] - u[..., 1] * away[..., 0]) / area
        tiny = -1e-9
        return np.where(
            (s >= tiny) & (t >= tiny) & (s + t <= 1 - tiny), a[..., 2] + s * u[..., 2] + t * v[..., 2], np.nan
        )
