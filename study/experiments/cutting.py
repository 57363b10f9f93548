"""How a plan cuts: force on the way, angle of the cut, and when the bone near a structure goes."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import ndimage
from tqdm.auto import tqdm

from study.cases import Case
from study.errors import InputError
from study.planners import (
    CuttingForce,
    IncidenceAngle,
    Plan,
    PlannerSettings,
    leave_for_last,
    plan_path,
)
from study.robots import predict_milling
from study.robots.feed import weighted_removal
from study.tables import Claim, unit_of, with_unit

#: Name of the plan without optional terms.
PRINTED_TERMS = "five printed terms"
#: Cuts with a sine below this, nearer than 30 degrees to the shaft's axis, count as cuts of the pole.
POLE_SINE = 0.5
#: Share by which a term has to change what it is for, to be said to.
LEAST_CHANGE = 0.05
#: Structures that hold no bone.
HOLLOW = ("air", "air_cells", "middle_ear", "external_auditory_canal")


def case_density(case: Case) -> np.ndarray:
    """Relative bone density of a case without a CT: 0 in air cells and other hollows, 1 elsewhere.

    Air cells inside the target are target, because the burr has to pass them, but cost it no force.

    Parameters
    ----------
    case : study.cases.Case

    Returns
    -------
    (nx, ny, nz) array
    """
    density = np.ones(case.planning.shape)
    for volume in (case.planning, case.anatomy):
        for name in HOLLOW if volume is not None else ():
            if name in volume.names:
                density[volume.mask(name)] = 0.0
    return density


def cutting_force(plan: Plan, density: np.ndarray | None = None, window_mm: float = 1.0) -> np.ndarray:
    """Bone removed per mm of path, which the mean cutting force goes with.

    The energy to mill bone goes with its volume and density, and force is energy over way.

    Parameters
    ----------
    plan : Plan
        With its volume.
    density : (nx, ny, nz) array, optional
        Relative density on the grid of the plan's volume; 1 by default.
    window_mm : float
        Length of path, up to each point, over which the mean is taken: single steps are about as long
        as a voxel, and their volumes jump with it.

    Returns
    -------
    (n,) array
        mm^3 of bone of density 1 per mm at each point, that is mm^2 of the burr's section.

    Raises
    ------
    InputError
        If `window_mm` is not above 0, or the density does not fit the volume.
    """
    if not (np.isfinite(window_mm) and window_mm > 0):
        raise InputError(f"window_mm: expected mm above 0, got {window_mm!r}")
    removed = np.array(plan.removed if density is None else weighted_removal(plan, density))
    removed[0] = 0.0  # the start is no step
    way = np.concatenate([[0.0], np.cumsum(plan.step_lengths)])
    moved = np.concatenate([[True], plan.step_lengths > 0])
    bone = np.cumsum(removed)
    return np.maximum(bone - np.interp(way - window_mm, way[moved], bone[moved]), 0.0) / window_mm


def incidence_sine(plan: Plan) -> np.ndarray:
    """Sine of the angle between the shaft and the bone cut on the way to each point.

    1 where the middle of that bone lies at the burr's equator, 0 where it lies at its pole.

    Parameters
    ----------
    plan : Plan
        With its volume.

    Returns
    -------
    (n,) array
        NaN where no bone is removed.
    """
    volume = plan.volume
    count = weighted_removal(plan, np.ones(volume.shape))
    cut = count > 0
    middle = np.full((len(count), 3), np.nan)
    for axis in range(3):
        index = np.arange(volume.shape[axis], dtype=float).reshape(np.where(np.arange(3) == axis, -1, 1))
        sums = weighted_removal(plan, np.broadcast_to(index, volume.shape))
        middle[cut, axis] = sums[cut] / count[cut]
    ahead = volume.points(middle) - plan.points
    length = np.linalg.norm(ahead, axis=1)
    along = np.einsum("ij,ij->i", ahead, plan.axes) / np.where(length > 0, length, np.nan)
    return np.sqrt(np.maximum(0.0, 1.0 - along**2))


@dataclass(frozen=True, eq=False)
class Cutting:
    """How a plan cuts, row by row, and around one structure.

    Attributes
    ----------
    plan : Plan
    way : (n,) array
        mm of path up to each point.
    force : (n,) array
        mm^2, see `cutting_force`.
    sine : (n,) array
        See `incidence_sine`.
    gap : (n,) array
        mm between the burr's surface and the structure.
    near : (n,) array
        mm^3 removed on the way to each point that lie within `near_mm` of the structure.
    near_mm : float
    milling_time_s : float
        Of `predict_milling` on the robot of the plan's degrees of freedom.
    """

    plan: Plan
    way: np.ndarray
    force: np.ndarray
    sine: np.ndarray
    gap: np.ndarray
    near: np.ndarray
    near_mm: float
    milling_time_s: float

    @property
    def in_contact(self) -> np.ndarray:
        """(n,) bool: the burr moves and has cut bone within the last mm."""
        return (self.force > 0) & np.concatenate([[False], self.plan.step_lengths > 0])

    @property
    def at_structure(self) -> np.ndarray:
        """(n,) bool: in contact, with the burr's surface within `near_mm` of the structure."""
        return self.in_contact & (self.gap <= self.near_mm)

    def summary(self) -> pd.Series:
        """Length, time, force (also at the structure), angle of the cut, and when the bone there goes.

        ``bone_gone_before_pct`` is the mean share of all bone that goes before the bone within `near_mm` of
        the structure; ``first_tenth_at_pct`` the share of the path after which a tenth of that is gone.
        """
        cut = np.isfinite(self.sine)
        removed = self.plan.removed
        gone = (np.cumsum(removed) - removed / 2) / removed.sum()
        tenth = self.way[np.searchsorted(np.cumsum(self.near), 0.1 * self.near.sum())] / self.way[-1]
        here = self.force[self.at_structure]
        return pd.Series(
            {
                "path_length_mm": self.plan.length_mm,
                "milling_time_s": self.milling_time_s,
                "voxels_left": int(np.count_nonzero(self.plan.left)),
                "force_95_mm2": np.percentile(self.force[self.in_contact], 95),
                "force_95_at_structure_mm2": np.percentile(here, 95),
                "force_max_at_structure_mm2": here.max(),
                "bone_gone_before_pct": 100 * np.average(gone, weights=self.near),
                "first_tenth_at_pct": 100 * tenth,
                "mean_incidence_sine": np.average(self.sine[cut], weights=removed[cut]),
                "cut_by_pole_pct": 100 * removed[cut & (self.sine < POLE_SINE)].sum() / removed[cut].sum(),
                "planning_time_s": self.plan.planning_time_s,
            }
        )


