"""Appendix A of Siebold: every specimen planned and milled with one strategy, one row each.

A row holds the columns of tables A.1 to A.4 (lengths truly in mm) and whether the plan and the robot's
rounded path, replayed independently of the planner, cut nothing they must not.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np
import pandas as pd
from tqdm.auto import tqdm

from study import published
from study.errors import FileFormatError, InputError, PlanViolation, StudyError
from study.paths import output_folder
from study.planners import Plan, PlannerSettings, plan_path
from study.planners.planning import STRATEGIES
from study.prepare import load_kernels, warm, warm_planning
from study.robots import FeedSettings, Motion, predict_milling
from study.specimens import catalogue, specimen
from study.threads import usual_workers

#: Printed table of each strategy and number of degrees of freedom.
PRINTED = {("zigzag", 4): "A.1", ("3d", 4): "A.2", ("zigzag", 5): "A.3", ("3d", 5): "A.4"}


def select_specimens(specimens: str) -> list[str]:
    """Names of the specimens a notebook's parameter asks for.

    Parameters
    ----------
    specimens : str
        ``"all"``, names separated by commas or blanks (``"CH01, TB14"``), or how many: ``"6"`` takes
        six spread evenly over the catalogue.

    Returns
    -------
    list of str
        In the printed order.

    Raises
    ------
    InputError
        If a name is not in the catalogue, or the number is not 1 to the catalogue's length.
    """
    names = list(catalogue())
    text = str(specimens).strip()
    if text == "all":
        return names
    if text.isdigit():
        if not 1 <= int(text) <= len(names):
            raise InputError(f"specimens: expected 1 to {len(names)} of them, got {text}")
        return [names[k] for k in np.linspace(0, len(names) - 1, int(text)).round().astype(int)]
    asked = text.replace(",", " ").split()
    unknown = [name for name in asked if name not in names]
    if unknown or not asked:
        raise InputError(
            f"specimens: expected 'all', a number, or names of {names[0]}-{names[-1]}; got {specimens!r}"
        )
    return [name for name in names if name in asked]


def plan_specimen(name: str, strategy: str = "3d", dof: int = 4, seed: int = 0) -> Plan:
    """Plan the milling of one specimen of the catalogue, compiled kernels loaded before.

    Parameters
    ----------
    name : str
        Such as ``"CH01"``.
    strategy : {"3d", "zigzag"}
    dof : int
    seed : int
        Of the planner's ties (`PlannerSettings`).

    Returns
    -------
    Plan
    """
    load_kernels(strategy, dof)
    try:
        volume = specimen(name).planning
        return plan_path(volume, strategy=strategy, dof=dof, settings=PlannerSettings(seed=seed))
    except StudyError as error:  # which of many it was is lost otherwise
        error.add_note(f"specimen {name}, {strategy}, {dof} degrees of freedom")
        raise


def appendix_row(
    name: str, strategy: str = "3d", dof: int = 4, seed: int = 0, feed: FeedSettings | None = None
) -> dict[str, object]:
    """One row of the appendix: plan, verify, mill.

    Parameters
    ----------
    name, strategy, dof, seed
        As for `plan_specimen`.
    feed : FeedSettings, optional

    Returns
    -------
    dict
        ``specimen``, the printed columns, ``verified``, ``strategy``, ``dof``, ``seed``. The robot's
        columns are absent for 5 degrees of freedom, as in print: the text's robot has 4 (2.4.2). What
        a robot with a fifth makes of these plans is in `study.experiments.freedom`.
    """
    plan = plan_specimen(name, strategy, dof, seed)
    row = {"specimen": name, **plan.summary()}
    replayed = [plan]
    if dof == 4:
        milling = predict_milling(plan, feed=feed)
        row |= dict(milling.summary())
        replayed.append(milling)
    try:
        for motion in replayed:
            motion.verify()
        verified = True
    except PlanViolation:
        verified = False
    return row | {"verified": verified, "strategy": strategy, "dof": dof, "seed": seed}


def motion_of(name: str, strategy: str = "zigzag", seed: int = 0) -> Motion:
    """What the feed rate acts on when one specimen is milled: input of `fit_feed_constant`."""
    return predict_milling(plan_specimen(name, strategy, 4, seed)).motion


def _workers(asked: int, jobs: int) -> int:
    return max(1, min(asked or usual_workers(), jobs))


def over_specimens(
    function: Callable, names: Sequence, workers: int = 0, load: Callable[[], None] = warm
) -> list:
    """``[function(name) for name in names]`` in processes of their own.

    Parameters
    ----------
    function : callable
        Picklable, of one name.
    names : sequence of str
    workers : int
        Processes; 0 takes two, or one where there is only one core or where another notebook runs beside
        this one (`usual_workers`). 1 stays in this process.
    load : callable
        Compiles what `function` needs: once, before several processes would do it.

    Returns
    -------
    list
        In the order of `names`, whoever finishes first.
    """
    workers = _workers(workers, len(names))
    silent = bool(os.environ.get("STUDY_BATCH"))  # tqdm's own variable does not reach its notebook bar
    progress = partial(tqdm, total=len(names), desc="specimens", leave=False, disable=silent)
    if workers == 1:
        return list(progress(map(function, names)))
    load()
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        return list(progress(pool.map(function, names)))


def run_appendix(
    names: Sequence[str],
    strategy: str = "3d",
    dof: int = 4,
    workers: int = 0,
    seed: int = 0,
    feed: FeedSettings | None = None,
) -> pd.DataFrame:
    """Plan and mill specimens in parallel.

    Parameters
    ----------
    names : sequence of str
        Of the catalogue.
    strategy : {"3d", "zigzag"}
    dof : int
    workers : int
        Processes; 0 as for `over_specimens`. ``simulation_time_s`` is measured while two run side by side.
    seed : int
    feed : FeedSettings, optional

    Returns
    -------
    pandas.DataFrame
        A row per name in the order given, indexed by it: the printed columns in printed order, then
        ``verified``, ``strategy``, ``dof``, ``seed``. The same arguments give the same rows, times of
        planning apart.

    Raises
    ------
    InputError
        If there is no name or no such strategy.
    """
    if not names:
        raise InputError("names: expected at least one specimen, got none")
    if (strategy, dof) not in PRINTED:
        raise InputError(f"strategy, dof: expected {STRATEGIES} with 4 or 5, got {strategy!r}, {dof!r}")
    one = partial(appendix_row, strategy=strategy, dof=dof, seed=seed, feed=feed)
    load = partial(warm_planning, (strategy,), (dof,))
    rows = pd.DataFrame(over_specimens(one, names, workers, load))
    columns = [name for name in published.table(PRINTED[strategy, dof]).columns if name in rows]
    return rows[[*columns, "verified", "strategy", "dof", "seed"]].set_index("specimen")


def appendix_file(strategy: str, dof: int = 4) -> str:
    """Name of the file that ``appendix_a.ipynb`` writes its rows to."""
    return f"appendix_a_{strategy}_{dof}dof.csv"


def appendix_rows(
    names: Sequence[str],
    strategy: str = "3d",
    dof: int = 4,
    folder: str | os.PathLike[str] = "",
    seed: int = 0,
    workers: int = 0,
) -> pd.DataFrame:
    """Rows of the appendix, from the file that ``appendix_a.ipynb`` wrote or, where they are missing, anew.

    Parameters
    ----------
    names : sequence of str
    strategy, dof, seed, workers
        As for `run_appendix`.
    folder : path-like
        Where `appendix_file` is looked for; ``""`` stands for ``figures/``. Nothing is written there.

    Returns
    -------
    pandas.DataFrame
        As of `run_appendix`. A file is used only if it holds all of the specimens, planned with this seed.

    Raises
    ------
    FileFormatError
        If the file is no such table.
    """
    path = output_folder(folder) / appendix_file(strategy, dof)
    if path.is_file():
        try:
            kept = pd.read_csv(path).set_index("specimen")
            same = (kept["strategy"] == strategy) & (kept["dof"] == dof) & (kept["seed"] == seed)
        except (KeyError, ValueError) as error:
            raise FileFormatError(f"{path}: expected the rows of an appendix: {error}") from error
        if set(names) <= set(kept.index[same]):
            return kept.loc[list(names)]
    return run_appendix(names, strategy, dof, workers, seed)
