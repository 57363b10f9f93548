"""Overall damage risk: how often a registration carries some corner of milled tissue into the structure.

What counts as a hit is said here, once, for every method. Tissue outside structure and margin may be milled.
A registration damages the structure when a corner of a voxel that may be milled lands, by its transform, in a
voxel of the structure (Siebold, 3.2.2; voxels are half open, so that a corner on a face belongs to the
voxel above). Voxels beyond the volume do not exist.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy import stats

from study.margins.motion import _kernels as motion
from study.margins.region import Region
from study.margins.sweep import _kernels

#: Answers remembered at most: 4 bytes each.
_MOST_REMEMBERED = 60_000_000


@dataclass(frozen=True)
class RiskEstimate:
    """A share of registrations that do damage, and how well so many draws know it.

    Attributes
    ----------
    hits, registrations : int
    level : float
        Of the interval.
    """

    hits: int
    registrations: int
    level: float = 0.95

    @property
    def risk(self) -> float:
        """Share of registrations that damage the structure."""
        return self.hits / self.registrations

    @property
    def interval(self) -> tuple[float, float]:
        """Clopper-Pearson interval of the true risk."""
        found = stats.binomtest(self.hits, self.registrations).proportion_ci(self.level, method="exact")
        return float(found.low), float(found.high)


@dataclass(frozen=True, eq=False)
class Corners:
    """Lattice corners that may be milled and reach the structure, each with a value, sorted for the sweep."""

    corners: np.ndarray
    values: np.ndarray
    leaf_start: np.ndarray
    leaf_low: np.ndarray
    leaf_high: np.ndarray
    group_start: np.ndarray
    group_low: np.ndarray
    group_high: np.ndarray
    group_most: np.ndarray


def arranged(where: np.ndarray, value: np.ndarray, lattice: tuple[int, int, int]) -> Corners:
    """Corners sorted into blocks.

    Parameters
    ----------
    where : (n, 3) int32 array
        Corners.
    value : (n,) int32 array
        Not increasing.
    lattice : (3,) ints
        Shape of the lattice.
    """
    size = _kernels.LEAF * _kernels.GROUP
    groups = int(np.prod([(n - 1) // size + 1 for n in lattice]))
    leaves = min(groups * _kernels.GROUP**3, len(where))
    corners, values = np.empty_like(where), np.empty_like(value)
    leaf_start = np.empty(leaves + 1, np.int64)
    low, high = np.empty((leaves, 3), np.int64), np.empty((leaves, 3), np.int64)
    group_start = np.empty(groups + 1, np.int64)
    leaves, groups = _kernels.arrange(
        where, value, np.array(lattice), corners, values, leaf_start, low, high, group_start
    )
    leaf_start, low, high = leaf_start[: leaves + 1], low[:leaves], high[:leaves]
    group_start = group_start[: groups + 1]
    first = group_start[:-1]
    if groups == 0:
        empty = np.empty((0, 3), np.int64)
        return Corners(
            corners, values, leaf_start, low, high, group_start, empty, empty, np.empty(0, np.int32)
        )
    return Corners(
        corners,
        values,
        leaf_start,
        low,
        high,
        group_start,
        np.minimum.reduceat(low, first),
        np.maximum.reduceat(high, first),
        np.maximum.reduceat(values[leaf_start[:-1]], first),
    )


def ranked_corners(region: Region, order: np.ndarray) -> Corners:
    """Every corner that may be milled, with the largest rank of the voxels that it touches.

    It may be milled by margins of fewer voxels than that.

    Parameters
    ----------
    region : Region
    order : (n,) int array
        Flat indices of voxels in the box, the first to enter the margin first.
    """
    state = region.solid.copy()
    state.reshape(-1)[order] = 2
    room = 8 * len(order) + 1024
    while True:
        where, value = np.empty((room, 3), np.int32), np.empty(room, np.int32)
        room = _kernels.exposed_corners(order, state, where, value)
        if room <= len(where):
            break
    where, value = where[:room], value[:room]
    return arranged(where, value, tuple(n + 1 for n in region.shape))


def shell_corners(union: np.ndarray) -> Corners:
    """The corners between structure with margin and the shell around it, each of value 1."""
    where = np.empty((max(1024, 2 * int(np.count_nonzero(union))), 3), np.int32)
    count = _kernels.shell_corners(union, where)
    if count > len(where):
        where = np.empty((count, 3), np.int32)
        _kernels.shell_corners(union, where)
    return arranged(where[:count], np.ones(count, np.int32), tuple(n + 1 for n in union.shape))


def largest_values(
    corners: Corners, region: Region, transforms: np.ndarray, above: int = 0, first_only: bool = False
) -> np.ndarray:
    """For each transform the largest value of the corners that it carries into the structure.

    Parameters
    ----------
    corners : Corners
    region : Region
    transforms : (n, 4, 4) array
        mm.
    above : int
        Smaller values do not count.
    first_only : bool
        Only ask whether there is one: the value found is any above `above`.

    Returns
    -------
    (n,) int32 array
        `above` where there is none.
    """
    moves = region.moves(transforms)
    out = np.full(len(moves), above, np.int32)
    if len(corners.values) == 0:
        return out
    low, counts = _offsets_that_occur(moves, region.shape)
    offsets = int(np.prod(counts))
    use = offsets * (len(corners.leaf_start) + len(corners.group_start)) <= _MOST_REMEMBERED
    table = np.column_stack([low, counts])

    def part(piece: slice) -> None:
        leaves, groups = (len(corners.leaf_start) - 1, len(corners.group_start) - 1) if use else (1, 1)
        _kernels.sweep(
            moves[piece],
            region.solid,
            corners.corners,
            corners.values,
            corners.leaf_start,
            corners.leaf_low,
            corners.leaf_high,
            corners.group_start,
            corners.group_low,
            corners.group_high,
            corners.group_most,
            np.zeros((leaves, offsets if use else 1), np.int32),
            np.zeros((groups, offsets if use else 1), np.int32),
            table,
            use,
            above,
            first_only,
            out[piece],
        )

    part(slice(None))
    return out


def _offsets_that_occur(moves: np.ndarray, shape: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Least offset along each axis of any corner of a box by any transform, and how many from there on."""
    box = np.array(list(product(*((0, n) for n in shape))), dtype=float)
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    motion.offset_range(moves, box, low, high)
    return low, high - low + 1