def cutting(
    plan: Plan, structure: np.ndarray, density: np.ndarray | None = None, near_mm: float = 3.0
) -> Cutting:
    """Follow a plan and note how it cuts.

    Parameters
    ----------
    plan : Plan
        As planned, not read from a file.
    structure : (nx, ny, nz) bool array
        Around which force and order are looked at.
    density : (nx, ny, nz) array, optional
        Relative bone density; 1 by default.
    near_mm : float
        How far from the structure counts as near.

    Raises
    ------
    InputError
        If the structure has no voxel or another shape, or the plan cuts nothing near it.
    """
    volume = plan.volume
    if structure.shape != volume.shape or not structure.any():
        raise InputError(
            f"structure: expected a mask of shape {volume.shape} with a voxel set, got {structure.shape}"
        )
    distance = ndimage.distance_transform_edt(~structure, sampling=volume.spacing)
    at = np.rint(volume.indices(plan.points)).astype(int)
    record = Cutting(
        plan=plan,
        way=np.concatenate([[0.0], np.cumsum(plan.step_lengths)]),
        force=cutting_force(plan, density),
        sine=incidence_sine(plan),
        gap=distance[tuple(at.T)] - plan.drill.burr_radius,
        near=weighted_removal(plan, (distance <= near_mm).astype(float)),
        near_mm=near_mm,
        milling_time_s=predict_milling(plan, density=density).time_s,
    )
    if not record.near.sum() > 0 or not record.at_structure.any():
        raise InputError(f"near_mm: the plan cuts no bone within {near_mm:g} mm of the structure")
    return record


def term_variants(
    structure: np.ndarray, spacing: np.ndarray, density: np.ndarray | None = None, weights=(10.0, 40.0)
) -> dict[str, tuple]:
    """The optional terms, each alone, and two of them together, by name.

    Parameters
    ----------
    structure, spacing
        As `study.planners.leave_for_last`.
    density : array, optional
        As `study.planners.CuttingForce`.
    weights : sequence of float
        Of each term; incidence by bone, which saturates, has only the smallest. The two together are force
        at the smallest and leave for last at the largest.

    Returns
    -------
    dict of str to tuple
        ``PlannerSettings.terms``; the first is `PRINTED_TERMS` alone.
    """
    variants: dict[str, tuple] = {PRINTED_TERMS: ()}
    variants |= {f"force × {weight:g}": (CuttingForce(weight, density),) for weight in weights}
    variants |= {f"incidence × {weight:g}": (IncidenceAngle(weight),) for weight in weights}
    low, high = min(weights), max(weights)
    variants[f"incidence by bone × {low:g}"] = (IncidenceAngle(low, by_bone=True),)
    variants |= {
        f"leave for last × {weight:g}": (leave_for_last(structure, spacing, weight),) for weight in weights
    }
    together = f"force × {low:g} and leave for last × {high:g}"
    variants[together] = (CuttingForce(low, density), leave_for_last(structure, spacing, high))
    return variants


