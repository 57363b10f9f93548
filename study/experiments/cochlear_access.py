"""Where the three works meet on one bone: a hole to the cochlea, the robots' errors, a safety margin.

Robots are those of Baron, drilled anew by simulation along the very hole that is planned; margins those of
Siebold's chapter 3, grown from the same errors.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import pandas as pd

from study.cases import Case, load_case
from study.errors import InputError, StudyError, TargetUnreachableError
from study.guidance import SYSTEMS, Repeated, system, tip_errors
from study.guidance.access import (
    AccessPlan,
    AccessSettings,
    AnyRoll,
    FittedErrors,
    LineErrorModel,
    LineErrors,
    NormalErrors,
    collision_probability,
    drill_axes,
    plan_access,
    printed_absolute,
    printed_lateral,
    required_std,
    rms_across,
    structure_points,
    to_drill_axes,
)
from study.guidance.access.collision import distances_from_line, moments, normal_probabilities
from study.margins import GrowthSettings, grow_margin
from study.specimens import catalogue, structure_mask
from study.tables import Claim
from study.volumes import LabelVolume

#: Structures that the nerves' risks are told of, in the order of their weight.
NERVES = ("facial_nerve", "chorda_tympani")

#: Holes that one process has drilled before another one has started.
_ONE_PROCESS = 300
#: mm: what is farther from the planned drill asks nothing of a robot that the nerves do not.
_NEAR = 2.0
#: Bootstrap sets of holes.
_RESAMPLED = 400


def anatomy_case(what: str) -> Case:
    """A bone with labelled anatomy and fiducials: a specimen, a file or a folder.

    Raises
    ------
    InputError
        If it holds a planning volume only.
    """
    case = load_case(what)
    if case.anatomy is None or case.fiducials is None:
        raise InputError(f"{what}: expected a bone with labelled anatomy, got a planning volume only")
    return case


def simulated_holes(plan: AccessPlan, fiducials: np.ndarray, count: int, seed: int) -> dict[str, Repeated]:
    """The planned hole drilled by both systems, calibrated and registered anew each time; image axes."""
    workers = 1 if count <= _ONE_PROCESS else None
    line = (fiducials, plan.entry, plan.target)
    return {name: tip_errors(system(name), count, *line, seed, workers=workers) for name in SYSTEMS}


def error_models(plan: AccessPlan, holes: Mapping[str, Repeated]) -> dict[str, LineErrorModel]:
    """Errors of the simulated systems, then those that the paper prints, under the names that tables use.

    The printed ones say nothing of how the robot stood about the drill: theirs is any.
    """
    models: dict[str, LineErrorModel] = {
        f"simulated {name.capitalize()}": FittedErrors.of(
            to_drill_axes(found.values, plan.entry, plan.target)
        )
        for name, found in holes.items()
    }
    models |= {f"printed lateral {name.capitalize()}": AnyRoll(printed_lateral(name)) for name in SYSTEMS}
    models["printed absolute"] = printed_absolute()
    return models


def error_rows(plans: Mapping[str, AccessPlan], holes: Mapping[str, Repeated]) -> pd.DataFrame:
    """One row an error: its size on the line, simulated holes, the nerves' risks, what else is expected."""
    rows = []
    for name, plan in plans.items():
        entry, target = rms_across(plan.risks.errors, plan.direction)
        row = {"errors": name, "entry_rms_mm": entry, "target_rms_mm": target}
        for structure in NERVES:
            if structure in plan.risks.names:
                estimate = plan.risks.risk(structure)
                low, high = estimate.interval
                row |= {
                    f"{structure}_probability": estimate.risk,
                    f"{structure}_low": low,
                    f"{structure}_high": high,
                }
        others = [k for k, s in enumerate(plan.risks.names) if s not in NERVES]
        row["any_other_probability"] = float((plan.risks.clearances[:, others] <= 0).any(axis=1).mean())
        row["target_reached"] = plan.reached.risk
        row["expected_damage"] = plan.expected_damage
        row["too_probable"] = ", ".join(plan.too_probable) or "none"
        found = holes.get(name.removeprefix("simulated ").lower())
        if found:
            low, high = fitted_range(plan, to_drill_axes(found.values, plan.entry, plan.target))
            row |= {"facial_nerve_fit_low": low, "facial_nerve_fit_high": high}
        row["simulated_holes"] = len(found.values) if found else 0
        row["stopped_by_the_robot"] = len(found.aborted) if found else 0
        rows.append(row)
    return pd.DataFrame(rows).set_index("errors")


