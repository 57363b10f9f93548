"""Growing a safety margin around a structure (Siebold, chapter 3)."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from study.errors import InputError, LabelError
from study.margins.exact import grow_exactly
from study.margins.margin import SafetyMargin
from study.margins.order_statistics import allowed_hits
from study.margins.point_risk import euclidean
from study.margins.published import grow_as_published
from study.margins.region import checked_structure, edge_share
from study.margins.settings import ACCEPTABLE_RISKS, SHAPES, GrowthSettings, checked_share
from study.margins.task import Task
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
) -> SafetyMargin:
    """The tissue around a structure that keeps the overall damage risk acceptable.

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
        (3.3.1), if it is one of the five.
    shape : {"spatially_varying", "constant_thickness"}
        Voxels enter the margin by their point damage risk, or by their distance in mm.
    settings : GrowthSettings, optional
    rng : anything `numpy.random.default_rng` takes
    name : str, optional
        What to call the structure: the label by default. It decides what printed risk and decay apply.

    Returns
    -------
    SafetyMargin

    Raises
    ------
    LabelError
        If the structure is not in the volume.
    InputError
        If it has too few voxels, the risk is not between 0 and 1, there are too few registrations for the
        confidence, or the model cannot be drawn from.
    MarginError
        If the published method stalls.
    """
    begun = time.perf_counter()
    settings = settings or GrowthSettings()
    if shape not in SHAPES:
        raise InputError(f"shape: expected one of {SHAPES}, got {shape!r}")
    mask, name = _mask_of(volume, structure, name)
    if acceptable_risk is None:
        if name not in ACCEPTABLE_RISKS:
            raise InputError(
                f"acceptable_risk: expected a number for {name!r}; there are printed ones for "
                f"{sorted(ACCEPTABLE_RISKS)}"
            )
        acceptable_risk = ACCEPTABLE_RISKS[name]
    checked_share("acceptable_risk", acceptable_risk)
    growing, validating = np.random.default_rng(rng).spawn(2)
    moments = displacement_moments(model)
    metric = moments if shape == "spatially_varying" else euclidean()
    task = Task(
        volume, mask, model, moments, metric, acceptable_risk, settings.decay_start_of(name), settings
    )
    if settings.method == "published":
        grown = grow_as_published(task, growing, validating)
    else:
        allowed = allowed_hits(settings.registrations, acceptable_risk, settings.confidence)
        grown = grow_exactly(task, allowed, growing, validating)
    return SafetyMargin(
        structure=name,
        volume=volume,
        structure_mask=mask,
        model=model,
        acceptable_risk=acceptable_risk,
        shape=shape,
        settings=settings,
        edge_share=edge_share(mask),
        time_s=time.perf_counter() - begun,
        **vars(grown),
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
