"""The printed growth of a margin, step by step (Siebold, 3.2.1 to 3.2.4).

Each step draws fresh registrations and measures the overall damage risk with the analyzed shell, the
26-neighbours of structure and margin. While it is above the tolerance, the voxels of the shell with the
highest point damage risk enter the margin.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from study.errors import MarginError
from study.margins.exact import in_order
from study.margins.overall_risk import overall_damage_risk
from study.margins.point_risk import all_distances
from study.margins.region import Region, neighbours, reach_of
from study.margins.task import Grown, Task


def transfer_share(risk: float, acceptable_risk: float, initial: float, decay_start: float) -> float:
    """Share of the shell that a step transfers: constant, then linear down to 0 at the acceptable risk.

    Source: figure 3.8.
    """
    if decay_start <= acceptable_risk:
        return initial
    return initial * min(1.0, max(0.0, (risk - acceptable_risk) / (decay_start - acceptable_risk)))


def shell_of(union: np.ndarray) -> np.ndarray:
    """Bool mask of the analyzed shell: voxels outside that share a corner with one inside.

    Parameters
    ----------
    union : (nx, ny, nz) uint8 array
        Structure and margin.
    """
    return neighbours(union) & (union == 0)


def grow_as_published(task: Task, growing: np.random.Generator, validating: np.random.Generator) -> Grown:
    """Grow a margin until the overall damage risk of a step is acceptable.

    Parameters
    ----------
    task : Task
    growing, validating : Generator
        For the registrations of the steps, and for fresh ones.

    Raises
    ------
    MarginError
        If that takes more than ``settings.most_steps`` steps.
    """
    settings = task.settings
    reach = farthest = 0.0
    region, margin = None, np.zeros(task.mask.shape, bool)
    rows = []
    for _ in range(settings.most_steps):
        transforms = task.registrations(growing)
        if (needed := reach_of(transforms, task.mask, task.volume)) > reach:
            # Room for the next draws too: what is known is lost with the box.
            reach = 1.3 * needed
            margin = margin if region is None else region.full(margin)
            region = Region.around(task.mask, task.volume, reach)
            margin = region.part(margin)
            distances = np.full(region.shape, np.nan)
        union = region.solid | margin.view(np.uint8)
        estimate = overall_damage_risk(region, union, transforms, shell_only=True)
        shell = shell_of(union)
        share = transfer_share(
            estimate.risk, task.acceptable_risk, settings.initial_transfer, task.decay_start
        )
        rows.append((int(margin.sum()), int(shell.sum()), estimate.risk, share))
        if estimate.risk <= task.acceptable_risk:
            break
        fresh = np.argwhere(shell & np.isnan(distances))
        distances[tuple(fresh.T)] = all_distances(region, fresh, task.metric, farthest)
        flat = np.flatnonzero(shell)
        order = in_order(distances.reshape(-1)[flat], flat)
        count = min(len(flat), max(settings.least_transfer, int(share * len(flat))))
        chosen = flat[order[:count]]
        farthest = max(farthest, float(distances.reshape(-1)[chosen].max()))
        margin.reshape(-1)[chosen] = True
    else:
        raise MarginError(
            f"growth stalled: expected an overall damage risk of at most {task.acceptable_risk} within "
            f"{settings.most_steps} steps, got {rows[-1][2]:.4g} with {rows[-1][0]} voxels in the margin"
        )
    mask = region.full(margin)
    validation = None
    if len(fresh := task.fresh_registrations(validating)):
        region = Region.around(task.mask, task.volume, reach_of(fresh, task.mask, task.volume))
        validation = overall_damage_risk(region, region.part(task.mask | mask).view(np.uint8), fresh)
    history = pd.DataFrame(rows, columns=["margin_voxels", "shell_voxels", "risk", "transfer_share"])
    return Grown(mask, estimate, validation, farthest, history=history)
