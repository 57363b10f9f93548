"""Growing a safety margin around a structure, or into it (Siebold, chapters 3 and 4)."""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence

import numpy as np

from study.errors import InputError, LabelError, PaddedVolumeWarning
from study.margins.exact import grow_exactly
from study.margins.margin import SafetyMargin
from study.margins.order_statistics import allowed_hits
from study.margins.point_risk import euclidean
from study.margins.published import grow_as_published
from study.margins.region import checked_structure, edge_share
from study.margins.removal import grow_to_remove, grow_to_stay_inside
from study.margins.settings import (
    ACCEPTABLE_RISKS,
    PURPOSES,
    REMOVAL_RISK,
    SHAPES,
    GrowthSettings,
    checked_share,
)
from study.margins.task import Task
from study.margins.violations import grow_by_violations
from study.registration.sources import ErrorSource, displacement_moments
from study.volumes import LabelVolume


def grow_margin(
    volume: LabelVolume,
    structure: str | Sequence[str] | np.ndarray,
    model: ErrorSource,
    acceptable_risk: float | None = None,
    shape: str = "spatially_varying",
    settings: GrowthSettings | None = None,
    rng: object = None,
    name: str | None = None,
    purpose: str = "protect",
) -> SafetyMargin:
    """The tissue around a structure that keeps the overall damage risk acceptable.

    To protect a structure, what is outside structure and margin may be milled (chapter 3). To remove one,
    such as a tumour, all that appears inside structure and margin is taken out, and damage is to leave a part
    of the structure behind (chapter 4). Where errors are rigid both ask for the same tissue; they differ in
    how voxels are counted (`study.margins.overall_risk`, `study.margins.protrusion`). To stay inside, the
    margin is a rim of the structure itself, and what it leaves is a region of which every voxel lands in the
    structure (5.2).

    Parameters
    ----------
    volume : LabelVolume
    structure : str, sequence of str or (nx, ny, nz) bool array
        One label, several that are one structure together, or a mask. A part with a label of its own, such
        as a nerve inside a canal, is tissue that may be milled unless its label is given too.
    model : ErrorSource
        What moves the patient against the plan, such as `study.registration.PointRegistration`.
    acceptable_risk : float, optional
        Overall damage risk that is accepted; between 0 and 1. The printed one of the structure by default
        (3.3.1), if it is one of the five; 0.01 to remove (4.3.1).
    shape : {"spatially_varying", "constant_thickness"}
        Voxels enter the margin by their point damage risk, or by their distance in mm.
    settings : GrowthSettings, optional
        `GrowthSettings()` by default to protect, else `GrowthSettings.for_removal()`.
    rng : anything `numpy.random.default_rng` takes
    name : str, optional
        What to call the structure: the label by default. It decides what printed risk and decay apply.
    purpose : {"protect", "remove", "stay_inside"}

    Returns
    -------
    SafetyMargin

    Warns
    -----
    PaddedVolumeWarning
        If a margin to be removed leaves the volume, which is padded then: the margin's own ``volume`` is
        larger.

    Raises
    ------
    LabelError
        If the structure is not in the volume.
    InputError
        If it has too few voxels, the risk is not between 0 and 1, there are too few registrations for the
        confidence, or the model cannot be drawn from.
    MarginError
        If the published method stalls, or nothing is left to stay inside of.
    GeometryError
        If a margin to be removed would be larger than what can be looked at.
    """
    begun = time.perf_counter()
    for what, value, known in (("shape", shape, SHAPES), ("purpose", purpose, PURPOSES)):
        if value not in known:
            raise InputError(f"{what}: expected one of {known}, got {value!r}")
    if settings is None:
        settings = GrowthSettings() if purpose == "protect" else GrowthSettings.for_removal()
    if purpose == "stay_inside" and settings.method != "exact":
        raise InputError(f'settings: expected method "exact" to stay inside, got {settings.method!r}')
    mask, name = _mask_of(volume, structure, name)
    if acceptable_risk is None and purpose == "remove":
        acceptable_risk = REMOVAL_RISK
    if acceptable_risk is None:
        if name not in ACCEPTABLE_RISKS:
            raise InputError(
                f"acceptable_risk: expected a number for {name!r}; there are printed ones for "
                f"{sorted(ACCEPTABLE_RISKS)}"
            )
        acceptable_risk = ACCEPTABLE_RISKS[name]
    checked_share("acceptable_risk", acceptable_risk)
    growing, validating, ranks_from = np.random.default_rng(rng).spawn(3)
    moments = metric = None
    if purpose == "protect":
        moments = displacement_moments(model)
        metric = moments if shape == "spatially_varying" else euclidean()
    task = Task(
        volume,
        mask,
        model,
        moments,
        metric,
        acceptable_risk,
        settings.decay_start_of(name),
        settings,
        shape,
        purpose,
    )
    if settings.method == "published":
        grow = grow_as_published if purpose == "protect" else grow_by_violations
        grown = grow(task, growing, validating)
    else:
        allowed = allowed_hits(settings.registrations, acceptable_risk, settings.confidence)
        if purpose == "protect":
            grown = grow_exactly(task, allowed, growing, validating)
        else:
            grow = grow_to_remove if purpose == "remove" else grow_to_stay_inside
            grown = grow(task, allowed, growing, validating, ranks_from)
    found = vars(grown)
    if grown.volume is None:
        found |= {"volume": volume, "structure_mask": mask}
    elif grown.volume is not volume:
        _warn_of_padding(volume, grown.volume, name)
    return SafetyMargin(
        structure=name,
        model=model,
        acceptable_risk=acceptable_risk,
        shape=shape,
        purpose=purpose,
        settings=settings,
        edge_share=edge_share(mask),
        time_s=time.perf_counter() - begun,
        **found,
    )


def _warn_of_padding(given: LabelVolume, padded: LabelVolume, name: str) -> None:
    low = np.rint(padded.indices(given.points(np.zeros((1, 3))))[0]).astype(int)
    high = np.array(padded.shape) - given.shape - low
    warnings.warn(
        f"{name}: the margin leaves the volume, which was padded by {low.tolist()} voxels below and "
        f"{high.tolist()} above (i, j, k; {given.spacing.round(3).tolist()} mm); the margin's own volume is "
        f"{padded.shape} instead of {given.shape}",
        PaddedVolumeWarning,
        stacklevel=3,
    )


def _mask_of(
    volume: LabelVolume, structure: str | Sequence[str] | np.ndarray, name: str | None
) -> tuple[np.ndarray, str]:
    if isinstance(structure, np.ndarray) and structure.dtype != object and structure.dtype.kind not in "US":
        name = name or "structure"
        return checked_structure(structure, name, volume), name
    names = (structure,) if isinstance(structure, str) else tuple(structure)
    name = name or " + ".join(names)
    mask = volume.mask(*names)
    if not mask.any():
        raise LabelError(f"{name}: expected a structure of the volume, got no voxel of it")
    return checked_structure(mask, name, volume), name
