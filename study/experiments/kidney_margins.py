"""Tables 4.2 and B.1 to B.9 of Siebold: margins around kidney tumours under surface registration.

A row is one margin. Shapes go by the printed letters: SV, spatially varying; CT, constant thickness. What the
printed table cannot show is when the iterative closest point fit was stopped, so every margin is grown at
more than one stopping rule.
"""

from __future__ import annotations

import os
import warnings
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
from tqdm.auto import tqdm

from study.errors import InputError, PaddedVolumeWarning, StudyError
from study.experiments.equal_risk import equal_risk_ratio
from study.experiments.kidney_draws import RememberedRegistrations, scatter_at
from study.margins import REMOVAL_RISK, GrowthSettings, SafetyMargin, grow_margin
from study.paths import PROJECT
from study.registration import SurfaceRegistration
from study.specimens import KidneyCase, kidney_catalogue, load_kidney
from study.volumes import LabelVolume

#: Letters of the printed tables and what `grow_margin` calls the shape.
VARIANTS = {"SV": "spatially_varying", "CT": "constant_thickness"}

#: Standard deviations of the start in appendix B: position in mm, tilt in degrees.
POSITION_STDS = (5.0, 3.33, 2.5)
ROTATION_STDS = (5.0, 3.33, 2.5)

#: Printed table of each pair of them.
TABLES = {pair: f"B.{k}" for k, pair in enumerate(product(POSITION_STDS, ROTATION_STDS), start=1)}


@dataclass(frozen=True)
class Run:
    """When the fit stops, and how the margin grows.

    Attributes
    ----------
    stop : {"loose", "converged"}
        The fit stops as loosely as the text's seems to have, or when it no longer moves.
    method : {"exact", "published"}
        Of `study.margins.GrowthSettings`.
    """

    stop: str
    method: str

    @property
    def title(self) -> str:
        """What tables and pictures call it."""
        growth = {"exact": "exact growth", "published": "printed growth"}[self.method]
        return f"{STOPS[self.stop]}, {growth}"


#: Ways to stop, as tables and pictures call them.
STOPS = {"loose": "loose stop", "converged": "converged"}

#: Runs by the names that the notebooks' parameter takes.
RUNS = {
    "published": Run("loose", "published"),
    "loose": Run("loose", "exact"),
    "converged": Run("converged", "exact"),
}


@dataclass(frozen=True, eq=False)
class KidneyMargins:
    """Margins of several kidneys.

    Attributes
    ----------
    rows : DataFrame
        See `run_kidney_margins`.
    curves : dict
        ``(kidney, run, pos_std_mm, rot_std_deg, variant)`` to `SafetyMargin.curve`.
    """

    rows: pd.DataFrame
    curves: dict[tuple[str, str, float, float, str], pd.DataFrame] = field(repr=False)


def select_kidneys(kidneys: str) -> list[str]:
    """What a notebook's parameter asks for, each of it something `study.specimens.load_kidney` takes.

    Parameters
    ----------
    kidneys : str
        ``"all"``, how many of the catalogue, names of it separated by commas or blanks, a folder of a kidney,
        or one that holds such folders.

    Raises
    ------
    InputError
        If the folder holds no kidney, or a name is none of the catalogue.
    """
    text, names = str(kidneys).strip(), list(kidney_catalogue())
    folder = next((p for p in (Path(text), PROJECT / text) if text and p.is_dir()), None)
    if folder is not None:
        found = [str(f) for f in (folder, *sorted(folder.iterdir())) if f.is_dir() and _holds_labels(f)]
        if not found:
            raise InputError(
                f"{folder}: expected a folder of a segmented kidney, or of several, found no labels"
            )
        return found
    if text == "all":
        return names
    if text.isdigit():
        if not 1 <= int(text) <= len(names):
            raise InputError(f"kidneys: expected 1 to {len(names)} of them, got {text}")
        return names[: int(text)]
    asked = text.replace(",", " ").split()
    unknown = [name for name in asked if name not in names]
    if unknown or not asked:
        raise InputError(
            f"kidneys: expected 'all', a number, a folder, or names of {', '.join(names)}; got {kidneys!r}"
        )
    return [name for name in names if name in asked]


