"""The margin as an order statistic: which margin each registration needs, in one sweep.

The order in which voxels enter a margin does not depend on the simulated registrations. So there is a size
of margin with which a registration can still do damage and beyond which it never does: the largest rank among
the voxels of which it carries a corner into the structure. The k + 1 registrations that need most fix the
margin with which at most k do damage.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from study.margins.order_statistics import smallest_margin
from study.margins.overall_risk import Memory, RiskEstimate, largest_values, ranked_corners
from study.margins.point_risk import reach_of_metric, smallest_distances, widest_deviation
from study.margins.region import Region, reach_of
from study.margins.task import Grown, Task
from study.registration.moments import DisplacementMoments

#: Distances that differ by less than this are a tie, which the voxel's place in memory breaks.
_TIE = 1e-9
#: How much farther the next attempt looks when a registration needs voxels that have no rank yet.
_WIDER = 1.3
# Share of that distance below which no margin is expected to end: at first needs below it are not found.
_FLOOR = 0.85
# How much lower the next attempt looks; all the way where there are few voxels.
_LOWER = 0.85
_SMALL = 10_000


@dataclass(frozen=True, eq=False)
class Ranking:
    """Voxels in the order in which they enter a margin.

    Attributes
    ----------
    order : (n,) int array
        Flat indices in the region's box.
    distances : (n,) array
        To the structure's surface; standard deviations, or mm for constant thickness. Not decreasing.
    """

    order: np.ndarray
    distances: np.ndarray


def ranked_voxels(region: Region, metric: DisplacementMoments, cut: float) -> Ranking:
    """Rank voxels outside a structure by their smallest distance to its surface.

    Parameters
    ----------
    region : Region
    metric : DisplacementMoments
        Of the error, or `study.margins.point_risk.euclidean`.
    cut : float
        Distance from which on voxels get no rank.
    """
    reach = reach_of_metric(region, metric)
    voxels = region.near(lambda points: cut * reach(points))
    distances = smallest_distances(region, voxels, metric, cut)
    near = np.isfinite(distances)
    flat = np.ravel_multi_index(tuple(voxels[near].T), region.shape)
    distances = distances[near]
    order = in_order(distances, flat)
    return Ranking(flat[order], distances[order])


def in_order(distances: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Indices that sort voxels by distance, ties by their place in memory."""
    return np.lexsort((flat, np.rint(distances / _TIE)))


def first_cut(
    region: Region, metric: DisplacementMoments, moments: DisplacementMoments, risk: float
) -> float:
    """A distance that probably holds every voxel of a margin, in the metric's unit.

    A rigid motion is longer than q standard deviations of its six parameters as often as chi-squared
    says, and no point moves by more of its own; a corner and a surface point may each be most of a voxel off.
    """
    deviations = np.sqrt(stats.chi2.isf(risk / 4, 6))
    centre = region.affine[:3, :3] @ (np.array(region.shape) / 2 - 0.5) + region.affine[:3, 3]
    voxel = float(np.cbrt(region.voxel_volume))
    if metric is moments:
        smallest = float(np.sqrt(max(np.linalg.eigvalsh(moments.at(centre[None]))[0, 0], 0.0)))
        return deviations + min(0.35 * voxel / max(smallest, 1e-9), 2 * deviations)
    return float(deviations * widest_deviation(region, moments) * 0.8 + 0.6 * voxel)


@dataclass(frozen=True, eq=False)
class Choice:
    """Registrations and ranked voxels from which a margin was chosen.

    Attributes
    ----------
    region : Region
    ranking : Ranking
    transforms : (n, 4, 4) array
        The simulated registrations.
    floor : int
        Smaller needs were not looked for.
    largest_needs : (n,) int32 array
        Voxels of the smallest margin from which on each registration is harmless; `floor` if no more, one
        more than there are ranked voxels where these are not enough.
    """

    region: Region
    ranking: Ranking
    transforms: np.ndarray
    floor: int
    largest_needs: np.ndarray

    def needs(self) -> np.ndarray:
        """(n,) int32 array: as `largest_needs`, without the floor."""
        if self.floor == 0:
            return self.largest_needs
        reaching = self.region.reaching_corners(self.transforms)
        corners = ranked_corners(self.region, self.ranking.order, reaching)
        return largest_values(corners, self.region, self.transforms)


def grow_exactly(
    task: Task, allowed: int, growing: np.random.Generator, validating: np.random.Generator
) -> Grown:
    """The smallest margin with which at most `allowed` of the simulated registrations do damage.

    Parameters
    ----------
    task : Task
    allowed : int
    growing, validating : Generator
        For the registrations that the margin is chosen on, and for fresh ones.
    """
    transforms, fresh = task.registrations(growing), task.fresh_registrations(validating)
    every = np.concatenate([transforms, fresh])
    region = Region.around(task.mask, task.volume, reach_of(every, task.mask, task.volume))
    reaching, moves = region.reaching_corners(every), region.moves(every)
    cut = first_cut(region, task.metric, task.moments, task.acceptable_risk)
    enough = False
    while not enough:
        ranking = ranked_voxels(region, task.metric, cut)
        lowest = _FLOOR * cut
        while True:
            floor = int(np.searchsorted(ranking.distances, lowest))
            corners = ranked_corners(region, ranking.order, reaching, floor)
            memory = Memory(corners, moves, region.shape)
            needs = largest_values(corners, region, transforms, above=floor, memory=memory)
            if floor == 0 or np.count_nonzero(needs > floor) > allowed:
                break
            lowest *= _LOWER if floor > _SMALL else 0.0
        # The curve shall go on for a while beyond the margin.
        beyond = np.count_nonzero(needs > len(ranking.order))
        enough = beyond <= allowed // 3 or len(ranking.order) == np.count_nonzero(region.solid == 0)
        cut *= _WIDER
    size = smallest_margin(needs, allowed)
    margin = np.zeros(region.shape, bool)
    margin.reshape(-1)[ranking.order[:size]] = True
    validation = None
    if len(fresh):
        hits = largest_values(corners, region, fresh, above=size, first_only=True, memory=memory) > size
        validation = RiskEstimate(int(np.count_nonzero(hits)), len(fresh))
    return Grown(
        mask=region.full(margin),
        estimate=RiskEstimate(int(np.count_nonzero(needs > size)), len(needs)),
        validation=validation,
        distance=float(ranking.distances[size - 1]) if size else 0.0,
        choice=Choice(region, ranking, transforms, floor, needs),
    )
