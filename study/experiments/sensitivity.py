"""What a plan hangs on: the same bone under other settings, and when the bone near a structure goes."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from scipy import ndimage
from tqdm.auto import tqdm

from study.collision import Drill
from study.errors import InputError, PlanningError
from study.planners import Plan, PlannerSettings, plan_path
from study.volumes import LabelVolume

#: Settings that the text leaves open, by name: what differs from the defaults (see `vary`).
OPEN_SETTINGS: dict[str, dict[str, Any]] = {
    "defaults": {},
    "window 10°, overlap 2°": {"min_window_deg": 10.0},
    "window 5°, overlap 5°": {"min_overlap_deg": 5.0},
    "window 10°, overlap 10°": {"min_window_deg": 10.0, "min_overlap_deg": 10.0},
    "tilt up to 30°": {"max_tilt_deg": 30.0},
    "boundary 26-connected": {"boundary_connectivity": 26},
    "another seed": {"seed": 1},
}

#: Pitches of the zigzag in voxels, rows and layers.
ZIGZAG_PITCHES: dict[str, dict[str, Any]] = {
    f"zigzag, pitch {n}/{n}": {"strategy": "zigzag", "row_pitch": n, "layer_pitch": n} for n in (2, 3, 4, 5)
}


def vary(
    volume: LabelVolume,
    variants: Mapping[str, Mapping[str, Any]],
    *,
    drill: Drill | None = None,
    settings: PlannerSettings | None = None,
    **arguments,
) -> pd.DataFrame:
    """Plan a volume once a variant.

    Parameters
    ----------
    volume : LabelVolume
    variants : mapping of str to mapping
        For each name the fields of `PlannerSettings` that differ; ``strategy``, ``dof`` and
        ``approach`` go to `plan_path`.
    drill : Drill, optional
    settings : PlannerSettings, optional
        What the variants start from.
    **arguments
        To `plan_path`, where a variant does not say otherwise.

    Returns
    -------
    pandas.DataFrame
        `Plan.summary` and ``voxels_left`` of every variant, ``length_over_first_ratio`` against the
        first. A variant that cannot be planned has NaN and says why under ``failed``.
    """
    settings = PlannerSettings() if settings is None else settings
    rows = {}
    for name, changes in tqdm(variants.items(), disable=bool(os.environ.get("STUDY_BATCH"))):
        own = {key: value for key, value in changes.items() if key in ("strategy", "dof", "approach")}
        fields = {key: value for key, value in changes.items() if key not in own}
        try:
            plan = plan_path(
                volume, drill=drill, settings=replace(settings, **fields), **{**arguments, **own}
            )
        except PlanningError as error:
            rows[name] = {"failed": str(error)}
            continue
        rows[name] = {**plan.summary(), "voxels_left": int(np.count_nonzero(plan.left))}
    table = pd.DataFrame.from_dict(rows, orient="index").rename_axis("variant")
    if "predicted_path_length_mm" in table:
        lengths = table["predicted_path_length_mm"]
        table["length_over_first_ratio"] = lengths / lengths.iloc[0]
    return table


def removal_order_near(plan: Plan, structure: np.ndarray, share: float = 0.1) -> float:
    """How late the bone nearest to a structure goes, 0 (first thing) to 1 (last thing).

    Parameters
    ----------
    plan : Plan
        With its volume.
    structure : (nx, ny, nz) bool array
    share : float
        How much of the removed bone counts as nearest, by the distance from the burr's centre on its
        removal to the structure.

    Returns
    -------
    float
        Mean share of all bone that was removed before it; 0.5 for bone removed in any order.

    Raises
    ------
    InputError
        If the structure has no voxel or another shape, `share` is not above 0 and at most 1, or the
        plan removes nothing.
    """
    volume = plan.volume
    if structure.shape != volume.shape or not structure.any():
        raise InputError(
            f"structure: expected a mask of shape {volume.shape} with a voxel set, got {structure.shape}"
        )
    if not 0 < share <= 1:
        raise InputError(f"share: expected more than 0 and at most 1, got {share}")
    total = plan.removed.sum()
    if total <= 0:
        raise InputError("expected a plan that removes bone, got one that removes none")
    distance = ndimage.distance_transform_edt(~structure, sampling=volume.spacing)
    where = np.rint(volume.indices(plan.points)).astype(int)
    away = distance[tuple(where.T)]
    order = np.argsort(away, kind="stable")
    bone = np.cumsum(plan.removed[order])
    last = int(np.searchsorted(bone, share * total * (1 - 1e-12)))
    near = away <= away[order[last]]
    middle = np.cumsum(plan.removed) - plan.removed / 2
    return float(np.average(middle[near] / total, weights=plan.removed[near]))
