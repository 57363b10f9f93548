"""Milling a volume several times with burrs of different diameters (Siebold, end of 2.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from study.collision import Drill
from study.errors import InputError, PlanningError
from study.planners.plan import Plan
from study.planners.planning import plan_path
from study.planners.settings import PlannerSettings
from study.volumes import LabelVolume


def plan_passes(
    volume: LabelVolume,
    burr_diameters: Sequence[float],
    *,
    drill: Drill | None = None,
    settings: PlannerSettings | None = None,
    least_mm3: float = 0.0,
    **arguments,
) -> list[Plan]:
    """Plan one pass a burr, the largest first; what one pass leaves is where the next begins.

    Parameters
    ----------
    volume : LabelVolume
        As for `plan_path`.
    burr_diameters : sequence of float
        mm, different from each other.
    drill : Drill, optional
        Whose shaft is used with every burr. A burr thinner than its shaft gets a shaft of 0.48 of
        its diameter, the proportion of the 5 mm burr on its 2.4 mm shaft.
    settings : PlannerSettings, optional
    least_mm3 : float
        Smaller burrs are left out once no more target than this remains.
    **arguments
        Passed on to `plan_path`.

    Returns
    -------
    list of Plan
        In milling order. A burr that finds nothing it can reach is left out.

    Raises
    ------
    InputError
        If no diameter is given, or two are equal.
    PlanningError
        If the first burr fits nowhere; see `plan_path`.
    """
    diameters = sorted((float(diameter) for diameter in burr_diameters), reverse=True)
    if not diameters or len(set(diameters)) < len(diameters):
        raise InputError(f"burr_diameters: expected different diameters in mm, got {list(burr_diameters)}")
    drill = Drill() if drill is None else drill
    settings = PlannerSettings() if settings is None else settings
    plans: list[Plan] = []
    for diameter in diameters:
        if plans and volume.volume_mm3("target") <= least_mm3:
            break
        shaft = min(drill.shaft_diameters[0], 0.48 * diameter)
        burr = replace(drill, burr_diameter=diameter, shaft_diameters=(shaft, *drill.shaft_diameters[1:]))
        again = replace(settings, finishing=settings.finishing or bool(plans))
        try:
            plan = plan_path(volume, drill=burr, settings=again, **arguments)
        except PlanningError:
            if not plans:
                raise
            continue
        if plan.removed.sum() > 0:
            plans.append(plan)
            volume = plan.remaining
    return plans
