"""Where chapters 2 and 3 of Siebold meet: a target, margins around its neighbours, the plan that is left.

A target is planned as it was drawn; margins are grown for what may go wrong between image and patient; the
target is reduced by them and planned anew. What the safety costs is the difference; what it buys is the share
of registrations in which the plan itself would have damaged a structure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from study.cases import Case
from study.errors import InputError
from study.margins import (
    RiskEstimate,
    SafetyMargin,
    reduced_target,
)
from study.planners import Plan, plan_path
from study.planners.modified import modified_volume
from study.registration import CombinedErrors, ErrorSource, ImageError, PointRegistration, RobotError
from study.robots import predict_milling
from study.tables import Claim
from study.volumes import LabelVolume, resampled


@dataclass(frozen=True, eq=False)
class MarginedPlan:
    """A target and its plan, with the margins that reduced it (none for a target as drawn).

    Attributes
    ----------
    name : str
    drawn, planning : LabelVolume
        The target before the margins, and what was planned on.
    plan : Plan
    margins : tuple of SafetyMargin
    taken : dict of str to (nx, ny, nz) bool array
        Target that lies in each margin or its structure, by structure.
    """

    name: str
    drawn: LabelVolume
    planning: LabelVolume
    plan: Plan
    margins: tuple[SafetyMargin, ...]
    taken: dict[str, np.ndarray]

    @property
    def spared(self) -> np.ndarray:
        """(nx, ny, nz) bool array: target that some margin took."""
        return self.drawn.mask("target") & ~self.planning.mask("target")


def error_model(
    fiducials: np.ndarray,
    fle_rms: float = 0.176,
    segmentation_mm: float = 0.0,
    image_scale: float = 0.0,
    robot_mm: float = 0.0,
    robot_deg: float = 0.0,
    compliance_mm_per_n: float = 0.0,
    force_n: float = 0.0,
) -> ErrorSource:
    """Registration, and what else is given: image and robot.

    Parameters
    ----------
    fiducials : (n, 3) array
        mm; their centroid is where image scale and robot orientation err about.
    fle_rms : float
        mm, see `study.registration.PointRegistration`.
    segmentation_mm : float
        Standard deviation along each axis of where a structure was drawn as a whole.
    image_scale : float
        Relative standard deviation of distances along each axis of the image.
    robot_mm, robot_deg : float
        Standard deviations of the robot's position along and its orientation about each axis.
    compliance_mm_per_n, force_n : float
        How far the tool gives way, alike along all axes, and the standard deviation of the cutting force
        along each.

    Returns
    -------
    ErrorSource
        The registration alone if all else is 0.
    """
    registration = PointRegistration(fiducials, fle_rms=fle_rms)
    centre = np.asarray(fiducials, float).mean(axis=0)
    image = ImageError(centre, image_scale, segmentation_mm)
    robot = RobotError(
        centre,
        position_std=robot_mm,
        rotation_std=float(np.deg2rad(robot_deg)),
        compliance=compliance_mm_per_n * np.eye(3),
        force_std=force_n,
    )
    sources: list[ErrorSource] = [registration]
    if image_scale or segmentation_mm:
        sources.insert(0, image)
    if robot_mm or robot_deg or (compliance_mm_per_n and force_n):
        sources.append(robot)
    return CombinedErrors(sources) if len(sources) > 1 else registration


def planned(
    name: str, case: Case, drawn: LabelVolume, margins: Sequence[SafetyMargin] = (), dof: int = 4
) -> MarginedPlan:
    """Reduce a target by margins and plan what is left, with the 3-D planner.

    Parameters
    ----------
    name : str
        What to call it.
    case : Case
        Whose approach is taken.
    drawn : LabelVolume
        The target as drawn.
    margins : sequence of SafetyMargin
    dof : int

    Raises
    ------
    PlanningError
        If the burr finds no room in what is left.
    """
    target = drawn.mask("target")
    # one margin at a time, because what each takes is asked for as well; together they take all of it
    taken = {margin.structure: target & ~reduced_target(drawn, [margin]).mask("target") for margin in margins}
    labels = drawn.labels.copy()
    for mask in taken.values():
        labels[mask] = drawn.names["protected"]
    planning = drawn.with_labels(labels)
    plan = plan_path(planning, "3d", dof, approach=case.approach)
    return MarginedPlan(name, drawn, planning, plan, tuple(margins), taken)


def plan_risk(
    plan: Plan, margin: SafetyMargin, registrations: int = 25_000, rng: object = None
) -> RiskEstimate:
    """How often the bone that one plan mills would damage a structure.

    The overall damage risk of a margin supposes that all around it is milled. A plan mills its target
    only, so its own risk is lower, by as much as the target stays away. What counts is the target that
    the plan removes; air that the burr passes through is not milled.

    Parameters
    ----------
    plan : Plan
        On voxels as large as the margin's or larger by a whole factor.
    margin : SafetyMargin
        Of the structure; its model is drawn from, its mask is not used.
    registrations : int
    rng : anything `numpy.random.default_rng` takes

    Raises
    ------
    InputError
        If the two grids do not fill the same box.
    """
    removed = plan.volume.mask("target") & ~plan.remaining.mask("target")
    milled = plan.volume.with_labels(removed.astype(np.uint8), {"kept": 0, "milled": 1})
    grid = margin.volume
    if milled.shape != grid.shape:
        milled = resampled(milled, grid.spacing, "nearest")
    if milled.shape != grid.shape or not np.allclose(milled.affine, grid.affine, atol=1e-6):
        raise InputError(
            f"plan: expected a volume that fills the box of the margin's, {grid.shape} voxels; got "
            f"{milled.shape} of {milled.spacing.round(3).tolist()} mm"
        )
    kept = ~milled.mask("milled") & ~margin.structure_mask
    return replace(margin, mask=kept).risk_on(registrations, rng)


def plan_row(entry: MarginedPlan) -> dict[str, object]:
    """What one target comes to: volumes, path, time, bone that the burr leaves.

    Returns
    -------
    dict
        ``target``, ``target_cm3``, ``modified_target_cm3`` (where the burr's centre has to go),
        ``milled_cm3`` of the target, ``path_length_mm``, ``milling_time_s``, ``bone_left_mm3``,
        ``planning_time_s``.

    Raises
    ------
    PlanViolation
        If a replay of the plan meets what must stay.
    """
    milling = predict_milling(entry.plan)
    entry.plan.verify()
    before, left = entry.planning.volume_mm3("target"), entry.plan.remaining.volume_mm3("target")
    return {
        "target": entry.name,
        "target_cm3": before / 1000,
        "modified_target_cm3": entry.plan.modified.target_cm3,
        "milled_cm3": (before - left) / 1000,
        "path_length_mm": entry.plan.length_mm,
        "milling_time_s": milling.time_s,
        "bone_left_mm3": left,
        "planning_time_s": entry.plan.planning_time_s,
    }


def cost_rows(entry: MarginedPlan) -> pd.DataFrame:
    """What each margin alone takes from a target.

    Parameters
    ----------
    entry : MarginedPlan
        With margins.

    Returns
    -------
    DataFrame
        Indexed by structure: ``acceptable_risk``, ``margin_mm3`` with ``validated_risk`` on fresh
        registrations, ``target_mm3`` that lies in it or its structure, ``modified_target_mm3`` that the
        burr's centre loses; last the row ``all together``, less than the sum where margins overlap.
    """
    drawn, burr = entry.drawn, entry.plan.drill.burr_radius
    before = modified_volume(drawn, burr).target_cm3

    def lost(mask: np.ndarray) -> dict[str, float]:
        labels = drawn.labels.copy()
        labels[mask] = drawn.names["protected"]
        after = modified_volume(drawn.with_labels(labels), burr).target_cm3
        return {
            "target_mm3": float(np.count_nonzero(mask)) * drawn.voxel_volume,
            "modified_target_mm3": 1000 * (before - after),
        }

    table = {
        margin.structure: {
            "acceptable_risk": margin.acceptable_risk,
            "margin_mm3": margin.volume_mm3,
            "validated_risk": margin.validation.risk if margin.validation else np.nan,
            **lost(entry.taken[margin.structure]),
        }
        for margin in entry.margins
    }
    volume = sum(margin.volume_mm3 for margin in entry.margins)
    table["all together"] = {"margin_mm3": volume, **lost(entry.spared)}
    return pd.DataFrame.from_dict(table, orient="index").rename_axis("structure")


def risk_rows(
    entries: Sequence[MarginedPlan],
    judges: Mapping[str, Sequence[SafetyMargin]],
    registrations: int = 25_000,
    rng: object = None,
) -> pd.DataFrame:
    """Damage risk of every plan for every structure under every error.

    Parameters
    ----------
    entries : sequence of MarginedPlan
    judges : mapping of str to sequence of SafetyMargin
        Name of an error to margins that bring structure and model.
    registrations : int
    rng : anything `numpy.random.default_rng` takes
        The same for every plan.

    Returns
    -------
    DataFrame
        A row an error and structure: ``acceptable_risk``, then a column a plan.
    """
    table = []
    for errors, margins in judges.items():
        for margin in margins:
            row = {"errors": errors, "structure": margin.structure}
            row["acceptable_risk"] = margin.acceptable_risk
            for entry in entries:
                row[entry.name] = plan_risk(entry.plan, margin, registrations, rng).risk
            table.append(row)
    return pd.DataFrame(table).set_index(["errors", "structure"])


def risk_claims(risks: pd.DataFrame) -> list[Claim]:
    """Whether each plan keeps every structure within its tolerance under each set of errors.

    Parameters
    ----------
    risks : DataFrame
        Of `risk_rows`.
    """
    claims = []
    for plan in risks.columns.drop("acceptable_risk"):
        for errors, rows in risks.groupby(level="errors", sort=False):
            over = (rows[plan] / rows["acceptable_risk"]).droplevel("errors")
            above = over[over > 1]
            listed = ", ".join(f"{name.replace('_', ' ')} {share:.2g}" for name, share in above.items())
            claims.append(
                Claim(
                    f"{plan}: no structure's risk is above its tolerance, errors: {errors}",
                    above.empty,
                    f"times the tolerance: {listed}" if listed else f"at most {over.max():.2g} of it",
                    "measured",
                )
            )
    return claims
