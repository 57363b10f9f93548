"""4 against 5 degrees of freedom on the same bones: what is reached, how far and how long it takes.

The dissertation expected its 5-DOF planner to reach more and measured that it left more (2.5.1). Both
start from what their own shaft can reach, so a planner that declares positions inaccessible looks good
by the printed ratio. Here a position of the modified target counts as unreached whether a planner gave
it up at the start or left it at the end.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import partial

import numpy as np
import pandas as pd

from study.cases import load_case, undercut
from study.errors import IncompletePlanWarning, InputError, PlanViolation, StudyError
from study.experiments.appendix import over_specimens
from study.planners import Plan, PlannerSettings, plan_path
from study.planners.planning import STRATEGIES
from study.prepare import load_kernels, warm_planning
from study.robots import FiveAxis, predict_milling
from study.robots.turns import angles_between
from study.tables import t_interval

#: Planners that are compared: degrees of freedom, and how 5 of them are searched (`PlannerSettings`).
PLANNERS = {"4 DOF": (4, "exact"), "5 DOF": (5, "exact"), "5 DOF, printed window": (5, "published")}


def unreached(plan: Plan) -> np.ndarray:
    """Positions of the modified target that were given up at the start or left at the end.

    Parameters
    ----------
    plan : Plan
        As planned, not read from a file.

    Returns
    -------
    (nx, ny, nz) bool array
    """
    return (plan.modified.target & ~plan.accessible) | plan.left


def freedom_row(plan: Plan) -> dict[str, object]:
    """What a plan reaches and what it costs, whatever its degrees of freedom.

    Parameters
    ----------
    plan : Plan
        As planned, not read from a file.

    Returns
    -------
    dict
        ``modified_target_cm3`` is the whole of it, accessible or not, and ``inaccessible_pct``,
        ``left_pct`` and ``unreached_pct`` are shares of it; ``modified_final_over_initial_ratio`` is
        the printed measure, what is left over what is accessible; ``bone_left_mm3`` is target that
        stays in the unmodified volume. ``milling_time_s`` is the time of a `FiveAxis` robot for all plans, so
        that the robot is the same. Turns are angles of the drill's axis between consecutive points,
        ``largest_tilt_deg`` is its largest angle to the approach. ``verified`` says whether the plan
        and the robot's rounded path passed their replays.
    """
    whole = int(np.count_nonzero(plan.modified.target))
    inaccessible = int(np.count_nonzero(plan.modified.target & ~plan.accessible))
    left = int(np.count_nonzero(plan.left))
    turns = np.rad2deg(angles_between(plan.axes[:-1], plan.axes[1:]))
    tilts = np.rad2deg(angles_between(plan.axes, np.broadcast_to(-plan.approach, plan.axes.shape)))
    milling = predict_milling(plan, FiveAxis.for_plan(plan))
    try:
        plan.verify()
        milling.verify()
        verified = True
    except PlanViolation:
        verified = False
    return {
        "modified_target_cm3": whole * plan.volume.voxel_volume / 1000,
        "inaccessible_pct": 100 * inaccessible / whole,
        "left_pct": 100 * left / whole,
        "unreached_pct": 100 * (inaccessible + left) / whole,
        "modified_final_over_initial_ratio": plan.left_fraction,
        "bone_left_mm3": plan.remaining.volume_mm3("target"),
        "path_length_mm": plan.length_mm,
        "milling_time_s": milling.time_s,
        "planning_time_s": plan.planning_time_s,
        "total_turn_deg": float(turns.sum()),
        "largest_turn_deg": float(turns.max(initial=0.0)),
        "largest_tilt_deg": float(tilts.max()),
        "verified": verified,
    }


def freedom_plan(
    name: str, strategy: str, planner: str, hole_mm: float = 0.0, rim_mm: float = 4.0, seed: int = 0
) -> Plan:
    """Plan one bone with one of `PLANNERS`.

    Parameters
    ----------
    name : str
        Whatever `study.cases.load_case` takes: a specimen, a file, a folder.
    strategy : {"3d", "zigzag"}
    planner : str
        Of `PLANNERS`.
    hole_mm, rim_mm : float
        mm of the hole and the depth of an overhang (`study.cases.undercut`); 0 leaves the bone as it is.
    seed : int

    Returns
    -------
    Plan
        It may be incomplete without a warning: what it leaves is what is looked at.

    Raises
    ------
    InputError
        If there is no such planner.
    """
    if planner not in PLANNERS:
        raise InputError(f"planner: expected one of {list(PLANNERS)}, got {planner!r}")
    dof, method = PLANNERS[planner]
    load_kernels(strategy, dof)
    case = load_case(name)
    volume = undercut(case.planning, rim_mm, hole_mm, case.approach) if hole_mm else case.planning
    settings = PlannerSettings(method=method, seed=seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", IncompletePlanWarning)
        try:
            return plan_path(volume, strategy, dof, settings=settings, approach=case.approach)
        except StudyError as error:  # which of many it was is lost otherwise
            error.add_note(f"{name}, {strategy}, {planner}, hole {hole_mm:g} mm")
            raise


def _rows_of(job: tuple[str, float], planners, strategies, rim_mm: float, seed: int) -> list[dict]:
    name, hole = job
    return [
        {"specimen": name, "hole_mm": hole, "strategy": strategy, "planner": planner}
        | freedom_row(freedom_plan(name, strategy, planner, hole, rim_mm, seed))
        for strategy in strategies
        for planner in planners
    ]


def run_freedom(
    names: Sequence[str],
    planners: Sequence[str] = ("4 DOF", "5 DOF"),
    strategies: Sequence[str] = STRATEGIES,
    holes_mm: Sequence[float] = (0.0,),
    rim_mm: float = 4.0,
    seed: int = 0,
    workers: int = 0,
) -> pd.DataFrame:
    """Plan bones with several planners, in parallel over the bones and holes.

    Parameters
    ----------
    names : sequence of str
        As of `freedom_plan`.
    planners : sequence of str
        Of `PLANNERS`.
    strategies : sequence of str
    holes_mm : sequence of float
        Every bone is planned once a hole; 0 is the bone as it is.
    rim_mm, seed
        As of `freedom_plan`.
    workers : int
        Processes; 0 takes two. ``planning_time_s`` is measured while they run side by side.

    Returns
    -------
    pandas.DataFrame
        Columns ``specimen, hole_mm, strategy, planner`` and those of `freedom_row`.

    Raises
    ------
    InputError
        If there is no name or no such planner.
    """
    jobs = [(name, float(hole)) for name in names for hole in holes_mm]
    if not jobs:
        raise InputError("names, holes_mm: expected at least one bone, got none")
    one = partial(_rows_of, planners=planners, strategies=strategies, rim_mm=rim_mm, seed=seed)
    return pd.DataFrame([row for rows in over_specimens(one, jobs, workers, warm_planning) for row in rows])


def of_planner(rows: pd.DataFrame, strategy: str, planner: str) -> pd.DataFrame:
    """The rows of one strategy and planner, indexed by specimen and hole; no row is an error."""
    found = rows[(rows["strategy"] == strategy) & (rows["planner"] == planner)]
    if found.empty:
        raise InputError(f"expected rows of {strategy}, {planner}, found none")
    return found.set_index(["specimen", "hole_mm"])


def differences(rows: pd.DataFrame, planner: str = "5 DOF", against: str = "4 DOF") -> pd.DataFrame:
    """One planner minus another on the same bones.

    Parameters
    ----------
    rows : pandas.DataFrame
        Of `run_freedom`.
    planner, against : str
        Of `PLANNERS`.

    Returns
    -------
    pandas.DataFrame
        A row for each strategy and column: ``n`` bones, the means under the planners' names,
        ``difference`` with its 95 % t interval ``plus_minus`` (NaN for one bone), and on how many
        bones it is ``less``, ``equal`` and ``more``.
    """
    table = []
    for strategy in rows["strategy"].unique():
        a, b = of_planner(rows, strategy, planner), of_planner(rows, strategy, against)
        b = b.loc[a.index]
        for column in a.select_dtypes("number").columns.drop(["modified_target_cm3"], errors="ignore"):
            change = a[column] - b[column]
            half_width = t_interval(change).half_width if len(a) > 1 else float("nan")
            table.append(
                {"strategy": strategy, "quantity": column, "n": len(a)}
                | {against: b[column].mean(), planner: a[column].mean()}
                | {"difference": change.mean(), "plus_minus": half_width}
                | {"less": (change < 0).sum(), "equal": (change == 0).sum(), "more": (change > 0).sum()}
            )
    return pd.DataFrame(table).set_index(["strategy", "quantity"])
