"""How often each stopping rule returns a margin whose true risk is above the tolerance.

The risk with which growth stops is counted on the registrations that stopped it. Here margins are grown
again and again with other registrations, and every one is put before the same large set of fresh ones.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
import pandas as pd
from scipy import stats
from tqdm.auto import tqdm

from study.cases import load_case
from study.errors import InputError
from study.margins import (
    ACCEPTABLE_RISKS,
    GrowthSettings,
    RiskEstimate,
    SafetyMargin,
    allowed_hits,
    grow_margin,
)
from study.registration import PointRegistration
from study.specimens import structure_mask

#: Stopping rules by name: method and confidence of `GrowthSettings`.
RULES: Mapping[str, tuple[str, float | None]] = MappingProxyType(
    {
        "published": ("published", None),
        "exact, plain quantile": ("exact", None),
        "exact, 95 % confidence": ("exact", 0.95),
    }
)
#: Seed sequences of growing and of judging differ in this.
_GROWING, _JUDGING = 0, 1


def _row(margin: SafetyMargin, truth: RiskEstimate) -> dict[str, object]:
    low, high = truth.interval
    tolerance = margin.acceptable_risk
    return {
        "tolerance": tolerance,
        "registrations": margin.settings.registrations,
        "volume_mm3": margin.volume_mm3,
        "stopped_at_risk": margin.damage_risk,
        "true_risk": truth.risk,
        "true_low": low,
        "true_high": high,
        "true_over_tolerance": truth.risk / tolerance,
        "looks": 1 if margin.history is None else len(margin.history),
        "looks_near_tolerance": _near(margin.history, tolerance),
        "growth_s": margin.time_s,
    }


def _near(history: pd.DataFrame | None, tolerance: float) -> int:
    """Looks at a risk of at most twice the tolerance, at any of which growth may stop by luck."""
    return 1 if history is None else int((history["risk"] <= 2 * tolerance).sum())


def run_rules(
    bone: str,
    structures: Sequence[str] = ("facial_nerve", "internal_auditory_canal"),
    rules: Sequence[str] = tuple(RULES),
    runs: int = 20,
    published_runs: int = 0,
    registrations: int = 25_000,
    judged_on: int = 1_000_000,
    seed: int = 0,
) -> pd.DataFrame:
    """Grow margins repeatedly by each rule and measure the true risk of each.

    Parameters
    ----------
    bone : str
        As of `study.cases.load_case`, with anatomy and fiducials; on its own voxels.
    structures : sequence of str
        Of `study.margins.ACCEPTABLE_RISKS`.
    rules : sequence of str
        Of `RULES`.
    runs : int
        Margins of each structure and rule; run k draws the same registrations for all exact rules.
    published_runs : int
        Of the published rule, which takes a hundred times as long; 0 for as many as of the others.
    registrations : int
        N_r.
    judged_on : int
        Fresh registrations that stand for the truth, the same for all margins. Growths that end with the
        same margin are judged once.
    seed : int

    Returns
    -------
    DataFrame
        A row a margin: ``specimen, structure, rule, run, tolerance, registrations, volume_mm3``,
        ``stopped_at_risk``,
        ``true_risk`` with its Clopper-Pearson interval ``true_low, true_high``, ``true_over_tolerance``,
        ``looks`` (simulations that growth looked at), ``looks_near_tolerance`` (those at a risk of at
        most twice the tolerance), ``growth_s``.

    Raises
    ------
    InputError
        If there is no run, or a rule or structure is not known.
    """
    unknown = [name for name in rules if name not in RULES]
    unknown += [name for name in structures if name not in ACCEPTABLE_RISKS]
    often = {
        rule: published_runs or runs if RULES.get(rule, ("",))[0] == "published" else runs for rule in rules
    }
    jobs = [(s, rule, k) for s in structures for rule in rules for k in range(often[rule])]
    if unknown or not jobs:
        raise InputError(
            f"rules, structures, runs: expected some of {list(RULES)} and {list(ACCEPTABLE_RISKS)}, at least "
            f"one run; got {list(rules)}, {list(structures)}, {runs}"
        )
    case = load_case(bone)
    if case.anatomy is None or case.fiducials is None:
        raise InputError(f"{case.name}: expected a bone with labelled anatomy and fiducials")
    model = PointRegistration(case.fiducials)
    masks = {structure: structure_mask(case.anatomy, structure) for structure in structures}
    judged: dict[tuple[str, bytes], RiskEstimate] = {}
    rows = []
    silent = bool(os.environ.get("STUDY_BATCH"))
    for structure, rule, run in tqdm(jobs, desc="margins", leave=False, disable=silent):
        settings = GrowthSettings(RULES[rule][0], registrations, RULES[rule][1], validation_registrations=0)
        margin = grow_margin(
            case.anatomy,
            masks[structure],
            model,
            settings=settings,
            rng=[seed, _GROWING, run],
            name=structure,
        )
        same = structure, hashlib.sha256(np.packbits(margin.mask).tobytes()).digest()
        if same not in judged:
            judged[same] = margin.risk_on(judged_on, [seed, _JUDGING])
        which = {"specimen": case.name, "structure": structure, "rule": rule, "run": run}
        rows.append({**which, **_row(margin, judged[same])})
    return pd.DataFrame(rows)


def rules_table(rows: pd.DataFrame) -> pd.DataFrame:
    """What became of each rule over all runs.

    Parameters
    ----------
    rows : DataFrame
        Of `run_rules`.

    Returns
    -------
    DataFrame
        A row a structure and rule: ``runs``; in how many the true risk is ``above`` the tolerance, the
        ``share_pct`` with its 95 % Clopper-Pearson interval ``share_low_pct, share_high_pct``, and what
        theory expects at most, ``expected_pct``; in how many the whole interval of the true risk is
        ``surely_above``; median and largest true risk over the tolerance; ``true_over_stopped``, mean
        true risk over mean risk at the stop; medians of the margin's volume, of the looks a growth and
        of its seconds.
    """
    table = []
    for (structure, rule), group in rows.groupby(["structure", "rule"], sort=False):
        above = int((group["true_risk"] > group["tolerance"]).sum())
        low, high = RiskEstimate(above, len(group)).interval
        registrations, tolerance = int(group["registrations"].iloc[0]), group["tolerance"].iloc[0]
        table.append(
            {
                "structure": structure,
                "rule": rule,
                "runs": len(group),
                "above": above,
                "share_pct": 100 * above / len(group),
                "share_low_pct": 100 * low,
                "share_high_pct": 100 * high,
                "expected_pct": 100 * expected_share(rule, registrations, tolerance),
                "surely_above": int((group["true_low"] > group["tolerance"]).sum()),
                "median_true_over_tolerance": group["true_over_tolerance"].median(),
                "largest_true_over_tolerance": group["true_over_tolerance"].max(),
                "true_over_stopped": group["true_risk"].mean() / group["stopped_at_risk"].mean(),
                "median_volume_mm3": group["volume_mm3"].median(),
                "median_looks": group["looks"].median(),
                "median_looks_near_tolerance": group["looks_near_tolerance"].median(),
                "growth_s": group["growth_s"].median(),
            }
        )
    return pd.DataFrame(table).set_index(["structure", "rule"])


def expected_share(rule: str, registrations: int, tolerance: float) -> float:
    """Probability by theory that the true risk of a margin is above the tolerance.

    Where m of N registrations may do damage, the true risk has the distribution Beta(m + 1, N - m) whatever
    structure and error are; it is smaller where a margin can only grow in steps. No such law is known for
    the published rule (NaN).

    Parameters
    ----------
    rule : str
        Of `RULES`.
    registrations : int
    tolerance : float
    """
    method, confidence = RULES[rule]
    if method == "published":
        return float("nan")
    allowed = allowed_hits(registrations, tolerance, confidence)
    return float(stats.beta(allowed + 1, registrations - allowed).sf(tolerance))
