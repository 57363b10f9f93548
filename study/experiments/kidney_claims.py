"""What chapter 4 of Siebold says about Tables 4.2 and B.1 to B.9, decided by the printed rows and by ours.

The same functions judge both. What only we know (risks on fresh registrations, how the fits ended and how
far they scatter) is judged for ours alone.
"""

from __future__ import annotations

from typing import Literal

import pandas as pd

from study import published
from study.errors import InputError
from study.experiments.kidney_scaling import ERRORS, PowerLaw, fit_power_law, never_falls
from study.margins import REMOVAL_RISK
from study.tables import Claim, Interval, with_interval

VOLUME, RISK = "margin_volume_mm3", "final_damage_probability"
DISTANCE, SPREAD = "mahalanobis_mean", "mahalanobis_std"
#: Printed quantities, in the printed order.
QUANTITIES = (VOLUME, RISK, DISTANCE, SPREAD, "time_min")
#: What tells margins of one shape apart.
WHICH = ["tumour", *ERRORS]
#: Share by which the scatter may change over all starts and still count as the same.
SAME_SCATTER = 0.1


def printed_rows(name: str | None = None) -> pd.DataFrame:
    """Printed rows in true units (cm^3 are mm^3, finding E5), with the table's name.

    Parameters
    ----------
    name : str, optional
        One table, such as ``"4.2"``; all of B.1 to B.9 by default.
    """
    names = [name] if name else [name for name in published.tables() if name.startswith("B.")]
    return pd.concat([published.corrected(name).assign(table=name) for name in names], ignore_index=True)


def law_of(rows: pd.DataFrame, quantity: str = VOLUME) -> PowerLaw | None:
    """Power law of one shape's rows, None where there is none to fit."""
    try:
        return fit_power_law(rows, quantity)
    except InputError:
        return None


def exponents_text(law: PowerLaw) -> str:
    """``position 0.77 ± 0.16, rotation 0.07 ± 0.16``."""
    names = dict(zip(ERRORS, ("position", "rotation"), strict=True))
    return ", ".join(f"{names[error]} {exponent(value)}" for error, value in law.exponents.items())


def exponent(value: Interval) -> str:
    """``0.77 ± 0.16``; the half-width is left out where there is none."""
    known = value.half_width == value.half_width
    return with_interval(value) if known else f"{value.mean:.2f}"


def _pairs(rows: pd.DataFrame, column: str) -> pd.DataFrame:
    return rows.pivot_table(column, WHICH, "variant", sort=False).dropna()


def range_text(values: pd.Series, pattern: str = ".2f") -> str:
    """``0.30 to 0.72``; one number where both ends read the same."""
    low, high = f"{values.min():{pattern}}", f"{values.max():{pattern}}"
    return low if low == high else f"{low} to {high}"