def compare_terms(
    case: Case,
    structure: np.ndarray,
    variants: Mapping[str, tuple],
    dofs: Iterable[int] = (4, 5),
    seeds: Iterable[int] = (0,),
    **options,
) -> tuple[pd.DataFrame, dict[tuple[int, str], Cutting]]:
    """Plan a case with each set of terms, verify the plan, and note how it cuts.

    Parameters
    ----------
    case : study.cases.Case
    structure : (nx, ny, nz) bool array
    variants : mapping of str to tuple
        ``PlannerSettings.terms`` by name, such as `term_variants` gives.
    dofs : iterable of {4, 5}
    seeds : iterable of int
        Of the planner's ties.
    **options
        To `cutting`.

    Returns
    -------
    table : pandas.DataFrame
        `Cutting.summary`, indexed by ``dof``, ``terms`` and ``seed``.
    records : dict of (dof, terms) to Cutting
        Of the first seed.
    """
    records, rows = {}, {}
    todo = [(dof, name, seed) for dof in dofs for name in variants for seed in seeds]
    for dof, name, seed in tqdm(todo, disable=bool(os.environ.get("STUDY_BATCH"))):
        settings = PlannerSettings(terms=variants[name], seed=seed)
        plan = plan_path(case.planning, "3d", dof, settings=settings, approach=case.approach)
        plan.verify()
        record = cutting(plan, structure, **options)
        rows[dof, name, seed] = record.summary()
        records.setdefault((dof, name), record)
    return pd.DataFrame(rows).T.rename_axis(["dof", "terms", "seed"]), records


def changes(table: pd.DataFrame) -> pd.DataFrame:
    """Each set of terms against the five printed ones of the same robot, in per cent.

    Parameters
    ----------
    table : pandas.DataFrame
        Of `compare_terms`, with `PRINTED_TERMS`, or its means over the seeds.
    """
    columns = {
        "path_length_mm": "path_pct",
        "milling_time_s": "time_pct",
        "force_95_mm2": "force_pct",
        "force_95_at_structure_mm2": "force_at_structure_pct",
        "mean_incidence_sine": "incidence_sine_pct",
    }
    first = table.xs(PRINTED_TERMS, level="terms")
    ratio = (
        table[list(columns)] / first[list(columns)].reindex(table.index.get_level_values("dof")).to_numpy()
    )
    return (100 * (ratio - 1)).rename(columns=columns)


def term_claims(table: pd.DataFrame) -> list[Claim]:
    """What each term is for, decided by the table: it has to change by 5 % or more for every robot in it.

    Parameters
    ----------
    table : pandas.DataFrame
        Means over the seeds of the table of `compare_terms`, with `PRINTED_TERMS`.
    """
    first = table.xs(PRINTED_TERMS, level="terms")
    purposes = {  # kind of term: column, +1 if more of it is better, statement
        "force": ("force_95_mm2", -1, "lowers the force by 5 % or more"),
        "incidence": ("mean_incidence_sine", 1, "raises the mean sine of the incidence by 5 % or more"),
        "leave for last": (
            "force_95_at_structure_mm2",
            -1,
            "lowers the force at the structure by 5 % or more",
        ),
    }
    claims = []
    for name in table.index.unique("terms"):
        if name == PRINTED_TERMS:
            continue
        kinds = [kind for kind in purposes if kind in name]
        for kind in kinds:
            column, sign, statement = purposes[kind]
            before, after = first[column], table.xs(name, level="terms")[column]
            claims.append(
                Claim(
                    text=f"{name}: {statement}",
                    holds=bool((sign * (after / before - 1) >= LEAST_CHANGE).all()),
                    evidence=", ".join(
                        f"{dof} DOF {with_unit(before[dof], unit_of(column))} → "
                        f"{with_unit(after[dof], unit_of(column))}"
                        for dof in before.index
                    ),
                    where="measured",
                )
            )
    return claims
