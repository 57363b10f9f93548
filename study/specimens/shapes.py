"""Shapes on a grid: swept tubes, ellipsoids, smooth random fields; all in mm, all by numpy alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline


@dataclass(frozen=True, eq=False)
class Grid:
    """Voxel centres as three axes: lateral (descending), posterior and superior coordinates in mm.

    Attributes
    ----------
    lateral, posterior, superior : (n,) float32 arrays
    """

    lateral: np.ndarray
    posterior: np.ndarray
    superior: np.ndarray

    @classmethod
    def covering(cls, low: np.ndarray, high: np.ndarray, spacing: float) -> Grid:
        """The grid of voxels between two corners that has a voxel centre at the origin."""
        first, last = np.floor(np.asarray(low) / spacing), np.ceil(np.asarray(high) / spacing)
        axes = [(np.arange(a, b + 1) * spacing).astype(np.float32) for a, b in zip(first, last, strict=True)]
        return cls(axes[0][::-1].copy(), axes[1], axes[2])

    @property
    def axes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The three axes in order."""
        return self.lateral, self.posterior, self.superior

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of voxels along each axis."""
        return self.lateral.size, self.posterior.size, self.superior.size

    def box(self, low: np.ndarray, high: np.ndarray) -> tuple[slice, slice, slice]:
        """Slices of the voxels between two corners, empty where there are none."""
        out = []
        for axis, a, b in zip(self.axes, low, high, strict=True):
            inside = np.flatnonzero((axis >= a) & (axis <= b))
            out.append(slice(int(inside[0]), int(inside[-1]) + 1) if inside.size else slice(0, 0))
        return tuple(out)

    def within(self, box: tuple[slice, slice, slice]) -> Grid:
        """The part of the grid in a box."""
        return Grid(*(axis[part] for axis, part in zip(self.axes, box, strict=True)))

    @property
    def open_axes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The three axes shaped to broadcast against each other."""
        return self.lateral[:, None, None], self.posterior[None, :, None], self.superior[None, None, :]


def swept(points, samples: int = 24) -> np.ndarray:
    """(samples, 3) points along the cubic spline through (n, 3) points, by arc length of the chords."""
    points = np.asarray(points, dtype=float)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return CubicSpline(along, points)(np.linspace(0.0, along[-1], samples))


def carve_tube(field: np.ndarray, grid: Grid, points: np.ndarray, radii, reach: float = 0.0) -> None:
    """Lower `field` to the signed distance (mm, negative inside) from a tube along a polyline.

    Parameters
    ----------
    field : (nl, np, ns) float32 array
        Changed in place, within `reach` of the tube.
    grid : Grid
    points : (n, 3) array
        mm.
    radii : float or (n,) array
        mm at the points, linear between them.
    reach : float
        mm beyond the tube's surface up to which the distance matters.
    """
    points = np.asarray(points, dtype=np.float32)
    radii = np.broadcast_to(np.asarray(radii, dtype=np.float32), (len(points),))
    for a, b, ra, rb in zip(points[:-1], points[1:], radii[:-1], radii[1:], strict=True):
        thick = max(ra, rb) + reach + 0.5
        box = grid.box(np.minimum(a, b) - thick, np.maximum(a, b) + thick)
        part = field[box]
        if not part.size:
            continue
        x, y, z = grid.within(box).open_axes
        d = b - a
        x, y, z = x - a[0], y - a[1], z - a[2]
        t = np.clip((x * d[0] + y * d[1] + z * d[2]) / np.float32(max(d @ d, 1e-12)), 0, 1)
        distance = np.sqrt((x - t * d[0]) ** 2 + (y - t * d[1]) ** 2 + (z - t * d[2]) ** 2)
        np.minimum(part, distance - (ra + t * (rb - ra)), out=part)


def carve_ellipsoid(field: np.ndarray, grid: Grid, centre, semi_axes, reach: float = 0.0) -> None:
    """Lower `field` to about the signed distance (mm, negative inside) from an ellipsoid on the axes."""
    centre, semi_axes = np.asarray(centre, dtype=np.float32), np.asarray(semi_axes, dtype=np.float32)
    box = grid.box(centre - semi_axes - reach - 0.5, centre + semi_axes + reach + 0.5)
    part = field[box]
    if not part.size:
        return
    x, y, z = grid.within(box).open_axes
    q = [(c - m) / s for c, m, s in zip((x, y, z), centre, semi_axes, strict=True)]
    norm = np.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2)
    slope = np.sqrt(sum((v / s) ** 2 for v, s in zip(q, semi_axes, strict=True)))
    # First-order distance: exact at the surface, where it is used.
    np.minimum(part, norm * (norm - 1) / np.maximum(slope, 1e-6), out=part)


def _spline_weights(axis: np.ndarray, pitch: float, first: float, count: int) -> np.ndarray:
    u = (axis - first) / pitch
    base = np.floor(u).astype(int)
    f = (u - base).astype(np.float32)
    weights = np.stack([(1 - f) ** 3, 3 * f**3 - 6 * f**2 + 4, -3 * f**3 + 3 * f**2 + 3 * f + 1, f**3]) / 6
    out = np.zeros((axis.size, count), np.float32)
    for offset in range(4):
        out[np.arange(axis.size), base + offset] = weights[offset]
    return out


def random_field(rng: np.random.Generator, axes, pitch: float, low, high) -> np.ndarray:
    """A smooth random field of mean 0 and variance about 1 on the product of some axes.

    Cubic B-splines over white noise on a lattice that is fixed in mm: the same generator gives the
    same field on every grid.

    Parameters
    ----------
    rng : numpy.random.Generator
    axes : sequence of (n,) arrays
        mm; two or three of them.
    pitch : float
        mm between the lattice's points; features are about twice as wide.
    low, high : sequences of float
        mm: corners of the lattice; all of `axes` lie between.
    """
    counts = [int(np.ceil((b - a) / pitch)) + 4 for a, b in zip(low, high, strict=True)]
    # The variance of a cubic B-spline over unit white noise is (151/315) per axis, averaged over phase.
    noise = rng.standard_normal(counts).astype(np.float32) / (151 / 315) ** (len(counts) / 2)
    for axis, first, count in zip(axes, low, counts, strict=True):
        weights = _spline_weights(axis, pitch, first, count)
        noise = np.moveaxis(np.tensordot(weights, noise, axes=(1, 0)), 0, -1)
    return noise
