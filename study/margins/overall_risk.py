"""Overall damage risk: how often a registration carries some corner of milled tissue into the structure.

What counts as a hit is said here, once, for every method. Tissue outside structure and margin may be milled.
A registration damages the structure when a corner of a voxel that may be milled lands, by its transform, in a
voxel of the structure (Siebold, 3.2.2; voxels are half open, so that a corner on a face belongs to the
voxel above). Voxels beyond the volume do not exist. The printed growth looks for hits only among the corners
of the analyzed shell, which is the same unless a registration jumps over the shell.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import stats

from study.margins.motion import _kernels as motion
from study.margins.region import Region
from study.margins.sweep import _kernels
from study.threads import in_threads

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
    """Lattice corners that may be milled and can reach the structure, each with a value, in blocks.

    See `study.margins.sweep._kernels.arrange`.
    """

    corners: np.ndarray
    values: np.ndarray
    leaf_start: np.ndarray
    leaf_low: np.ndarray
    leaf_high: np.ndarray
    group_start: np.ndarray

    @cached_property
    def groups(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Smallest and largest corner and largest value of each group."""
        first = self.group_start[:-1]
        return (
            np.minimum.reduceat(self.leaf_low, first),
            np.maximum.reduceat(self.leaf_high, first),
            np.maximum.reduceat(self.values[self.leaf_start[:-1]], first),
        )


def ranked_corners(region: Region, order: np.ndarray, reaching: np.ndarray, above: int = 0) -> Corners:
    """Every corner that may be milled, with the largest rank of the voxels that it touches.

    It may be milled by margins of fewer voxels than that. Voxels without a rank come after all others.

    Parameters
    ----------
    region : Region
    order : (n,) int array
        Flat indices of voxels in the box, the first to enter the margin first.
    reaching : (nx + 1, ny + 1, nz + 1) uint8 array
        See `Region.reaching_corners`.
    above : int
        Corners worth no more are left out.
    """
    rank = np.full(region.shape, len(order) + 1, np.int32)
    rank.reshape(-1)[order] = np.arange(1, len(order) + 1, dtype=np.int32)
    rank[region.solid == 1] = 0
    return Corners(*_kernels.arrange(rank, reaching, above, False))


def millable_corners(union: np.ndarray, reaching: np.ndarray, shell_only: bool = False) -> Corners:
    """The corners of voxels outside structure and margin, each of value 1.

    Parameters
    ----------
    union : (nx, ny, nz) uint8 array
        Structure and margin.
    reaching : (nx + 1, ny + 1, nz + 1) uint8 array
        See `Region.reaching_corners`.
    shell_only : bool
        Only those that also touch structure or margin: the inner face of the analyzed shell.
    """
    return Corners(*_kernels.arrange((union == 0).astype(np.int32), reaching, 0, shell_only))


def overall_damage_risk(
    region: Region, union: np.ndarray, transforms: np.ndarray, shell_only: bool = False
) -> RiskEstimate:
    """Overall damage risk when all tissue outside `union` (structure and margin) may be milled.

    Parameters
    ----------
    region : Region
        That holds all from which the transforms reach the structure.
    union : (nx, ny, nz) uint8 array
    transforms : (n, 4, 4) array
        mm.
    shell_only : bool
        Only look at the analyzed shell, as the printed growth does. A registration that carries tissue from
        beyond the shell right into a thin structure, and none of the shell, goes unseen then.
    """
    corners = millable_corners(union, region.reaching_corners(transforms), shell_only)
    hits = largest_values(corners, region, transforms, first_only=True)
    return RiskEstimate(int(np.count_nonzero(hits)), len(transforms))


class Memory:
    """Answers of blocks of corners to offsets, shared by all sweeps over the same corners.

    Threads may fill it together: whoever comes first, the answer is the same.

    Parameters
    ----------
    corners : Corners
    moves : (n, 3, 4) float array
        Of the registrations that it is to serve; others are served too, but slowly.
    shape : (3,) ints
        Of the region's box.
    """

    def __init__(self, corners: Corners, moves: np.ndarray, shape: tuple[int, int, int]) -> None:
        lattice = np.array(shape) + 1
        low, high = np.empty((1, 3), np.int64), np.empty((1, 3), np.int64)
        motion.offsets_of_blocks(moves, lattice, int(lattice.max()), low, high)
        counts = high[0] - low[0] + 1
        leaves, groups = len(corners.leaf_start) - 1, len(corners.group_start) - 1
        offsets = int(np.prod(counts))
        self.use = offsets * (leaves + groups) <= _MOST_REMEMBERED
        self.table = np.column_stack([low[0], counts])
        # Pages of zeros that nobody writes to take no memory.
        self.leaves = np.zeros((leaves, offsets) if self.use else (1, 1), np.int32)
        self.groups = np.zeros((groups, offsets) if self.use else (1, 1), np.int32)


def largest_values(
    corners: Corners,
    region: Region,
    transforms: np.ndarray,
    above: int = 0,
    first_only: bool = False,
    memory: Memory | None = None,
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
    memory : Memory, optional
        Of the same corners.

    Returns
    -------
    (n,) int32 array
        `above` where there is none.
    """
    moves = region.moves(transforms)
    out = np.full(len(moves), above, np.int32)
    if len(corners.values) == 0:
        return out
    memory = memory or Memory(corners, moves, region.shape)
    extent = region.extent

    def part(piece: slice) -> None:
        _kernels.sweep(
            moves[piece],
            region.solid,
            extent,
            corners.corners,
            corners.values,
            corners.leaf_start,
            corners.leaf_low,
            corners.leaf_high,
            corners.group_start,
            *corners.groups,
            memory.leaves,
            memory.groups,
            memory.table,
            memory.use,
            above,
            first_only,
            out[piece],
        )

    in_threads(part, len(moves), least=2000)
    return out
