"""The printed growth of a margin, step by step (Siebold, 3.2.1 to 3.2.4).

Each step draws fresh registrations and measures the overall damage risk with the analyzed shell, the
26-neighbours of structure and margin. While it is above the tolerance, the voxels of the shell with the
highest point damage risk enter the margin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from study.errors import MarginError
from study.margins.distances import _kernels
from study.margins.exact import in_order
from study.margins.overall_risk import RiskEstimate, overall_damage_risk
from study.margins.point_risk import smallest_distances
from study.margins.region import Region, reach_of
from study.margins.settings import GrowthSettings
from study.registration.moments import DisplacementMoments
from study.registration.sources import ErrorSource, checked_transforms
from study.volumes import LabelVolume


def transfer_share(risk: float, acceptable_risk: float, initial: float, decay_start: float) -> float:
    """Share of the shell that a step transfers: constant, then linear down to 0 at the acceptable risk.

    Source: figure 3.8.
    """
    if decay_start <= acceptable_risk:
        return initial
    return initial * min(1.0, max(0.0, (risk - acceptable_risk) / (decay_start - acceptable_risk)))


def shell_of(union: np.ndarray) -> np.ndarray:
    """Bool mask of the analyzed shell: voxels outside that share a corner with one inside."""
    out = np.zeros(union.shape, np.uint8)
    _kernels.widen(union, np.ones(3, np.int64), out)
    return (out == 1) & (union == 0)


@dataclass(frozen=True, eq=False)
class Growth:
    """A margin grown step by step.

    Attributes
    ----------
    region : Region
    margin : (nx, ny, nz) bool array
        In the region's box.
    estimate : RiskEstimate
        Of the last step, with which growth stopped.
    history : DataFrame
        One row a step: voxels in margin and shell, risk, share transferred.
    distance : float
        Largest of a transferred voxel.
    """

    region: Region
    margin: np.ndarray
    estimate: RiskEstimate
    history: pd.DataFrame
    distance: float


def grow_as_published(
    mask: np.ndarray,
    volume: LabelVolume,
    model: ErrorSource,
    metric: DisplacementMoments,
    acceptable_risk: float,
    decay_start: float,
    settings: GrowthSettings,
    rng: np.random.Generator,
) -> Growth:
    """Grow a margin until the overall damage risk of a step is acceptable.

    Raises
    ------
    MarginError
        If that takes more than ``settings.most_steps`` steps.
    """
    reach, region, margin, distances = 0.0, None, None, None
    known = 0.0
    rows = []
    for _ in range(settings.most_steps):
        transforms = checked_transforms(model, settings.registrations, rng)
        if (needed := reach_of(transforms, mask, volume)) > reach:
            reach = 1.3 * needed
            before = None if region is None else region.full(margin)
            region = Region.around(mask, volume, reach)
            box = tuple(slice(a, a + n) for a, n in zip(region.low, region.shape, strict=True))
            margin = np.zeros(region.shape, bool) if before is None else before[box].copy()
            distances = np.full(region.shape, np.nan)
        union = region.solid | margin.view(np.uint8)
        estimate = overall_damage_risk(region, union, transforms, shell_only=True)
        shell = shell_of(union)
        share = transfer_share(estimate.risk, acceptable_risk, settings.initial_transfer, decay_start)
        rows.append((int(margin.sum()), int(shell.sum()), estimate.risk, share))
        if estimate.risk <= acceptable_risk:
            break
        fresh = np.argwhere(shell & np.isnan(distances))
        if len(fresh):
            distances[tuple(fresh.T)] = _all_distances(region, fresh, metric, known)
        flat = np.flatnonzero(shell)
        order = in_order(distances.reshape(-1)[flat], flat)
        count = min(len(flat), max(settings.least_transfer, int(share * len(flat))))
        chosen = flat[order[:count]]
        known = max(known, float(distances.reshape(-1)[chosen].max()))
        margin.reshape(-1)[chosen] = True
    else:
        raise MarginError(
            f"growth stalled: expected an overall damage risk of at most {acceptable_risk} within "
            f"{settings.most_steps} steps, got {rows[-1][2]:.4g} with {rows[-1][0]} voxels in the margin"
        )
    history = pd.DataFrame(rows, columns=["margin_voxels", "shell_voxels", "risk", "transfer_share"])
    return Growth(region, margin, estimate, history, known)


def _all_distances(
    region: Region, voxels: np.ndarray, metric: DisplacementMoments, known: float
) -> np.ndarray:
    """Distances of voxels, however large; `known` is where to begin looking."""
    out = np.full(len(voxels), np.inf)
    cut = 1.5 * known or 4.0
    while (far := np.flatnonzero(np.isinf(out))).size:
        out[far] = smallest_distances(region, np.ascontiguousarray(voxels[far]), metric, cut)
        cut *= 2
    return out