def _holds_labels(folder: Path) -> bool:
    return any(folder.glob("*.nrrd")) or any(folder.glob("*.nii*"))


def registration_of(
    case: KidneyCase, position_std: float, tilt_std_deg: float, stop: str
) -> SurfaceRegistration:
    """The registration of a kidney's swab to its surface.

    Parameters
    ----------
    case : KidneyCase
    position_std, tilt_std_deg : float
        Of the start, mm and degrees.
    stop : {"loose", "converged"}
        As of `Run`.
    """
    make = SurfaceRegistration.published if stop == "loose" else SurfaceRegistration
    return make(case.surface, case.swab, position_std=position_std, tilt_std_deg=tilt_std_deg)


def margin_row(margin: SafetyMargin, volume: LabelVolume) -> dict[str, object]:
    """One margin in the columns of the printed tables, and what else says how good it is.

    Parameters
    ----------
    margin : SafetyMargin
    volume : LabelVolume
        That it was grown in; ``beyond_image`` says whether it needed room beyond.
    """
    values = margin.summary()
    healthy = margin.mask & margin.volume.mask("kidney")
    return {
        "margin_volume_mm3": margin.volume_mm3,
        "final_damage_probability": margin.damage_risk,
        "mahalanobis_mean": values["mahalanobis_mean"],
        "mahalanobis_std": values["mahalanobis_std"],
        "validated_risk": values.get("validation_risk", np.nan),
        "validated_low": values.get("validation_low", np.nan),
        "validated_high": values.get("validation_high", np.nan),
        "healthy_kidney_mm3": np.count_nonzero(healthy) * margin.volume.voxel_volume,
        "tumour_mm3": np.count_nonzero(margin.structure_mask) * margin.volume.voxel_volume,
        "beyond_image": margin.volume is not volume,
    }


def _registration_row(model: RememberedRegistrations, case: KidneyCase) -> dict[str, object]:
    """How the registrations that margins are grown on end and scatter; the same for both shapes."""
    fits = model.fits[0]
    tumour = case.anatomy.points(np.argwhere(case.anatomy.mask("tumour")))
    scatter = scatter_at(np.linalg.inv(fits.transforms), tumour)
    return {
        "converged_pct": 100 * float(fits.converged.mean()),
        "iterations_mean": float(fits.iterations.mean()),
        "scatter_mm": scatter.scatter_mm,
        "bias_mm": scatter.bias_mm,
        "registration_s": model.seconds,
    }


def _margins_of(
    case: KidneyCase,
    position_std: float,
    tilt_std_deg: float,
    settings: Mapping[str, GrowthSettings],
    seed: int,
) -> list[tuple[dict, pd.DataFrame]]:
    """Rows and curves of one kidney and start."""
    rng = [seed, zlib.crc32(case.name.encode())]  # a kidney's own, whichever others are asked for
    models: dict[str, RememberedRegistrations] = {}
    found = []
    for run, (variant, shape) in product(settings, VARIANTS.items()):
        stop = RUNS[run].stop
        if stop not in models:
            registration = registration_of(case, position_std, tilt_std_deg, stop)
            models[stop] = RememberedRegistrations(registration)
        model = models[stop]
        before = model.seconds
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PaddedVolumeWarning)  # the rows say so
            margin = grow_margin(
                case.anatomy, "tumour", model, shape=shape, settings=settings[run], rng=rng, purpose="remove"
            )
        growth = margin.time_s - (model.seconds - before)
        row = {
            "run": run,
            "stop": stop,
            "variant": variant,
            **margin_row(margin, case.anatomy),
            "growth_s": growth,
        }
        found.append((row, margin.curve()))
    for row, _ in found:
        row |= _registration_row(models[row["stop"]], case)
        row["time_min"] = (row["registration_s"] + row["growth_s"]) / 60
    for (sv, of_sv), (ct, of_ct) in zip(found[::2], found[1::2], strict=True):
        compare = (
            RUNS[sv["run"]].method == "exact" and min(sv["margin_volume_mm3"], ct["margin_volume_mm3"]) > 0
        )
        ratio = equal_risk_ratio(of_sv, of_ct, REMOVAL_RISK) if compare else float("nan")
        sv["sv_over_ct_at_equal_risk"] = ct["sv_over_ct_at_equal_risk"] = ratio
    return found


