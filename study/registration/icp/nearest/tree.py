"""A surface's vertices in the order of a kd-tree, for many nearest-neighbour searches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from study.registration.rigid import checked_points

#: At most so many vertices in a leaf.
LEAF = 8
#: Neighbours listed for every vertex.
AROUND = 40


@dataclass(frozen=True, eq=False)
class SurfaceTree:
    """Vertices sorted so that every node of a balanced binary tree holds a run of them.

    Node 1 is the root, nodes ``2 k`` and ``2 k + 1`` are the halves of node ``k``, cut across the longest
    edge of its box; the lowest level's nodes are the leaves. Made once for a surface that is registered
    to repeatedly, see `register_surface`.

    Attributes
    ----------
    vertices : (v, 3) array
        As given, mm.
    origin : (3,) array
        Mean of the vertices, mm; taken off `points` and `boxes` so that sums over them lose no digits.
    order : (v,) int array
        Which vertex each of the `points` is.
    points : (v, 3) array
        Sorted vertices less `origin`, mm.
    ends : (leaves + 1,) int array
        Where each leaf's run of points begins and ends.
    boxes : (2 leaves, 6) array
        Lowest and highest coordinates of each node's points, mm; row 0 is no node.
    around : (v, k) int array
        The points nearest to each of the `points`, without itself, nearest first.
    planes : (v, k, 5) array
        Half their distances, and the planes half way to them: unit normals away from the point, and how
        far along them, mm.
    """

    vertices: np.ndarray
    origin: np.ndarray
    order: np.ndarray
    points: np.ndarray
    ends: np.ndarray
    boxes: np.ndarray
    around: np.ndarray
    planes: np.ndarray

    @classmethod
    def of(cls, vertices: ArrayLike) -> SurfaceTree:
        """Sort vertices.

        Parameters
        ----------
        vertices : (v, 3) array
            mm; three or more.

        Raises
        ------
        InputError
            If they are fewer, of another shape or not finite.
        """
        vertices = checked_points("vertices", vertices, least=3)
        origin = vertices.mean(axis=0)
        points = vertices - origin
        order = np.arange(len(points))
        ends = np.array([0, len(points)])
        levels = max(0, int(np.ceil(np.log2(len(points) / LEAF))))
        boxes = np.zeros((2 << levels, 6))
        for level in range(levels + 1):
            low = np.minimum.reduceat(points[order], ends[:-1])
            high = np.maximum.reduceat(points[order], ends[:-1])
            boxes[1 << level : 2 << level] = np.concatenate([low, high], axis=1)
            if level < levels:
                node = np.repeat(np.arange(1 << level), np.diff(ends))
                across = (high - low).argmax(axis=1)[node]
                order = order[np.lexsort((order, points[order, across], node))]
                middle = (ends[:-1] + ends[1:]) // 2
                ends = np.append(np.stack([ends[:-1], middle], axis=1).ravel(), ends[-1])
        points = points[order]
        return cls(vertices, origin, order, points, ends, boxes, *_neighbours(points))

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """What the kernels take."""
        return self.points, self.ends, self.boxes, self.around, self.planes

    @property
    def extent(self) -> float:
        """Diagonal of the vertices' bounding box, mm."""
        return float(np.linalg.norm(np.ptp(self.vertices, axis=0)))


def _neighbours(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`SurfaceTree.around` and `SurfaceTree.planes`."""
    count = min(AROUND, len(points) - 1)
    around = cKDTree(points).query(points, count + 1)[1]
    # A point comes first among its own neighbours, unless others lie where it does; then any may go.
    itself = around == np.arange(len(points))[:, None]
    itself[~itself.any(axis=1), -1] = True
    around = around[~itself].reshape(-1, count)
    away = points[around] - points[:, None]
    gaps = np.linalg.norm(away, axis=2, keepdims=True)
    # One at the same place can never be nearer: a plane that no point reaches.
    normals = np.divide(away, gaps, out=np.zeros_like(away), where=gaps > 0)
    along = (normals * (points[around] + points[:, None])).sum(axis=2, keepdims=True) / 2
    along[gaps == 0] = np.inf
    return around, np.concatenate([gaps / 2, normals, along], axis=2)
