"""How accurate a robot has to be for a planned hole."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from study.errors import InputError
from study.guidance.access.collision import CollisionRisks, collision_probability
from study.guidance.access.planning import AccessPlan
from study.margins.overall_risk import RiskEstimate
from study.margins.settings import checked_share

#: Halvings of the bracket: its width is then less than a ten-thousandth of it.
_HALVINGS = 14
#: A robot that needs to be no better than this many times worse is good enough for any purpose here.
_WORST = 64.0


@dataclass(frozen=True, eq=False)
class RequiredAccuracy:
    """The errors at which a structure is touched as often as is accepted.

    Attributes
    ----------
    structure : str
    probability : float
        That was asked for.
    scale : float
        Of the plan's errors: below 1 the robot has to become better, above it may be worse. 0 where even a
        robot without error touches the structure.
    entry_std, target_std : float
        mm: root mean square error across the drill, per axis, at that scale.
    estimate : RiskEstimate
        Of the simulated errors at that scale.
    """

    structure: str
    probability: float
    scale: float
    entry_std: float
    target_std: float
    estimate: RiskEstimate


def rms_across(errors: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """(2,) mm: root mean square errors across a drill, per axis, at entry and target.

    Parameters
    ----------
    errors : (n, 2, 3) array
        mm, image axes.
    direction : (3,) unit vector
    """
    along = errors @ direction
    across = (errors**2).sum(axis=2) - along**2
    return np.sqrt(np.maximum(across, 0.0).mean(axis=0) / 2)


def _scaled(plan: AccessPlan, structure: str, scale: float) -> CollisionRisks:
    return collision_probability(
        {structure: plan.around.keep[structure]},
        plan.entry,
        plan.target,
        scale * plan.risks.errors,
        plan.settings.drill_radius,
        plan.risks.voxel_reach,
    )


def required_std(
    plan: AccessPlan, structure: str = "facial_nerve", probability: float = 1e-3
) -> RequiredAccuracy:
    """How accurate a robot must be so that a structure is touched no more often than asked.

    All errors of the plan, bias and scatter, are scaled alike until the share of drills that touch the
    structure is the probability: the same errors at every scale, so that the answer does not jump about.

    Parameters
    ----------
    plan : AccessPlan
    structure : str
        One of those to stay away from.
    probability : float
        Between 0 and 1; more than one over the number of the plan's errors.

    Returns
    -------
    RequiredAccuracy
        Its scale is at most 64.

    Raises
    ------
    LabelError
        If there is no such structure.
    InputError
        If the probability is out of range, or less than so many errors can tell.
    """
    checked_share("probability", probability)
    plan.risks.column(structure)
    if probability * len(plan.risks.errors) < 1:
        raise InputError(
            f"probability: expected at least one in the plan's {len(plan.risks.errors)} errors, "
            f"got {probability}"
        )

    def share(scale: float) -> float:
        return _scaled(plan, structure, scale).risk(structure).risk

    low, high = 0.0, 1.0
    if plan.clearances[structure] <= 0:
        high = 0.0
    while high and high < _WORST and share(high) <= probability:
        low, high = high, 2 * high
    for _ in range(_HALVINGS if high else 0):
        middle = (low + high) / 2
        low, high = (middle, high) if share(middle) <= probability else (low, middle)
    entry_std, target_std = low * rms_across(plan.risks.errors, plan.direction)
    return RequiredAccuracy(
        structure,
        probability,
        low,
        float(entry_std),
        float(target_std),
        _scaled(plan, structure, low).risk(structure),
    )


def risk_curve(
    plan: AccessPlan, scales: ArrayLike, structures: tuple[str, ...] = ("facial_nerve",)
) -> pd.DataFrame:
    """Probability to touch structures against the size of the errors, by the same errors at every scale.

    Parameters
    ----------
    plan : AccessPlan
    scales : (n,) array
        Of the plan's errors, at least 0.
    structures : tuple of str

    Returns
    -------
    pandas.DataFrame
        Columns structure, scale, target_std_mm (root mean square across, per axis), probability, low, high,
        normal_theory.

    Raises
    ------
    LabelError
        If there is no such structure.
    InputError
        If a scale is negative.
    """
    scales = np.array(scales, dtype=float)
    if scales.ndim != 1 or not np.isfinite(scales).all() or (scales < 0).any():
        raise InputError(f"scales: expected numbers of at least 0, got {scales.tolist()}")
    std = rms_across(plan.risks.errors, plan.direction)[1]
    rows = []
    for structure in structures:
        plan.risks.column(structure)
        for scale in scales:
            found = _scaled(plan, structure, scale)
            estimate = found.risk(structure)
            low, high = estimate.interval
            rows.append(
                {
                    "structure": structure,
                    "scale": scale,
                    "target_std_mm": scale * std,
                    "probability": estimate.risk,
                    "low": low,
                    "high": high,
                    "normal_theory": found.normal[0],
                }
            )
    return pd.DataFrame(rows)
