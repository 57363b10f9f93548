"""The part of a volume in which registration error can matter to a structure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from study.errors import InputError
from study.margins.distances import _kernels as distances
from study.margins.motion import _kernels as motion
from study.threads import in_threads
from study.volumes import LabelVolume

# Edges, in voxels, of the blocks for which offsets and deviations are bounded; offsets by looking at every
# registration.
_OFFSET_BLOCK = 64
_DEVIATION_BLOCK = 32
# Up to so many offsets of a block it is worked out which occur; of more only the range along each axis.
_MOST_OFFSETS = 4000
#: Structures of fewer voxels are specks of a segmentation, not anatomy.
LEAST_VOXELS = 10


@dataclass(frozen=True, eq=False)
class Region:
    """A box of voxels about a structure.

    The structure is where it is drawn; beyond the volume there are no voxels.

    Attributes
    ----------
    solid : (nx, ny, nz) uint8 array
        1 in the structure.
    low : (3,) int array
        Index of the box's first voxel in the volume.
    affine : (4, 4) array
        Box index of voxel centres to mm.
    whole : (3,) ints
        Shape of the volume.
    """

    solid: np.ndarray
    low: np.ndarray
    affine: np.ndarray
    whole: tuple[int, int, int]

    @classmethod
    def around(cls, mask: np.ndarray, volume: LabelVolume, reach: float) -> Region:
        """The box that holds a structure and all that lies within `reach` mm of it, and four voxels more."""
        low, high = bounding_box(mask)
        width = np.ceil(reach * steps_per_mm(volume.affine)).astype(int) + 4
        low, high = np.maximum(low - width, 0), np.minimum(high + width, mask.shape)
        box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        affine = volume.affine.copy()
        affine[:3, 3] = volume.points(low[None].astype(float))[0]
        return cls(np.ascontiguousarray(mask[box]).view(np.uint8), low, affine, mask.shape)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels of the box along i, j, k."""
        return self.solid.shape

    @property
    def voxel_volume(self) -> float:
        """mm^3."""
        return float(abs(np.linalg.det(self.affine[:3, :3])))

    @cached_property
    def extent(self) -> np.ndarray:
        """(3, 2) first and last voxel of the structure along each axis."""
        low, high = bounding_box(self.solid)
        return np.column_stack([low, high - 1])

    @property
    def box(self) -> tuple[slice, slice, slice]:
        """Where the box is in the volume."""
        return tuple(slice(a, a + n) for a, n in zip(self.low, self.shape, strict=True))

    def part(self, mask: np.ndarray) -> np.ndarray:
        """The box's part, a copy, of a mask of the whole volume."""
        return np.array(mask[self.box], order="C")

    def full(self, mask: np.ndarray) -> np.ndarray:
        """A bool mask of the whole volume from one of the box."""
        out = np.zeros(self.whole, bool)
        out[self.box] = mask
        return out

    def corner_points(self, corners: np.ndarray) -> np.ndarray:
        """(n, 3) mm of (n, 3) lattice corners; corner (a, b, c) is the lowest one of voxel (a, b, c)."""
        return (corners - 0.5) @ self.affine[:3, :3].T + self.affine[:3, 3]

    def moves(self, transforms: np.ndarray) -> np.ndarray:
        """(n, 3, 4) ``[D, t]``: each transform moves lattice corner c by ``D c + t`` voxels."""
        to_mm = np.ascontiguousarray(self.affine[:3, :3])
        first = self.corner_points(np.zeros((1, 3)))[0]
        out = np.empty((len(transforms), 3, 4))
        motion.lattice_moves(transforms, np.linalg.inv(to_mm), to_mm, first, out)
        return out

    def reaching_corners(self, transforms: np.ndarray) -> np.ndarray:
        """(nx + 1, ny + 1, nz + 1) uint8 array: corners that a transform may carry into the structure.

        Every corner that one does carry there, and some more.
        """
        out = np.zeros(tuple(n + 1 for n in self.shape), np.uint8)
        blocks = int(np.prod([-(-n // _OFFSET_BLOCK) for n in out.shape]))
        low, high = np.empty((blocks, 3), np.int64), np.empty((blocks, 3), np.int64)
        moves, lattice = self.moves(transforms), np.array(out.shape)
        motion.offsets_of_blocks(moves, lattice, _OFFSET_BLOCK, low, high)
        offsets = (high - low + 1).max(axis=0)
        table = None if np.prod(offsets) > _MOST_OFFSETS else np.zeros((blocks, *offsets), np.uint8)

        def part(piece: slice) -> None:
            if table is None:
                motion.reaching(self.solid, _OFFSET_BLOCK, piece.start, piece.stop, low, high, out)
                return
            which = (_OFFSET_BLOCK, piece.start, piece.stop)
            motion.offsets_that_occur(moves, lattice, *which, low, high, table)
            motion.reached(self.solid, *which, low, table, out)

        in_threads(part, blocks, least=4)
        return out

    def near(self, deviations: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """(n, 3) voxels outside the structure that are near it.

        Parameters
        ----------
        deviations : callable
            From (m, 3) points in mm to (m,) mm: how near counts there; convex.

        Returns
        -------
        (n, 3) int array
            All voxels with their centre as near to a corner of the structure's surface, and some more.
        """
        size = _DEVIATION_BLOCK
        blocks = np.argwhere(np.ones([-(-n // size) for n in self.shape], bool)) * size
        ends = np.minimum(blocks + size, self.shape) - 1
        reach = np.zeros(len(blocks))
        for pick in product((False, True), repeat=3):
            points = np.where(pick, ends, blocks) @ self.affine[:3, :3].T + self.affine[:3, 3]
            reach = np.maximum(reach, deviations(points))
        width = np.ceil(reach[:, None] * steps_per_mm(self.affine)).astype(np.int64) + 1
        out = np.zeros(self.shape, np.uint8)

        def part(piece: slice) -> None:
            motion.reaching(self.solid, size, piece.start, piece.stop, -width, width, out)

        in_threads(part, len(blocks), least=4)
        return distances.listed(out, self.solid)


def neighbours(solid: np.ndarray) -> np.ndarray:
    """Bool mask of voxels that are set in a uint8 array or share a corner with one that is."""
    out = np.zeros(solid.shape, np.uint8)
    blocks = int(np.prod([-(-n // _OFFSET_BLOCK) for n in solid.shape]))
    steps = np.ones((blocks, 3), np.int64)
    motion.reaching(solid, _OFFSET_BLOCK, 0, blocks, -steps, steps, out)
    return out == 1


def steps_per_mm(affine: np.ndarray) -> np.ndarray:
    """(3,) voxels that a ball of radius 1 mm reaches along each index axis."""
    return np.linalg.norm(np.linalg.inv(affine[:3, :3]), axis=1)


def bounding_box(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and one past the last index of the set voxels along each axis."""
    lines = [np.flatnonzero(mask.any(axis=tuple(a for a in range(3) if a != axis))) for axis in range(3)]
    return np.array([line[0] for line in lines]), np.array([line[-1] + 1 for line in lines])


def reach_of(transforms: np.ndarray, mask: np.ndarray, volume: LabelVolume) -> float:
    """How far any of the transforms moves a point that it can bring into the structure, at most, mm.

    A displacement is affine in the point, so that in a box it is largest at one of the box's corners. Points
    from beyond the box cannot get in unless a transform turns by some 90 degrees, which no registration does.
    """
    first, last = bounding_box(mask)
    reach = 0.0
    while True:
        width = np.ceil(reach * steps_per_mm(volume.affine)).astype(int) + 1
        low, high = np.maximum(first - width, 0), np.minimum(last + width, mask.shape)
        box = volume.points(np.array(list(product(*zip(low - 0.5, high - 0.5, strict=True)))))
        most = motion.largest_displacement(transforms, box)
        if most <= reach or ((low == 0).all() and (high == mask.shape).all()):
            return most
        reach = most * 1.01


def edge_share(mask: np.ndarray) -> float:
    """Share of a structure's surface, in voxel faces, that is only the edge of the volume."""
    edge = sum(int(np.count_nonzero(np.take(mask, [0, -1], axis=axis))) for axis in range(3))
    inner = 0
    for axis in range(3):
        moved = np.moveaxis(mask, axis, 0)
        inner += int(np.count_nonzero(moved[1:] != moved[:-1]))
    return edge / (edge + inner)


def checked_structure(mask: np.ndarray, name: str, volume: LabelVolume) -> np.ndarray:
    """The mask of a structure that a margin can be grown around.

    Raises
    ------
    InputError
        If it is another shape than the volume, fewer than `LEAST_VOXELS` voxels, or all of them.
    """
    mask = np.ascontiguousarray(mask)
    if mask.dtype != bool or mask.shape != volume.shape:
        raise InputError(
            f"{name}: expected a bool mask of shape {volume.shape}, got {mask.dtype} of shape {mask.shape}"
        )
    count = int(np.count_nonzero(mask))
    if count < LEAST_VOXELS:
        raise InputError(f"{name}: expected a structure of at least {LEAST_VOXELS} voxels, got {count}")
    if count == mask.size:
        raise InputError(f"{name}: expected voxels around the structure, got a volume full of it")
    return mask
