"""The smallest margin to remove, and the region to stay in, as order statistics.

As in `study.margins.exact`: the order in which voxels enter the margin comes from one set of registrations
(`study.margins.coverage`) or from distances alone, so that every registration of a second set has one margin
from which on it does no damage, and a third says how good that is. Ranking and stopping on the same set would
be a margin fitted to its own registrations.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from study.errors import MarginError
from study.margins.coverage import coverage, loss, millimetres_to
from study.margins.exact import Choice, Ranking
from study.margins.order_statistics import smallest_margin
from study.margins.overall_risk import RiskEstimate
from study.margins.protrusion import (
    farthest_moved,
    largest_losses,
    largest_protrusions,
    protrusion_risk,
)
from study.margins.region import Region
from study.margins.room import room_for, with_edge, with_room, without_room
from study.margins.task import Grown, Task


def grow_to_remove(
    task: Task,
    allowed: int,
    growing: np.random.Generator,
    validating: np.random.Generator,
    ranks_from: np.random.Generator,
) -> Grown:
    """The smallest margin that the structure leaves in at most `allowed` of the simulated registrations.

    Parameters
    ----------
    task : Task
    allowed : int
    growing, validating : Generator
        For the registrations that the margin is chosen on, and for fresh ones.
    ranks_from : Generator
        For those that voxels are ranked by.

    Raises
    ------
    GeometryError
        If the registrations scatter so far that the margin would be larger than what can be looked at.
    """
    transforms, fresh = task.registrations(growing), task.fresh_registrations(validating)
    reach = _reach(task, transforms, allowed)
    volume, mask, added = with_room(task.volume, task.mask, reach)
    region = Region.around(mask, volume, reach)
    # A cavity would be spared in the middle of what is removed: it comes first.
    cavity = ndimage.binary_fill_holes(region.solid) & (region.solid == 0)
    near = cavity.copy()
    near[tuple(region.near(lambda points: np.full(len(points), reach)).T)] = True
    ranking = _ranked(region, np.argwhere(near), task, ranks_from, cavity)
    ranks = np.full(region.shape, len(ranking.order) + 1, np.int32)
    ranks.reshape(-1)[ranking.order] = np.arange(1, len(ranking.order) + 1, dtype=np.int32)
    ranks[region.solid == 1] = 0
    needs = largest_protrusions(region, ranks, transforms, beyond=len(ranking.order) + 1)
    size = smallest_margin(needs, allowed)
    size = max(size, np.count_nonzero(cavity))
    union = region.solid == 1
    union.reshape(-1)[ranking.order[:size]] = True
    # And what the margin itself has come to enclose.
    union = ndimage.binary_fill_holes(union)
    solid = union.astype(np.uint8)
    margin = region.full(union & (region.solid == 0))
    if margin.sum() == without_room(margin, added).sum():
        volume, mask, margin = task.volume, task.mask, without_room(margin, added)
    return Grown(
        mask=margin,
        estimate=protrusion_risk(region, solid, transforms),
        validation=protrusion_risk(region, solid, fresh) if len(fresh) else None,
        distance=float(ranking.distances[size - 1]) if size else 0.0,
        choice=Choice(region, ranking, transforms, 0, needs),
        volume=volume,
        structure_mask=mask,
    )


def grow_to_stay_inside(
    task: Task,
    allowed: int,
    growing: np.random.Generator,
    validating: np.random.Generator,
    ranks_from: np.random.Generator,
) -> Grown:
    """The smallest rim to avoid, so that at most `allowed` registrations lose any of what is inside.

    Where the volume cuts a structure off, its edge is a surface: nobody knows what is beyond.

    Parameters
    ----------
    task : Task
    allowed : int
    growing, validating : Generator
        For the registrations that the margin is chosen on, and for fresh ones.
    ranks_from : Generator
        For those that voxels are ranked by.

    Raises
    ------
    MarginError
        If nothing is left inside.
    """
    transforms, fresh = task.registrations(growing), task.fresh_registrations(validating)
    inner = Region.around(task.mask, task.volume, 0.0)
    region = with_edge(inner)
    ranking = _ranked(region, np.argwhere(region.solid), task, ranks_from, np.zeros(region.shape, bool))
    order, distances = ranking.order, ranking.distances
    ranks = np.arange(1, len(order) + 1)
    needs = largest_losses(region, order, ranks, transforms)
    size = smallest_margin(needs, allowed)
    if size == len(order):
        raise MarginError(
            f"stay_inside: expected a region that lands in the structure in all but {allowed} of "
            f"{len(needs)} registrations; {np.count_nonzero(needs == size)} of them lose even its "
            f"innermost voxel, {distances.max():.3g} mm from the outside"
        )
    margin = np.zeros(region.shape, bool)
    margin.reshape(-1)[order[:size]] = True
    validation = None
    if len(fresh):
        lost = largest_losses(region, order[size:], ranks[size:], fresh)
        validation = RiskEstimate(int(np.count_nonzero(lost)), len(fresh))
    return Grown(
        mask=inner.full(margin[1:-1, 1:-1, 1:-1]),
        estimate=RiskEstimate(int(np.count_nonzero(needs > size)), len(needs)),
        validation=validation,
        distance=float(ranking.distances[size - 1]) if size else 0.0,
        choice=Choice(region, ranking, transforms, 0, needs),
        volume=task.volume,
        structure_mask=task.mask,
    )


def _ranked(
    region: Region, voxels: np.ndarray, task: Task, ranking: np.random.Generator, first: np.ndarray
) -> Ranking:
    """Voxels in the order in which they enter the margin, and how far they are from where it begins, mm.

    Those of the mask `first` come before all others, at no distance.
    """
    remove = task.purpose == "remove"
    millimetres = millimetres_to((region.solid == 1) == remove, region.affine)[tuple(voxels.T)]
    flat = np.ravel_multi_index(tuple(voxels.T), region.shape)
    keys = [flat, millimetres]
    if task.shape == "spatially_varying":
        transforms = task.ranking_registrations(ranking)
        risk = coverage(region, transforms) if remove else loss(region, transforms)
        keys.append(-risk[tuple(voxels.T)])
    enclosed = first[tuple(voxels.T)]
    millimetres[enclosed] = 0.0
    order = np.lexsort([*keys, ~enclosed])
    return Ranking(flat[order], np.maximum.accumulate(millimetres[order]))


def _reach(task: Task, transforms: np.ndarray, allowed: int) -> float:
    """How far the structure appears from itself, mm, in all but a third of the registrations that may do
    damage.

    The margin is nowhere thicker, and its curve goes on for a while beyond it.
    """
    moved, diagonal = farthest_moved(task.volume, task.mask, transforms)
    return room_for(task.volume, task.mask, moved, allowed // 3, allowed, diagonal)
