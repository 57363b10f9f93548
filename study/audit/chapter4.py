"""Findings about Tables 4.2 and B.1 to B.9 (E5, I15-I18, I23, I24, C4.1-C4.5)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy import stats

from study import published
from study.audit.findings import Check, Finding
from study.experiments.kidney_scaling import exponents_table

RISK, TIME = "final_damage_probability", "time_min"
_KEY = ["table", "tumour", "pos_std_mm", "rot_std_deg"]


def pairs() -> pd.DataFrame:
    """Return CT over SV of B.1 to B.9: 36 rows, columns ``<quantity>_sv`` and ``<quantity>_ct``."""
    table = published.appendix_b()
    sides = [
        table[table["variant"] == v].drop(columns="variant").set_index(_KEY).add_suffix(f"_{v.lower()}")
        for v in ("SV", "CT")
    ]
    return pd.concat(sides, axis=1).reset_index()


def volumes_are_not_cm3() -> Finding:
    """E5: the printed volumes as litres."""
    litres = published.appendix_b()["margin_volume_cm3"] / 1000
    checks = (
        Check("smallest margin as printed (litre)", "6.5", litres.min()),
        Check("largest margin as printed (litre)", "130", litres.max()),
        Check("tables with that unit", "10", _tables_with("margin_volume_cm3")),
    )
    remark = f"Read as mm^3 they are {litres.min():.3g} to {litres.max():.3g} cm^3."
    return Finding("E5", checks, remark=remark)


def risks_above_acceptable() -> Finding:
    """I23: final probabilities above 0.01."""
    table = published.appendix_b()
    acceptable, n = (
        published.parameter("acceptable_risk").value,
        published.parameter("n_r", section="4.3.1").value,
    )
    above = table[table[RISK] > acceptable]
    worst = above.loc[above[RISK].idxmax()]
    counts = above["variant"].value_counts()
    p_value = float(stats.binom.sf(round(worst[RISK] * n) - 1, n, acceptable))
    checks = (
        Check("entries", "72", len(table)),
        Check("entries above 0.01", "10", len(above)),
        Check("of these SV", "5", int(counts["SV"])),
        Check("of these CT", "5", int(counts["CT"])),
        Check("largest", "1.5e-2", worst[RISK]),
        Check(
            "it is tumour 4 CT of B.8", "yes", (worst.table, worst.tumour, worst.variant) == ("B.8", 4, "CT")
        ),
        Check("standard error of 0.01 at N_r = 5000", "0.0014", np.sqrt(acceptable * (1 - acceptable) / n)),
        Check("chance of the largest under 0.01", "5e-4", p_value),
    )
    return Finding("I23", checks, above.drop(columns="time_min"))


def registrations_per_margin() -> Finding:
    """I24: which numbers of registrations the printed probabilities can come from."""
    table = published.appendix_b()
    # below 0.01 two printed digits resolve 1e-4, so k/N shows
    fine = table[table[RISK] < 0.01].copy()
    units = (fine[RISK] * 1e4).round().astype(int)
    fine["fits_5000"], fine["fits_2000"] = units % 2 == 0, units % 5 == 0
    only_5000 = fine["fits_5000"] & ~fine["fits_2000"]
    neither = ~fine["fits_5000"] & ~fine["fits_2000"]
    checks = (
        Check("entries below 0.01", "33", len(fine)),
        Check("no multiple of 1/5000", "12", int((~fine["fits_5000"]).sum())),
        Check("multiples of 1/2000", "25", int(fine["fits_2000"].sum())),
        Check("multiples of 1/5000 alone", "8", int(only_5000.sum())),
        Check("multiples of neither", "0", int(neither.sum())),
        Check("chance of that with random last digits", "5e-8", 0.6 ** len(fine)),
    )
    columns = ["table", "tumour", "variant", RISK, "fits_5000", "fits_2000"]
    return Finding("I24", checks, fine[columns], "An inference, formed after looking at the digits.")


def tilt_within() -> Finding:
    """I15: 99.7 % of a normal angle with 5 degrees standard deviation."""
    sigma, claimed = (
        published.parameter("icp_init_rotation_std").value,
        published.parameter("claim_997_within").value,
    )
    three_sigma = 2 * stats.norm.sf(3)
    checks = (
        Check("99.7 % half-width, one axis (deg)", "15", sigma * stats.norm.isf(three_sigma / 2)),
        Check("claimed half-width in standard deviations", "6", claimed / sigma),
        Check("standard deviation the claim would need (deg)", "10", claimed / 3),
        Check("99.7 % radius, tilt about two axes (deg)", "17.0", sigma * np.sqrt(stats.chi2.ppf(0.997, 2))),
    )
    return Finding("I15", checks)


def unequal_risks() -> Finding:
    """I16: final risks at which the two shapes are compared."""
    table = pairs()
    quotient = table[f"{RISK}_ct"] / table[f"{RISK}_sv"]
    at = table.set_index(["table", "tumour"])[f"{RISK}_ct"]
    checks = (
        Check("CT / SV final risk, least", "0.07", quotient.min()),
        Check("CT / SV final risk, largest", "1.7", quotient.max()),
        Check("B.4 tumour 2 CT", "1e-3", at["B.4", 2]),
        Check("B.6 tumour 2 CT", "5e-4", at["B.6", 2]),
    )
    return Finding("I16", checks, table[[*_KEY, f"{RISK}_sv", f"{RISK}_ct"]].assign(ct_over_sv=quotient))


def one_run_is_wider() -> Finding:
    """I17: half-width of the mean of 50 runs and of one run."""
    p = published.parameter("acceptable_risk").value
    n, repeats = published.parameter("n_r", section="4.3.1").value, published.parameter("n_r_repeats").value
    bound = published.parameter("n_r_ci_bound").value

    def half(count: int, runs: int) -> float:
        return float(stats.norm.ppf(0.975) * np.sqrt(p * (1 - p) / count / runs))

    checks = (
        Check("5000 registrations, mean of 50 runs", "0.00039", half(n, repeats)),
        Check("5000 registrations, one run", "0.0028", half(n, 1)),
        Check("4000 registrations, mean of 50 runs", "0.00044", half(4000, repeats)),
        Check("4000 would also have met the bound", "yes", half(4000, repeats) < bound),
        Check("one run meets the bound", "no", half(n, 1) < bound),
    )
    return Finding("I17", checks)


def clinical_rates() -> Finding:
    """I18: acceptable risk against the two clinical rates."""
    rates = {
        k: published.parameter(f"benway_positive_margins_{k}").value for k in ("laparoscopic", "robotic")
    }
    share = {k: 100 * v["positive"] / v["cases"] for k, v in rates.items()}
    checks = (
        Check("laparoscopic (%)", "0.85", share["laparoscopic"]),
        Check("robotic (%)", "3.9", share["robotic"]),
    )
    return Finding("I18", checks)


def chapter_table_repeats_b1() -> Finding:
    """C4.1: Table 4.2 against B.1."""
    same = published.table("4.2", as_printed=True).eq(published.table("B.1", as_printed=True)).all(axis=1)
    return Finding("C4.1", (Check("equal rows", "8", int(same.sum())),))


def varying_margins_are_smaller() -> Finding:
    """C4.2: SV over CT volume."""
    table = pairs()
    quotient = table["margin_volume_cm3_sv"] / table["margin_volume_cm3_ct"]
    checks = (
        Check("pairs with a smaller SV margin", "36", int((quotient < 1).sum())),
        Check("SV / CT, least", "0.30", quotient.min()),
        Check("SV / CT, largest", "0.72", quotient.max()),
        Check("SV / CT, median", "0.54", quotient.median()),
    )
    return Finding("C4.2", checks, table[_KEY].assign(sv_over_ct=quotient))


def distances_spread_less() -> Finding:
    """C4.3: Mahalanobis distances of SV and CT margins."""
    table = pairs()
    spread = table["mahalanobis_std_sv"] / table["mahalanobis_std_ct"]
    mean = table["mahalanobis_mean_sv"] < table["mahalanobis_mean_ct"]
    checks = (
        Check("pairs with a smaller SV spread", "36", int((spread < 1).sum())),
        Check("SV / CT spread, least", "0.14", spread.min()),
        Check("SV / CT spread, largest", "0.90", spread.max()),
        Check("pairs with a smaller SV mean distance", "36", int(mean.sum())),
    )
    return Finding("C4.3", checks, table[_KEY].assign(sv_over_ct_spread=spread))


def growth_times() -> Finding:
    """C4.4: time to grow a margin."""
    table = pairs()
    shorter = table[f"{TIME}_sv"] < table[f"{TIME}_ct"]
    return Finding("C4.4", (Check("pairs with a shorter SV time", "22", int(shorter.sum())),))


def volume_exponents() -> pd.DataFrame:
    """Return how the margin volume goes with the errors of the start.

    Least squares of log volume on log position error, log rotation error and a level per tumour.
    Columns: ``variant, error, exponent, half_width_95``; ``monotone`` counts the series of three levels
    (other error and tumour fixed) that never fall, ``of`` is their number.
    """
    table = exponents_table(published.appendix_b(), ["margin_volume_cm3"])
    return table.drop(columns=["quantity", "tumours", "note"])


def position_matters() -> Finding:
    """C4.5: exponents of position and rotation error."""
    table = volume_exponents()
    stated = {
        ("SV", "pos_std_mm"): ("0.77", "0.16", "12"),
        ("SV", "rot_std_deg"): ("0.07", "0.16", "6"),
        ("CT", "pos_std_mm"): ("1.07", "0.22", "10"),
        ("CT", "rot_std_deg"): ("-0.03", "0.22", "3"),
    }
    checks = []
    for row in table.itertuples():
        exponent, half, monotone = stated[row.variant, row.error]
        what = f"{row.variant}, {'position' if row.error.startswith('pos') else 'rotation'}"
        checks.append(Check(f"{what}: exponent", exponent, row.exponent))
        checks.append(Check(f"{what}: +- of it", half, row.half_width_95))
        checks.append(Check(f"{what}: series that never fall, of {row.of}", monotone, row.monotone))
    return Finding("C4.5", tuple(checks), table)


def _tables_with(column: str) -> int:
    return int((published.codebook()["column"] == column).sum())
