"""The smallest margin to remove, and the region to stay in, as order statistics.

As in `study.margins.exact`: the order in which voxels enter the margin comes from one set of registrations
(or from the model's own covariance), so that every registration of a second set has one margin from which on
it does no damage, and a third says how good that is. Ranking and stopping on the same set would be a margin
fitted to its own registrations.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from study.errors import MarginError
from study.margins.exact import Choice, Ranking, in_order, ranked_voxels
from study.margins.overall_risk import RiskEstimate
from study.margins.point_risk import all_distances, widest_deviation
from study.margins.protrusion import (
    boundary_centres,
    largest_losses,
    largest_protrusions,
    protrusion_risk,
)
from study.margins.region import Region
from study.margins.room import with_room, without_room
from study.margins.task import Grown, Task

#: Boundary voxels at which it is asked how far registrations move the structure.
_PROBES = 300
#: How much farther the next attempt looks when a registration needs voxels that have no rank yet.
_WIDER = 1.3


def grow_to_remove(
    task: Task, allowed: int, growing: np.random.Generator, validating: np.random.Generator
) -> Grown:
    """The smallest margin that the structure leaves in at most `allowed` of the simulated registrations.

    Parameters
    ----------
    task : Task
    allowed : int
    growing, validating : Generator
        For the registrations that the margin is chosen on, and for fresh ones.

    Raises
    ------
    GeometryError
        If the registrations scatter so far that the margin would be larger than what can be looked at.
    """
    transforms, fresh = task.registrations(growing), task.fresh_registrations(validating)
    cut = _first_cut(task, transforms, allowed)
    while True:
        volume, mask, added = with_room(task.volume, task.mask, _reach(task, cut))
        region = Region.around(mask, volume, _reach(task, cut))
        ranking = ranked_voxels(region, task.metric, cut)
        ranks = np.full(region.shape, len(ranking.order) + 1, np.int32)
        ranks.reshape(-1)[ranking.order] = np.arange(1, len(ranking.order) + 1, dtype=np.int32)
        ranks[region.solid == 1] = 0
        needs = largest_protrusions(region, ranks, transforms, beyond=len(ranking.order) + 1)
        # The curve shall go on for a while beyond the margin.
        if np.count_nonzero(needs > len(ranking.order)) <= allowed // 3:
            break
        cut *= _WIDER
    size = int(np.partition(needs, len(needs) - 1 - allowed)[len(needs) - 1 - allowed])
    union = region.solid == 1
    union.reshape(-1)[ranking.order[:size]] = True
    # A cavity would be spared in the middle of what is removed.
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
    task: Task, allowed: int, growing: np.random.Generator, validating: np.random.Generator
) -> Grown:
    """The smallest rim to avoid, so that at most `allowed` registrations lose any of what is inside.

    Parameters
    ----------
    task : Task
    allowed : int
    growing, validating : Generator
        For the registrations that the margin is chosen on, and for fresh ones.

    Raises
    ------
    MarginError
        If nothing is left inside.
    """
    transforms, fresh = task.registrations(growing), task.fresh_registrations(validating)
    region = Region.around(task.mask, task.volume, 0.0)
    voxels = np.argwhere(region.solid)
    distances = all_distances(region, voxels, task.metric)
    flat = np.ravel_multi_index(tuple(voxels.T), region.shape)
    order = in_order(distances, flat)
    ranking = Ranking(flat[order], distances[order])
    ranks = np.arange(1, len(order) + 1)
    needs = largest_losses(region, ranking.order, ranks, transforms)
    size = int(np.partition(needs, len(needs) - 1 - allowed)[len(needs) - 1 - allowed])
    if size == len(order):
        raise MarginError(
            f"stay_inside: expected a region that lands in the structure in all but {allowed} of "
            f"{len(needs)} registrations; {np.count_nonzero(needs == size)} of them lose even its "
            f"innermost voxel, {distances.max():.3g} {task.unit} from the surface"
        )
    margin = np.zeros(region.shape, bool)
    margin.reshape(-1)[ranking.order[:size]] = True
    validation = None
    if len(fresh):
        lost = largest_losses(region, ranking.order[size:], ranks[size:], fresh)
        validation = RiskEstimate(int(np.count_nonzero(lost)), len(fresh))
    return Grown(
        mask=region.full(margin),
        estimate=RiskEstimate(int(np.count_nonzero(needs > size)), len(needs)),
        validation=validation,
        distance=float(ranking.distances[size - 1]) if size else 0.0,
        choice=Choice(region, ranking, transforms, 0, needs),
        volume=task.volume,
        structure_mask=task.mask,
    )


def _first_cut(task: Task, transforms: np.ndarray, allowed: int) -> float:
    """A distance, in the metric's unit, that a few of the registrations at most carry the surface beyond.

    Where a point appears it is no farther from the surface than from where it was.
    """
    centres = boundary_centres(Region.around(task.mask, task.volume, 0.0).solid)
    low = Region.around(task.mask, task.volume, 0.0).low
    probes = task.volume.points(centres[:: -(-len(centres) // _PROBES)] + low)
    inverse = np.linalg.inv(transforms)
    moved = np.einsum("nab,mb->nma", inverse[:, :3, :3], probes) + inverse[:, None, :3, 3] - probes
    covariance = task.metric.at(probes)
    covariance += 1e-2 * np.trace(covariance, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    root = np.linalg.inv(np.linalg.cholesky(covariance))
    farthest = np.sqrt((np.einsum("mab,nmb->nma", root, moved) ** 2).sum(axis=2).max(axis=1))
    enough = np.partition(farthest, len(farthest) - 1 - allowed // 3)[len(farthest) - 1 - allowed // 3]
    # A voxel that the surface reaches has its centre up to half a diagonal farther away.
    voxel = float(np.cbrt(task.volume.voxel_volume))
    smallest = float(np.sqrt(np.linalg.eigvalsh(covariance)[:, 0].min()))
    return float(max(enough, 1e-3)) + min(0.9 * voxel / max(smallest, 1e-9), 1.0 + enough)


def _reach(task: Task, cut: float) -> float:
    """How far that distance is at most, mm, in the box that it makes about the structure."""
    reach = 0.0
    for _ in range(50):
        volume, mask, _ = with_room(task.volume, task.mask, reach)
        wider = cut * widest_deviation(Region.around(mask, volume, reach), task.metric)
        if wider <= reach:
            return reach
        reach = 1.02 * wider
    raise MarginError(
        f"remove: expected an error that grows by less than a millimetre a millimetre away from the "
        f"structure; {cut:.3g} standard deviations of it reach {reach:.3g} mm and more"
    )
