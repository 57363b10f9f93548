"""All margins of one bone: what chapter 3 of Siebold is read along with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from study.cases import Case
from study.errors import InputError, LabelError
from study.margins import ACCEPTABLE_RISKS, GrowthSettings, SafetyMargin, grow_margin
from study.margins.region import LEAST_VOXELS
from study.registration import ErrorSource
from study.specimens import structure_mask
from study.volumes import LabelVolume, resampled

#: Points of a structure of which a mean is taken.
_ENOUGH = 20_000
#: Share by which voxels may miss the size asked for and still be taken as they are.
_SAME_SIZE = 0.1


def at_voxel_size(volume: LabelVolume, mm: float) -> LabelVolume:
    """The volume on voxels of a size: as it is if its own are within a tenth, else resampled.

    To smaller voxels by `study.volumes.resampled` with "smooth" (upsampling, 3.3.1), to larger ones with
    "majority".
    """
    ratio = volume.spacing / mm
    if (np.abs(ratio - 1) <= _SAME_SIZE).all():
        return volume
    return resampled(volume, mm, "smooth" if ratio.max() > 1 else "majority")


def reason_to_skip(case: Case, structure: str) -> str:
    """Why a structure of a bone gets no margin, or ``""``; decided on the bone as it was scanned."""
    if case.anatomy is None:
        return "no labelled anatomy"
    try:
        voxels = int(np.count_nonzero(structure_mask(case.anatomy, structure)))
    except LabelError as error:
        return f"absent: {error}"
    if voxels < LEAST_VOXELS:
        return f"too small: {voxels} voxels of the scan, {LEAST_VOXELS} are the least"
    return ""


def grow_margins(
    case: Case,
    volume: LabelVolume,
    model: ErrorSource,
    settings: GrowthSettings | None = None,
    rng: object = None,
    structures: Sequence[str] = tuple(ACCEPTABLE_RISKS),
) -> tuple[list[SafetyMargin], dict[str, str]]:
    """Spatially varying margins of the structures that a bone has.

    Parameters
    ----------
    case : Case
        Whether a structure is there, and large enough, is decided on its anatomy as scanned.
    volume : LabelVolume
        The anatomy, at the voxel size at which margins are grown; see `at_voxel_size`.
    model : ErrorSource
    settings : GrowthSettings, optional
    rng : anything `numpy.random.default_rng` takes
        A seed is the same for every structure.
    structures : sequence of str
        Keys of `study.margins.ACCEPTABLE_RISKS`.

    Returns
    -------
    list of SafetyMargin
    dict of str to str
        Structures that got no margin, and why.

    Raises
    ------
    InputError
        If none of the structures is in the case.
    """
    reasons = {structure: reason_to_skip(case, structure) for structure in structures}
    skipped = {structure: reason for structure, reason in reasons.items() if reason}
    if len(skipped) == len(reasons):
        raise InputError(f"{case.name}: expected one of {list(structures)} at least, got none: {skipped}")
    margins = [
        grow_margin(volume, structure_mask(volume, name), model, settings=settings, rng=rng, name=name)
        for name in structures
        if name not in skipped
    ]
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
