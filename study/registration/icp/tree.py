"""A surface's vertices in the order of a kd-tree, for many nearest-neighbour searches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from study.registration.rigid import checked_points

#: At most so many vertices in a leaf.
LEAF = 8


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
    """

    vertices: np.ndarray
    origin: np.ndarray
    order: np.ndarray
    points: np.ndarray
    ends: np.ndarray
    boxes: np.ndarray

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
        return cls(vertices, origin, order, points[order], ends, boxes)

    @property
    def extent(self) -> float:
        """Diagonal of the vertices' bounding box, mm."""
        return float(np.linalg.norm(np.ptp(self.vertices, axis=0)))