def run_kidney_margins(
    kidneys: Sequence[str],
    position_stds: Iterable[float] = POSITION_STDS,
    rotation_stds: Iterable[float] = ROTATION_STDS,
    runs: Sequence[str] = tuple(RUNS),
    registrations: int = 5000,
    validation_registrations: int = 1000,
    ranking_registrations: int = 1000,
    confidence: float | None = 0.95,
    seed: int = 0,
) -> KidneyMargins:
    """Grow the margins of all combinations.

    Parameters
    ----------
    kidneys : sequence of str
        As of `select_kidneys`. Tumours have the number of their place in the catalogue, others in the
        sequence.
    position_stds, rotation_stds : iterable of float
        Standard deviations of the start of a registration, mm and degrees.
    runs : sequence of str
        Of `RUNS`.
    registrations, validation_registrations : int
        N_r (4.3.1), and fresh ones for the validated risk.
    ranking_registrations : int
        Others on which exact growth ranks voxels; N_p of the printed growth is N_r, as printed. More make
        margins of heavy-tailed registrations smaller by some per cent, and none of them less safe.
    confidence : float or None
        See `study.margins.GrowthSettings`.
    seed : int
        The registrations of a kidney follow from it and the kidney's name: the same random numbers, scaled,
        at all errors, so that errors are compared on the same luck.

    Returns
    -------
    KidneyMargins
        Rows: ``tumour`` (number), ``kidney, table`` (printed, or ""), ``pos_std_mm, rot_std_deg``,
        ``run, stop, variant``; as printed ``margin_volume_mm3, final_damage_probability, mahalanobis_mean,
        mahalanobis_std, time_min``; ``validated_risk, validated_low, validated_high`` on fresh registrations;
        ``healthy_kidney_mm3`` in the margin; ``tumour_mm3``; ``beyond_image``: the margin needed room beyond
        it; ``sv_over_ct_at_equal_risk``, see `study.experiments.equal_risk.equal_risk_ratio`;
        ``converged_pct, iterations_mean`` of the fits; ``scatter_mm, bias_mm`` of the registrations over the
        tumour's voxels; ``registration_s``, spent once for all margins of a start and a way to stop, and
        ``growth_s``; ``time_min`` is their sum.

    Raises
    ------
    InputError
        If there is no kidney, an unknown run, or an error is not positive.
    """
    unknown = sorted(set(runs) - set(RUNS))
    pairs = list(product([float(s) for s in position_stds], [float(s) for s in rotation_stds]))
    if not kidneys or unknown or not runs or not pairs:
        raise InputError(
            f"kidneys, runs, standard deviations: expected at least one of each and runs of {list(RUNS)}, "
            f"got {list(kidneys)}, {unknown or list(runs)}, {pairs}"
        )
    of_run = {
        run: GrowthSettings.for_removal(
            RUNS[run].method,
            registrations=registrations,
            violation_registrations=registrations
            if RUNS[run].method == "published"
            else ranking_registrations,
            validation_registrations=validation_registrations,
            confidence=confidence,
        )
        for run in runs
    }
    rows, curves, catalogue = [], {}, list(kidney_catalogue())
    silent = bool(os.environ.get("STUDY_BATCH"))
    with tqdm(total=len(kidneys) * len(pairs), desc="margins", leave=False, disable=silent) as bar:
        for place, name in enumerate(kidneys, start=1):
            case = load_kidney(name)
            number = 1 + catalogue.index(name) if name in catalogue else place
            for position, rotation in pairs:
                try:
                    found = _margins_of(case, position, rotation, of_run, seed)
                except StudyError as error:  # which of many it was is lost otherwise
                    error.add_note(f"{name}, start with {position:g} mm and {rotation:g} degrees")
                    raise
                start = {"pos_std_mm": position, "rot_std_deg": rotation}
                table = TABLES.get((position, rotation), "")
                for row, curve in found:
                    which = {"tumour": number, "kidney": case.name, "table": table, **start}
                    rows.append(which | row)
                    curves[case.name, row["run"], position, rotation, row["variant"]] = curve
                bar.update()
    return KidneyMargins(pd.DataFrame(rows), curves)