def fitted_range(
    plan: AccessPlan, errors: np.ndarray, structure: str = "facial_nerve"
) -> tuple[float, float]:
    """95 % of the probabilities that other sets of as many simulated holes would have led to.

    By the bootstrap over holes, each set's probability by normal theory.

    Parameters
    ----------
    plan : AccessPlan
    errors : (n, 2, 3) array
        mm at entry and target of the simulated holes, axes of the drill.
    structure : str
    """
    rng = np.random.default_rng(0)
    voxels = plan.around.keep[structure]
    nearest = voxels[np.argmin(distances_from_line(voxels, plan.entry, plan.target))]
    surface = plan.settings.drill_radius + plan.risks.voxel_reach
    axes = drill_axes(plan.entry, plan.target)[None]
    found = [
        normal_probabilities(
            nearest[None, None],
            plan.entry[None],
            plan.target,
            *moments(errors[rng.integers(len(errors), size=len(errors))]),
            surface,
            axes,
        ).item()
        for _ in range(_RESAMPLED)
    ]
    low, high = np.percentile(found, [2.5, 97.5])
    return float(low), float(high)


def robot_points(rows: pd.DataFrame) -> pd.DataFrame:
    """The nerves' risks of `error_rows`, one row an error and structure, as a figure wants them."""
    return pd.DataFrame(
        [
            {
                "robot": name,
                "structure": structure,
                "target_std_mm": row["target_rms_mm"],
                "probability": row[f"{structure}_probability"],
                "low": row[f"{structure}_low"],
                "high": row[f"{structure}_high"],
            }
            for name, row in rows.iterrows()
            for structure in NERVES
            if f"{structure}_probability" in rows
        ]
    )


def required_rows(plan: AccessPlan, diameters: Iterable[float] = ()) -> pd.DataFrame:
    """How accurate a robot has to be for each structure within 2 mm, the most demanding first.

    Parameters
    ----------
    plan : AccessPlan
    diameters : iterable of float
        mm, of other drills on the same line; 0 where they touch the structure even without an error.
    """
    near = plan.clearances[(plan.clearances > 0) & (plan.clearances <= _NEAR)]
    others = {mm: plan.with_drill(mm) for mm in diameters if mm != plan.settings.drill_diameter}
    rows = []
    for structure in near.index:
        accepted = plan.around.acceptable[structure]
        found = required_std(plan, structure, accepted)
        row = {
            "structure": structure,
            "accepted": accepted,
            "planned_clearance_mm": plan.clearances[structure],
            "needed_target_rms_mm": found.target_std,
            "probability_there": found.estimate.risk,
        }
        for mm, other in others.items():
            row[f"needed_with_{mm:g}_mm"] = required_std(other, structure, accepted).target_std
        rows.append(row)
    return pd.DataFrame(rows).set_index("structure").sort_values("needed_target_rms_mm")


def convention_rows(plan: AccessPlan, finer: LabelVolume) -> pd.DataFrame:
    """The nerves' clearances and risks by what counts as touched.

    Parameters
    ----------
    plan : AccessPlan
    finer : LabelVolume
        The same anatomy on smaller voxels.

    Returns
    -------
    pandas.DataFrame
        Voxels touched at their centres, the finer ones' centres, and the plan's whole voxels.
    """
    half = float(np.linalg.norm(plan.anatomy.spacing) / 2)
    mm = f"{plan.anatomy.spacing.mean():.2g} mm"
    conventions = (
        (f"centres, {mm}", plan.around.keep, 0.0),
        (f"centres, {finer.spacing.mean():.2g} mm", structure_points(finer, *NERVES), 0.0),
        (f"whole voxels, {mm}", plan.around.keep, half),
    )
    rows = []
    for voxels, points, reach in conventions:
        near = {name: points[name] for name in NERVES if name in points}
        line = (plan.entry, plan.target, plan.risks.errors, plan.settings.drill_radius)
        found = collision_probability(near, *line, reach).table()
        found.insert(0, "voxels", voxels)
        rows.append(found[["voxels", "planned_clearance_mm", "probability", "low", "high"]])
    return pd.concat(rows).sort_index(kind="stable", ascending=False)