def table_claims(
    rows: pd.DataFrame,
    where: Literal["printed", "measured"],
    whose: str = "print",
    acceptable_risk: float = REMOVAL_RISK,
) -> list[Claim]:
    """The claims of 4.4 that the printed columns decide.

    Parameters
    ----------
    rows : DataFrame
        Of `printed_rows`, or of one run of `study.experiments.kidney_margins.run_kidney_margins`.
    where : {"printed", "measured"}
    whose : str
        Put after each claim; which run it is.
    acceptable_risk : float

    Returns
    -------
    list of Claim
        A claim about all margins holds when none is against it, and one that compares two exponents when the
        95 % interval of their difference is on its side of zero. Claims for which there are no rows, or whose
        exponents cannot be fitted since margins are empty, are left out.

    Raises
    ------
    InputError
        If there is no row.
    """
    if rows.empty:
        raise InputError("rows: expected at least one margin, got none")
    claims: list[Claim] = []

    def add(text: str, holds: bool, evidence: str) -> None:
        claims.append(Claim(f"{text} ({whose})", bool(holds), evidence, where))

    if {"SV", "CT"} <= set(rows["variant"]):
        pairs = _pairs(rows, VOLUME)
        grown = (pairs > 0).all(axis=1)  # two empty margins do not compare
        ratio = (pairs["SV"] / pairs["CT"])[grown]
        spread = _pairs(rows, SPREAD).reindex(pairs.index)[grown]
        if len(ratio):
            add(
                "Spatially varying margins are smaller than those of constant thickness",
                (ratio < 1).all(),
                f"in {(ratio < 1).sum()} of {len(ratio)}; {range_text(ratio)} times, "
                f"median {ratio.median():.2f}",
            )
            ratio = spread["SV"] / spread["CT"]
            add(
                "The final shell's distances scatter less for spatially varying margins",
                (ratio < 1).all(),
                f"in {(ratio < 1).sum()} of {len(ratio)}; {range_text(ratio)} times",
            )
    laws = {v: law_of(part) for v, part in rows.groupby("variant", sort=False)}
    laws = {v: law for v, law in laws.items() if law and law.difference}
    if laws:
        add(
            "The position error of the start changes the volume more than its rotation error",
            all(law.difference.low > 0 for law in laws.values()),
            "exponents " + "; ".join(f"{v} {exponents_text(law)}" for v, law in laws.items()),
        )
        series = {error: [0, 0] for error in ERRORS}
        for error, count in series.items():
            for _, part in rows.groupby("variant"):
                for k, number in enumerate(never_falls(part, VOLUME, error)):
                    count[k] += number
        add(
            "Margins never get smaller when either error of the start grows",
            all(rising == of for rising, of in series.values()),
            "in " + ", ".join(
                f"{rising} of {of} series of {name}"
                for (rising, of), name in zip(series.values(), ("position", "rotation"), strict=True)
            ),
        )  # fmt: skip
    above = rows[RISK] > acceptable_risk
    add(
        f"No final damage probability is above {acceptable_risk:g}",
        not above.any(),
        f"above in {above.sum()} of {len(rows)}; largest {rows[RISK].max():.2g}",
    )
    return claims


def own_claims(rows: pd.DataFrame, whose: str, acceptable_risk: float = REMOVAL_RISK) -> list[Claim]:
    """Claims that only rows of our own can decide, for one run.

    Parameters
    ----------
    rows : DataFrame
        Of one run of `study.experiments.kidney_margins.run_kidney_margins`.
    whose : str
        Which run it is.
    acceptable_risk : float
    """
    claims: list[Claim] = []

    def add(text: str, holds: bool, evidence: str) -> None:
        claims.append(Claim(f"{text} ({whose})", bool(holds), evidence, "measured"))

    known = rows.dropna(subset="validated_low")
    if len(known):
        above, wholly = known["validated_risk"] > acceptable_risk, known["validated_low"] > acceptable_risk
        add(
            "On fresh registrations no risk is above the acceptable one by more than chance",
            not wholly.any(),
            f"above in {above.sum()} of {len(known)}, with its whole 95 % interval in {wholly.sum()}; "
            f"largest {known['validated_risk'].max():.2g}",
        )
    empty = rows[VOLUME] == 0
    add("A margin is needed", not empty.any(), f"{empty.sum()} of {len(rows)} are empty")
    each = rows.drop_duplicates(WHICH)  # registrations are the same for both shapes
    add(
        "The fits converge",
        (each["converged_pct"] >= 99).all(),
        f"{range_text(each['converged_pct'], '.0f')} % of them, {range_text(each['iterations_mean'], '.0f')} "
        "iterations on average",
    )
    if len(each[list(ERRORS)].drop_duplicates()) > 1:
        spread = each.groupby("tumour")["scatter_mm"].agg(lambda part: part.max() / part.min())
        add(
            "Where registrations end does not depend on how wrong they start",
            (spread <= 1 + SAME_SCATTER).all(),
            f"rms scatter over the tumour {range_text(each['scatter_mm'])} mm, "
            f"largest over smallest up to {spread.max():.2f}",
        )
    return claims
