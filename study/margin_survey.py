"""All margins of one bone: what chapter 3 of Siebold is read along with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from study.cases import Case
from study.errors import InputError
from study.margins import ACCEPTABLE_RISKS, GrowthSettings, SafetyMargin, grow_margin
from study.margins.region import checked_structure
from study.registration import PointRegistration
from study.specimens import structure_mask
from study.volumes import LabelVolume

#: Points of a structure of which a mean is taken.
_ENOUGH = 20_000


def grow_margins(
    case: Case,
    volume: LabelVolume,
    model: PointRegistration,
    settings: GrowthSettings | None = None,
    seed: int = 0,
    structures: Sequence[str] = tuple(ACCEPTABLE_RISKS),
) -> tuple[list[SafetyMargin], dict[str, str]]:
    """Spatially varying margins of the structures that a bone has.

    Parameters
    ----------
    case : Case
        Whether a structure is there, and large enough, is decided on its anatomy as scanned.
    volume : LabelVolume
        The anatomy, at the voxel size at which margins are grown.
    model : PointRegistration
    settings : GrowthSettings, optional
    seed : int
    structures : sequence of str
        Keys of `study.margins.ACCEPTABLE_RISKS`.

    Returns
    -------
    list of SafetyMargin
    dict of str to str
        Structures that got no margin, and why.
    """
    margins, skipped = [], {}
    for name in structures:
        try:
            checked_structure(structure_mask(case.anatomy, name), name, case.anatomy)
            mask = structure_mask(volume, name)
        except InputError as error:  # absent, or a few voxels only
            skipped[name] = str(error)
            continue
        margins.append(grow_margin(volume, mask, model, settings=settings, rng=seed, name=name))
    return margins, skipped


def survey_table(margins: Sequence[SafetyMargin], skipped: dict[str, str]) -> pd.DataFrame:
    """One row a structure: its size, its margin, the margin's risk, and why there is none.

    Parameters
    ----------
    margins : sequence of SafetyMargin
        With validation.
    skipped : dict of str to str

    Returns
    -------
    DataFrame
        Indexed by structure. ``tre_rms_mm`` is the mean over the structure; ``reach_sd`` the largest
        Mahalanobis distance in the margin; ``mahalanobis_mean``, ``mahalanobis_std`` of the final shell;
        ``edge_share`` of the structure's surface is only the edge of the image.
    """
    rows = {}
    for margin in margins:
        summary = margin.summary()
        points = margin.volume.points(np.argwhere(margin.structure_mask))
        rows[margin.structure] = {
            "acceptable_risk": margin.acceptable_risk,
            "structure_voxels": len(points),
            "structure_mm3": len(points) * margin.volume.voxel_volume,
            "margin_voxels": margin.voxels,
            "margin_mm3": margin.volume_mm3,
            "in_sample_risk": margin.damage_risk,
            "validated_risk": summary["validation_risk"],
            "validated_low": summary["validation_low"],
            "validated_high": summary["validation_high"],
            "reach_sd": margin.distance,
            "mahalanobis_mean": summary["mahalanobis_mean"],
            "mahalanobis_std": summary["mahalanobis_std"],
            "tre_rms_mm": float(margin.model.tre_rms(points[:: len(points) // _ENOUGH + 1]).mean()),
            "edge_share": margin.edge_share,
            "time_s": margin.time_s,
            "skipped": "",
        }
    for name, reason in skipped.items():
        rows[name] = {"acceptable_risk": ACCEPTABLE_RISKS[name], "skipped": reason}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("structure")