def margin_rows(
    plans: Mapping[str, AccessPlan],
    anatomy: LabelVolume,
    settings: GrowthSettings,
    rng: int = 0,
    structure: str = "facial_nerve",
) -> pd.DataFrame:
    """A safety margin from each plan's errors, and whether the planned drill stays out of it.

    Parameters
    ----------
    plans : mapping of str to AccessPlan
    anatomy : LabelVolume
        Of the same bone; smaller voxels make thinner margins, see `study.experiments.margin_survey`.
    settings : GrowthSettings
    rng : int
    structure : str
        Under any of its names.
    """
    mask, rows = structure_mask(anatomy, structure), []
    for name, plan in plans.items():
        source = LineErrors(plan.model, plan.entry, plan.target)
        accepted = plan.around.acceptable[structure]
        row = {"errors": name, "accepted": accepted}
        try:
            margin = grow_margin(anatomy, mask, source, accepted, settings=settings, rng=rng, name=structure)
        except StudyError as failed:
            rows.append({**row, "margin": str(failed)})
            continue
        voxels = anatomy.points(np.argwhere(margin.mask))
        nearest = distances_from_line(voxels, plan.entry, plan.target).min()
        low, high = margin.validation.interval
        rows.append(
            {
                **row,
                "margin": "grown",
                "margin_mm3": margin.volume_mm3,
                "risk_if_all_around_were_milled": margin.validation.risk,
                "low": low,
                "high": high,
                "drill_clearance_from_margin_mm": nearest - plan.settings.drill_radius,
                "drill_stays_out": bool(nearest > plan.settings.drill_radius),
                "drill_touches_nerve": plan.risks.risk(structure).risk,
                "time_s": margin.time_s,
            }
        )
    return pd.DataFrame(rows).set_index("errors")


def bone_rows(names: Iterable[str], settings: AccessSettings, std: float, rng: int = 0) -> pd.DataFrame:
    """Other bones: is there a way, how wide is it, how deep, how accurate would a robot have to be.

    Parameters
    ----------
    names : iterable of str
        As for `anatomy_case`.
    settings : AccessSettings
    std : float
        mm per axis at entry and target, for which each line is chosen.
    rng : int
    """
    rows = []
    for name in names:
        case, model = anatomy_case(name), NormalErrors(std, std)
        try:
            plan = plan_access(case.anatomy, settings=settings, errors=model, rng=rng, side=case.side)
        except TargetUnreachableError as blocked:
            rows.append({"bone": name, "way": "none", "why": str(blocked)})
            continue
        row = {
            "bone": name,
            "way": "acceptable" if plan.acceptable else "free",
            "recess_width_mm": plan.recess_width,
            "length_mm": plan.length_mm,
            "why": ", ".join(plan.too_probable),
        }
        for structure in NERVES:
            if structure in plan.risks.names:
                found = required_std(plan, structure, plan.around.acceptable[structure])
                row |= {
                    f"{structure}_clearance_mm": plan.clearances[structure],
                    f"{structure}_needs_mm": found.target_std,
                }
        rows.append(row)
    return pd.DataFrame(rows, columns=None if rows else ["bone", "way"]).set_index("bone")


def bones_of(text: str) -> list[str]:
    """Names from a notebook's parameter: ``"all"`` of the catalogue, or some, or none, between blanks."""
    return list(catalogue()) if text.strip() == "all" else text.split()


def access_claims(plans: Mapping[str, AccessPlan], margins: pd.DataFrame, bones: pd.DataFrame) -> list[Claim]:
    """What the paper says of the way to the cochlea (2.1, 7), and what margins promise, on these bones."""
    plan = next(iter(plans.values()))
    found = bones.dropna(subset=["recess_width_mm"]) if "recess_width_mm" in bones else bones.iloc[:0]
    widths = np.append(found.get("recess_width_mm", []), plan.recess_width).astype(float)
    lengths = np.append(found.get("length_mm", []), plan.length_mm).astype(float)
    nerve = plans["printed absolute"].risks.risk("facial_nerve")
    accepted = plan.around.acceptable["facial_nerve"]
    out = (
        margins[margins["drill_stays_out"].fillna(False).astype(bool)]
        if "drill_stays_out" in margins
        else margins.iloc[:0]
    )
    return [
        Claim(
            "about 2 mm lie between the two nerves (2.1)",
            1.5 <= np.median(widths) < 2.5,
            f"median {np.median(widths):.2f} mm of {len(widths)}, {widths.min():.2f} to {widths.max():.2f}",
            "measured",
        ),
        Claim(
            "the cochlea lies about 35 mm deep (2.1)",
            30 <= np.median(lengths) < 40,
            f"median {np.median(lengths):.1f} mm of drilling ({lengths.min():.1f} to {lengths.max():.1f})",
            "measured",
        ),
        Claim(
            "the printed absolute accuracy is not enough for the cochlea (7)",
            nerve.interval[0] > accepted,
            f"facial nerve touched in {100 * nerve.risk:.2g} %, {100 * accepted:g} % accepted",
            "measured",
        ),
        Claim(
            "a drill planned outside the facial nerve's margin touches it no more often than accepted",
            bool(len(out) and (out["drill_touches_nerve"] <= out["accepted"]).all()),
            f"{len(out)} of {len(margins)} errors leave the drill outside"
            + (f"; most often touched: {100 * out['drill_touches_nerve'].max():.2g} %" if len(out) else ""),
            "measured",
        ),
    ]
