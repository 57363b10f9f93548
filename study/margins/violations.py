"""The printed growth of a margin to be removed, step by step (Siebold, 4.2.2 to 4.2.5).

Registrations are drawn once and kept. Each step measures the overall damage risk, the share of them in which
the structure protrudes. While it is above the tolerance, voxels outside structure and margin are ranked by
how many registrations put a point of the structure's boundary into them, and the worst are transferred; a
morphological closing takes along what they enclose. The registrations on which growth stops are also those of
which violations are counted, so that the margin is fitted to them: its true risk is larger than it says.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from study.errors import MarginError
from study.margins.coverage import millimetres_to
from study.margins.overall_risk import RiskEstimate
from study.margins.protrusion import (
    counted_violations,
    farthest_moved,
    largest_protrusions,
    protrusion_risk,
)
from study.margins.published import shell_of, transfer_share
from study.margins.region import Region
from study.margins.room import room_for, with_room, without_room
from study.margins.settings import GrowthSettings
from study.margins.task import Grown, Task
from study.registration.sources import checked_transforms

#: Registrations that move the structure by more than all but this share of them get no room of their own:
#: what lands outside the region protrudes anyway.
_LOST = 1e-3


class Violations:
    """Batches of registrations, of which violations are counted; the first are those growth stops on."""

    def __init__(self, task: Task, transforms: np.ndarray, rng: np.random.Generator) -> None:
        self.task, self.rng = task, rng
        self.size = task.settings.violation_registrations
        self.drawn = transforms

    def batch(self, index: int) -> np.ndarray:
        """(N_p, 4, 4) transforms."""
        while len(self.drawn) < (index + 1) * self.size:
            self.drawn = np.concatenate(
                [self.drawn, checked_transforms(self.task.model, self.size, self.rng)]
            )
        return self.drawn[index * self.size : (index + 1) * self.size]

    def counted(self, region: Region, union: np.ndarray, wanted: int) -> tuple[np.ndarray, int]:
        """Violations of each voxel, and of how many registrations they were counted."""
        settings = self.task.settings
        counts = np.zeros(region.shape, np.int32)
        for index in range(settings.most_batches):
            counts += counted_violations(region, union, self.batch(index))
            if np.count_nonzero(counts) > settings.violation_ratio * wanted:
                break
        return counts, (index + 1) * self.size


def grow_by_violations(task: Task, growing: np.random.Generator, validating: np.random.Generator) -> Grown:
    """Grow a margin to be removed until the overall damage risk is acceptable, as printed.

    Parameters
    ----------
    task : Task
    growing, validating : Generator
        For the registrations that are kept, and for fresh ones.

    Raises
    ------
    MarginError
        If no voxel that may be transferred is left while the risk is too large, or steps run out.
    GeometryError
        If the registrations scatter so far that the margin would be larger than what can be looked at.
    """
    settings = task.settings
    transforms = task.registrations(growing)
    reach = reach_of_most(task, transforms)
    volume, mask, added = with_room(task.volume, task.mask, reach)
    region = Region.around(mask, volume, reach)
    by_distance = task.shape == "constant_thickness"
    distances = millimetres_to(region.solid == 1, region.affine).reshape(-1) if by_distance else None
    violations, harmful = Violations(task, transforms, growing), transforms
    union, rows, farthest = region.solid.copy(), [], 0.0
    for _ in range(settings.most_steps):
        # What no longer protrudes never will again: the union only grows.
        outside = (union == 0).astype(np.int32)
        harmful = harmful[largest_protrusions(region, outside, harmful, first_only=True) > 0]
        estimate = RiskEstimate(len(harmful), len(transforms))
        shell = shell_of(union)
        share = transfer_share(
            estimate.risk, task.acceptable_risk, settings.initial_transfer, task.decay_start
        )
        count = max(settings.least_transfer, int(share * np.count_nonzero(shell)))
        row = {
            "margin_voxels": int(np.count_nonzero(union) - np.count_nonzero(region.solid)),
            "shell_voxels": int(np.count_nonzero(shell)),
            "risk": estimate.risk,
            "transfer_share": share,
            "transferred": 0,
            "violated_voxels": 0,
            "counted_registrations": 0,
        }
        rows.append(row)
        if estimate.risk <= task.acceptable_risk:
            break
        if by_distance:
            candidates, worth = np.flatnonzero(shell), -distances
        else:
            counts, row["counted_registrations"] = violations.counted(region, union, count)
            candidates, worth = np.flatnonzero(counts >= settings.least_violations), counts.reshape(-1)
            row["violated_voxels"] = int(np.count_nonzero(counts))
        if not len(candidates):
            raise MarginError(_stalled(rows, settings, task.acceptable_risk))
        order = np.lexsort((candidates, -worth[candidates]))
        chosen = candidates[order[:count]]
        if by_distance:
            farthest = max(farthest, float(distances[chosen].max()))
        before = np.count_nonzero(union)
        union.reshape(-1)[chosen] = 1
        union |= closed(union)
        row["transferred"] = int(np.count_nonzero(union) - before)
    else:
        raise MarginError(_stalled(rows, settings, task.acceptable_risk))
    margin = region.full((union == 1) & (region.solid == 0))
    fresh = task.fresh_registrations(validating)
    validation = protrusion_risk(region, union, fresh) if len(fresh) else None
    if margin.sum() == without_room(margin, added).sum():
        volume, mask, margin = task.volume, task.mask, without_room(margin, added)
    return Grown(
        mask=margin,
        estimate=estimate,
        validation=validation,
        distance=farthest if by_distance else float("nan"),
        history=pd.DataFrame(rows),
        volume=volume,
        structure_mask=mask,
    )


def closed(union: np.ndarray) -> np.ndarray:
    """Morphological closing by a cube of three voxels; the edge of the box takes nothing away."""
    return 1 - _dilated(1 - _dilated(np.pad(union, 1)))[1:-1, 1:-1, 1:-1]


def _dilated(solid: np.ndarray) -> np.ndarray:
    """A uint8 array dilated by a cube of three voxels, axis by axis."""
    for axis in range(3):
        wider = solid.copy()
        to, source = np.moveaxis(wider, axis, 0), np.moveaxis(solid, axis, 0)
        to[1:] |= source[:-1]
        to[:-1] |= source[1:]
        solid = wider
    return solid


def reach_of_most(task: Task, transforms: np.ndarray) -> float:
    """How far registrations move the structure, mm, but for the few that are lost."""
    count = len(transforms)
    # Half of those that may do damage; the other half are needed where growth stops.
    most = min(int(task.acceptable_risk * count / 2), count - 1)
    moved, diagonal = farthest_moved(task.volume, task.mask, transforms)
    return room_for(task.volume, task.mask, moved, min(int(_LOST * count), most), most, diagonal)


def _stalled(rows: list[dict], settings: GrowthSettings, acceptable_risk: float) -> str:
    last = rows[-1]
    text = (
        f"growth stalled: expected an overall damage risk of at most {acceptable_risk}, got "
        f"{last['risk']:.4g} with {last['margin_voxels']} voxels in the margin after {len(rows)} "
        f"steps (most_steps: {settings.most_steps})"
    )
    if last["counted_registrations"]:
        text += (
            f"; {last['violated_voxels']} more voxels are violated by any of {last['counted_registrations']} "
            f"registrations, but too few by {settings.least_violations} or more (least_violations)"
        )
    return text
