"""Fits of many poses of a swab to a surface's tangent planes, side by side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

#: Neighbours of a vertex that a normal is estimated from where the surface has none.
NEIGHBOURS = 12
#: Cells along the longest edge of the grid, at most.
CELLS = 80
#: Least share of the mean curvature of the cost by which each step is damped. Along a direction in which
#: the patch can slide, an undamped step would be without bound.
DAMPING = 0.02


@dataclass(frozen=True, eq=False)
class TangentPlanes:
    """A surface as the tangent planes of its vertices.

    Attributes
    ----------
    points, normals : (v, 3) arrays
        Vertices, mm, and unit normals; their sign is of no account.
    spacing : float
        Median distance of a vertex from the next, mm.
    tree : cKDTree
        Of the vertices.
    origin, cell, table : (3,) array, float, (i, j, k) int array
        A grid that says which vertex is about the nearest to a cell, mm.
    """

    points: np.ndarray
    normals: np.ndarray
    spacing: float
    tree: cKDTree
    origin: np.ndarray
    cell: float
    table: np.ndarray

    @classmethod
    def of(cls, points: np.ndarray, normals: np.ndarray | None, room: float) -> TangentPlanes:
        """Prepare a surface; the grid reaches `room` mm beyond it, and places outside count as its rim."""
        tree = cKDTree(points)
        spacing = float(np.median(tree.query(points, k=2)[0][:, 1]))
        normals = estimated_normals(points, tree) if normals is None else normals
        origin = points.min(axis=0) - room
        extent = points.max(axis=0) + room - origin
        cell = max(spacing, float(extent.max()) / CELLS)
        shape = np.floor(extent / cell).astype(int) + 1
        table = np.full(shape, -1)
        places = ((points - origin) / cell).astype(int)
        off_centre = np.linalg.norm((points - origin) / cell - places - 0.5, axis=1)
        # Of several vertices in a cell the most central one is written last, and stays.
        last = np.argsort(-off_centre, kind="stable")
        table[tuple(places[last].T)] = last
        nearest = ndimage.distance_transform_edt(table < 0, return_distances=False, return_indices=True)
        return cls(points, normals, spacing, tree, origin, cell, table[tuple(nearest)])

    def near(self, places: np.ndarray) -> np.ndarray:
        """Indices of vertices that are about the nearest to (..., 3) places, to within a cell or two."""
        cells = ((places - self.origin) * (1 / self.cell)).astype(np.int64)  # below the grid: clipped anyway
        np.clip(cells, 0, np.subtract(self.table.shape, 1), out=cells)
        return self.table[cells[..., 0], cells[..., 1], cells[..., 2]]

    def nearest(self, places: np.ndarray) -> np.ndarray:
        """Indices of the nearest vertices to (..., 3) places."""
        return self.tree.query(places)[1]


def estimated_normals(points: np.ndarray, tree: cKDTree) -> np.ndarray:
    """(v, 3) unit normals, of either sign: where the nearest vertices spread least."""
    around = points[tree.query(points, k=min(NEIGHBOURS, len(points)))[1]]
    around = around - around.mean(axis=1, keepdims=True)
    return np.linalg.eigh(around.transpose(0, 2, 1) @ around)[1][:, :, 0]


def fit_planes(
    planes: TangentPlanes,
    swab: np.ndarray,
    turns: np.ndarray,
    places: np.ndarray,
    steps: int,
    exact: bool = False,
    damping: float = DAMPING,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Gauss-Newton steps that bring the swab onto the tangent planes of the vertices near it.

    A patch slides along its surface within a few such steps, where matching points with points would
    need hundreds.

    Parameters
    ----------
    planes : TangentPlanes
    swab : (p, 3) array
        Less its mean, mm.
    turns, places : (n, 3, 3) and (n, 3) arrays
        Rotation of the swab, and where its mean goes, mm.
    steps : int
    exact : bool
        Match with the nearest vertices, not the grid's.
    damping : float
        Share of the number of points added to the normal equations' diagonal.

    Returns
    -------
    turns, places : arrays like the given
    rms : (n,) array
        Root mean square distance from the tangent planes, and beyond a vertex's surroundings from these,
        mm. Noise alone stays in it where the surface is smooth, however far apart its vertices are.
    last : (n,) array
        Length of the last step, root mean square over the swab, mm.
    """
    size = np.sqrt((swab**2).sum(axis=1).mean())
    find = planes.nearest if exact else planes.near
    last = np.full(len(turns), np.inf)

    def offsets() -> tuple[np.ndarray, ...]:
        arms = swab @ turns.transpose(0, 2, 1)
        moved = arms + places[:, None]
        match = find(moved)
        normals = planes.normals[match]
        moved -= planes.points[match]
        return arms, normals, moved, np.einsum("npi,npi->np", moved, normals)

    for _ in range(steps):
        arms, normals, _, heights = offsets()
        # Turns in units of the swab's size, so that one damping suits both halves.
        slopes = np.concatenate([np.cross(arms, normals) / size, normals], axis=2)
        columns = slopes.transpose(0, 2, 1)
        curvature = columns @ slopes + damping * len(swab) * np.eye(6)
        step = -np.linalg.solve(curvature, columns @ heights[..., None])[..., 0]
        turns = Rotation.from_rotvec(step[:, :3] / size).as_matrix() @ turns
        places = places + step[:, 3:]
        last = np.linalg.norm(step, axis=1)
    _, _, gaps, heights = offsets()
    beside = np.einsum("npi,npi->np", gaps, gaps) - heights**2 - (2 * planes.spacing) ** 2
    rms = np.sqrt((heights**2 + np.maximum(beside, 0)).mean(axis=1))
    return turns, places, rms, last
