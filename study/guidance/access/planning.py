"""One straight hole to the cochlea, where it does the least damage that is to be expected (Baron, 4.1).

After the method that the paper cites (its reference 32): errors are simulated, and of all lines the one is
taken for which damage, weighted by what may be accepted of each structure, is least probable while the
target is still hit. Every line is judged first by its clearances and normal theory, the best of them by
simulated errors, the same ones for all.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from study.errors import GuidanceError, InputError, PlanningError, TargetUnreachableError
from study.guidance.access.axes import checked_errors, to_drill_axes, to_image_axes
from study.guidance.access.candidates import Lines, fan, finer, lines_through_recess
from study.guidance.access.collision import (
    CollisionRisks,
    collision_probability,
    distances_from_line,
    moments,
)
from study.guidance.access.export import write_line
from study.guidance.access.models import DrawnErrors, LineErrorModel, printed_absolute
from study.guidance.access.settings import AccessSettings
from study.guidance.access.structures import Surroundings, surroundings
from study.margins.overall_risk import RiskEstimate
from study.specimens.orientation import side_of
from study.volumes import LabelVolume


@dataclass(frozen=True, eq=False)
class AccessPlan:
    """A planned hole and what is to be expected of it.

    Attributes
    ----------
    anatomy : LabelVolume
    side : {"right", "left"}
    entry, target : (3,) arrays
        mm. The centre of the drill's ball stops at the target.
    settings : AccessSettings
    around : Surroundings
        Structures to stay away from, and the part of the labyrinth that is to be opened.
    model : LineErrorModel
        Of the robot's errors, in the axes of the drill.
    risks : CollisionRisks
        Of every structure to stay away from.
    reached : RiskEstimate
        Drills that open the labyrinth within `AccessSettings.opening` of the target.
    recess_width : float
        mm between facial nerve and chorda tympani, or ear canal, as the drill passes them.
    leaves_the_image : bool
        Whether the image ends where the drill enters, still in bone.
    candidates : pandas.DataFrame
        Every line through the facial recess that was looked at: angles, entry, clearances, expected damage
        by normal theory and, where it was simulated, by simulation.
    """

    anatomy: LabelVolume
    side: str
    entry: np.ndarray
    target: np.ndarray
    settings: AccessSettings
    around: Surroundings
    model: LineErrorModel
    risks: CollisionRisks
    reached: RiskEstimate
    recess_width: float
    leaves_the_image: bool
    candidates: pd.DataFrame

    @property
    def direction(self) -> np.ndarray:
        """(3,) unit vector from entry to target."""
        return (self.target - self.entry) / self.length_mm

    @property
    def length_mm(self) -> float:
        """Distance from entry to target, mm."""
        return float(np.linalg.norm(self.target - self.entry))

    @property
    def clearances(self) -> pd.Series:
        """Distance between the planned drill and each structure, mm."""
        return pd.Series(self.risks.planned, index=list(self.risks.names), name="planned_clearance_mm")

    @property
    def expected_damage(self) -> float:
        """Sum over structures of the probability to be touched over the accepted one."""
        return weighted_damage(self.risks, self.around)

    @property
    def too_probable(self) -> tuple[str, ...]:
        """Structures that are touched more often than is accepted, those left out that may be sacrificed."""
        found = self.risks.probabilities
        return tuple(
            name
            for name in self.risks.names
            if found[name] > self.around.acceptable[name] and not _sacrificed(name, self.settings)
        )

    @property
    def acceptable(self) -> bool:
        """Whether no structure is touched more often than is accepted."""
        return not self.too_probable

    def table(self) -> pd.DataFrame:
        """One row a structure, the most probable first; see `CollisionRisks.table`."""
        table = self.risks.table()
        table.insert(5, "accepted", pd.Series(self.around.acceptable))
        return table.sort_values(["probability", "normal_theory"], ascending=False, kind="stable")

    def summary(self) -> pd.Series:
        """The hole in a few numbers."""
        return pd.Series(
            {
                "side": self.side,
                "length_mm": self.length_mm,
                "recess_width_mm": self.recess_width,
                "facial_nerve_clearance_mm": self.clearances["facial_nerve"],
                "facial_nerve_probability": self.risks.risk("facial_nerve").risk,
                "target_reached": self.reached.risk,
                "expected_damage": self.expected_damage,
                "too_probable": ", ".join(self.too_probable) or "none",
                "leaves_the_image": self.leaves_the_image,
                "not_labelled": ", ".join(self.around.missing) or "none",
            }
        )

    def with_errors(self, errors: LineErrorModel | ArrayLike, rng: object = 0) -> AccessPlan:
        """The same hole drilled by another robot.

        Raises
        ------
        InputError
            See `plan_access`.
        """
        model, drawn = _drawn(errors, self.settings.samples, rng)
        risks, reached = _simulated(self.around, self.entry, drawn, self.settings, self.risks.voxel_reach)
        return AccessPlan(**{**vars(self), "model": model, "risks": risks, "reached": reached})

    def with_drill(self, diameter: float) -> AccessPlan:
        """The same hole and errors with a drill of another diameter, mm.

        Raises
        ------
        InputError
            If it is not positive.
        """
        settings = replace(self.settings, drill_diameter=diameter)
        drawn = to_drill_axes(self.risks.errors, self.entry, self.target)
        risks, reached = _simulated(self.around, self.entry, drawn, settings, self.risks.voxel_reach)
        return AccessPlan(**{**vars(self), "settings": settings, "risks": risks, "reached": reached})

    def to_markups(self, path: str | os.PathLike[str]) -> None:
        """Write entry and target as a line for 3D Slicer (``.mrk.json``), LPS mm."""
        write_line(self, path)

    def verify(self) -> None:
        """Measure the planned drill anew, by all voxels of all structures.

        Raises
        ------
        GuidanceError
            If a clearance is not what it says, or the planned drill touches what may not be touched.
        """
        for name, clearance in self.clearances.items():
            found = distances_from_line(self.around.keep[name], self.entry, self.target).min()
            found -= self.settings.drill_radius + self.risks.voxel_reach
            if abs(found - clearance) > 1e-9:
                raise GuidanceError(
                    f"{name}: expected {clearance:.6f} mm of clearance, measured {found:.6f} mm"
                )
            if found <= 0 and not _sacrificed(name, self.settings):
                raise GuidanceError(f"{name}: the planned drill touches it by {-found:.3f} mm")


def plan_access(
    anatomy: LabelVolume,
    target: ArrayLike | None = None,
    settings: AccessSettings | None = None,
    errors: LineErrorModel | ArrayLike | None = None,
    rng: object = 0,
    *,
    side: str | None = None,
    acceptable_only: bool = False,
) -> AccessPlan:
    """Plan one straight hole from the side of the skull through the facial recess to the cochlea.

    Parameters
    ----------
    anatomy : LabelVolume
        A segmented temporal bone, LPS, with labels for bone, facial nerve, labyrinth, chorda tympani or ear
        canal, and, for the target's rule, ossicles; names of `study.specimens.structures.SYNONYMS`.
    target : (3,) array, optional
        mm, where the centre of the drill's ball stops; `round_window_target` by default.
    settings : AccessSettings, optional
    errors : model with ``sample(n, rng)`` or (n, 2, 3) array, optional
        mm at entry and target in the axes of the drill (`drill_axes`); an array is used as it is, every row
        once. `printed_absolute` by default.
    rng : anything `numpy.random.default_rng` takes
    side : {"right", "left"}, optional
        Found from the anatomy if not given.
    acceptable_only : bool
        Whether a hole is an error that touches some structure more often than is accepted.

    Returns
    -------
    AccessPlan
        That of least expected damage; `AccessPlan.too_probable` says what it does not satisfy.

    Raises
    ------
    LabelError
        If a structure that is needed is missing.
    GeometryError
        If a given target is not at the labyrinth, or nothing is found by the rule.
    InputError
        If the errors have another shape.
    TargetUnreachableError
        If no line passes through the facial recess without touching something; it names what blocks.
    PlanningError
        If `acceptable_only` and no line is acceptable.
    """
    settings = settings or AccessSettings()
    side = side_of(anatomy) if side is None else side
    model, drawn = _drawn(printed_absolute() if errors is None else errors, settings.samples, rng)
    around = surroundings(anatomy, target, settings)
    reach = float(np.linalg.norm(anatomy.spacing) / 2) if settings.voxels == "whole" else 0.0
    given = (anatomy, around)
    more = (side, *moments(drawn), settings, reach)
    lines = lines_through_recess(*given, fan(settings), *more)
    if not len(lines):
        raise TargetUnreachableError(
            f"no line within {settings.fan_deg:g} degrees of straight lateral passes from the target "
            f"{around.target.round(1).tolist()} between facial_nerve and "
            f"{'chorda_tympani' if 'chorda_tympani' in around.keep else 'external_auditory_canal'}"
        )
    best = _ranked(lines, settings)
    # Where the coarse cone finds none a finer one may, around the lines that touch least.
    best = best if len(best) else np.argsort(-_least(lines, settings), kind="stable")
    lines = lines.joined(
        lines_through_recess(*given, finer(lines.angles[best[: settings.refined]], settings), *more)
    )
    best = _ranked(lines, settings)[: settings.simulated]
    if not len(best):
        raise TargetUnreachableError(_blocked(lines, settings))
    damage = np.array([_simulated_damage(around, lines, row, drawn, settings, reach) for row in best])
    # Lines come by the normal theory's order: among equals the first is its best.
    chosen = int(np.argmin(damage))
    table = lines.table()
    table["simulated_damage"] = np.nan
    table.loc[best, "simulated_damage"] = damage
    row = best[chosen]
    risks, reached = _simulated(around, lines.entries[row], drawn, settings, reach)
    plan = AccessPlan(
        anatomy=anatomy,
        side=side,
        entry=lines.entries[row],
        target=around.target,
        settings=settings,
        around=around,
        model=model,
        risks=risks,
        reached=reached,
        recess_width=float(lines.recess_width[row]),
        leaves_the_image=bool(lines.cut_off[row]),
        candidates=table,
    )
    if acceptable_only and not plan.acceptable:
        raise PlanningError(
            "no line is acceptable; the best touches "
            + ", ".join(
                f"{name} with {risks.risk(name).risk:.3g} (accepted {around.acceptable[name]:g})"
                for name in plan.too_probable
            )
        )
    return plan


def weighted_damage(risks: CollisionRisks, around: Surroundings) -> float:
    """Sum over structures of the probability to be touched over the accepted one."""
    weights = np.array([around.acceptable[name] for name in risks.names])
    return float((risks.probabilities.to_numpy() / weights).sum())


def _drawn(errors: object, samples: int, rng: object) -> tuple[LineErrorModel, np.ndarray]:
    if isinstance(errors, DrawnErrors):
        return errors, errors.errors
    if isinstance(errors, LineErrorModel) and not isinstance(errors, type):
        drawn = checked_errors(errors.sample(samples, np.random.default_rng(rng)), "errors.sample")
        return errors, drawn
    if isinstance(errors, type) or not isinstance(errors, (np.ndarray, list, tuple)):
        raise InputError(
            f"errors: expected a model with sample(n, rng) or an (n, 2, 3) array, got {errors!r}"
        )
    model = DrawnErrors(errors)
    return model, model.errors


def _simulated(
    around: Surroundings, entry: np.ndarray, drawn: np.ndarray, settings: AccessSettings, reach: float
) -> tuple[CollisionRisks, RiskEstimate]:
    """Risks of a line, and how often it opens the labyrinth at its target."""
    errors = to_image_axes(drawn, entry, around.target)
    line = (entry, around.target, errors, settings.drill_radius)
    risks = collision_probability(around.keep, *line, reach)
    reached = collision_probability({"opening": around.opening}, *line).risk("opening")
    return risks, reached


def _simulated_damage(
    around: Surroundings, lines: Lines, row: int, drawn: np.ndarray, settings: AccessSettings, reach: float
) -> float:
    """Expected damage of a line; structures that no error reaches are not asked."""
    farthest = np.linalg.norm(drawn, axis=2).max()
    near = [name for name, mm in zip(lines.names, lines.clearances[row], strict=True) if mm <= farthest]
    if not near:
        return 0.0
    entry = lines.entries[row]
    risks = collision_probability(
        {name: around.keep[name] for name in near},
        entry,
        around.target,
        to_image_axes(drawn, entry, around.target),
        settings.drill_radius,
        reach,
    )
    return weighted_damage(risks, around)


def _sacrificed(name: str, settings: AccessSettings) -> bool:
    return set(name.split("_and_")) <= set(settings.sacrificed)


def _least(lines: Lines, settings: AccessSettings) -> np.ndarray:
    """Each line's smallest clearance from what may not be touched, mm."""
    kept = [not _sacrificed(name, settings) for name in lines.names]
    return lines.clearances[:, kept].min(axis=1)


def _ranked(lines: Lines, settings: AccessSettings) -> np.ndarray:
    """Rows of lines that touch nothing as planned, the least damage first; among equals the widest."""
    least = _least(lines, settings)
    order = np.lexsort((-least, lines.damage))
    return order[least[order] > 0]


def _blocked(lines: Lines, settings: AccessSettings) -> str:
    touched = lines.clearances <= 0
    touched[:, [_sacrificed(name, settings) for name in lines.names]] = False
    alone = touched & (touched.sum(axis=1) == 1)[:, None]
    order = np.argsort(-touched.sum(axis=0), kind="stable")
    parts = [
        f"{lines.names[n]} blocks {touched[:, n].sum()} of them ({alone[:, n].sum()} alone)"
        for n in order
        if touched[:, n].any()
    ]
    return (
        f"no free line through the facial recess for a drill of {settings.drill_diameter:g} mm: "
        f"{len(lines)} pass between the nerves, {'; '.join(parts)}; "
        f"the freest of them lacks {-_least(lines, settings).max():.2f} mm"
    )
