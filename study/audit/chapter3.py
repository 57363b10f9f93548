"""Findings about Table 3.2 (I10-I14, C3.1-C3.4)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy import stats

from study import published
from study.audit.findings import Check, Finding, printed_step

VOLUME, RISK = "safety_margin_volume_mm3", "final_damage_probability"
DISTANCE, SPREAD = "mahalanobis_mean", "mahalanobis_std"
SCANS = 5


def rows() -> pd.DataFrame:
    """Return Table 3.2 with the acceptable risk of section 3.3.1 in column ``acceptable``."""
    table = published.table("3.2")
    acceptable = {s: published.parameter(f"acceptable_risk_{s}").value for s in table["structure"].unique()}
    return table.assign(acceptable=table["structure"].map(acceptable))


def pairs(column: str) -> pd.DataFrame:
    """Return SV beside UT, a row per structure and voxel size, for one column without its ending.

    Columns: ``structure, voxel_size_mm, sv, sv_plus_minus, ut, ut_plus_minus, change_pct`` (SV against UT)
    and ``disjoint`` (whether the printed intervals do not overlap).
    """
    table = published.table("3.2").set_index(["structure", "voxel_size_mm", "variant"])
    found = pd.DataFrame(
        {
            f"{variant.lower()}{ending}": table.xs(variant, level="variant")[f"{column}{source}"]
            for variant in ("SV", "UT")
            for ending, source in (("", "_mean"), ("_plus_minus", "_plus_minus"))
        }
    )
    found["change_pct"] = 100 * (found["sv"] / found["ut"] - 1)
    found["disjoint"] = abs(found["sv"] - found["ut"]) > found["sv_plus_minus"] + found["ut_plus_minus"]
    return found.reset_index()


def largest_deviation(mean: float, top: float, n: int = SCANS) -> float:
    """Return the largest sample standard deviation of n numbers in [0, top] with a given mean.

    It is reached with as many numbers as possible at `top`, one between, the rest at zero.

    Parameters
    ----------
    mean, top : float
        ``0 <= mean <= top``.
    n : int
        Number of values.
    """
    at_top = min(int(n * mean / top + 1e-12), n)
    values = np.zeros(n)
    values[:at_top] = top
    if at_top < n:
        values[at_top] = n * mean - at_top * top
    return float(values.std(ddof=1))


def intervals_are_student() -> Finding:
    """C3.1: which meaning of +- keeps all probabilities between 0 and the acceptable one."""
    table, text = rows(), published.table("3.2", as_printed=True)
    t = stats.t.ppf(0.975, SCANS - 1)
    factors = {"t": np.sqrt(SCANS) / t, "normal": np.sqrt(SCANS) / stats.norm.ppf(0.975), "deviation": 1.0}
    found = []
    for row, printed in zip(table.itertuples(), text.itertuples(), strict=True):
        mean_step = printed_step(getattr(printed, f"{RISK}_mean")) / 2
        step = printed_step(getattr(printed, f"{RISK}_plus_minus")) / 2
        mean, plus_minus = getattr(row, f"{RISK}_mean"), getattr(row, f"{RISK}_plus_minus")
        means = np.clip([mean - mean_step, mean, mean + mean_step], 0, row.acceptable)
        bound = max(largest_deviation(m, row.acceptable) for m in means)
        deviations = {f"deviation_if_{k}": plus_minus * f for k, f in factors.items()}
        possible = {f"possible_if_{k}": (plus_minus - step) * f <= bound for k, f in factors.items()}
        label = (row.structure, row.variant, row.voxel_size_mm)
        found.append((*label, mean, plus_minus, bound, *deviations.values(), *possible.values()))
    columns = ["structure", "variant", "voxel_size_mm", "mean", "plus_minus", "largest_deviation"]
    evidence = pd.DataFrame(found, columns=columns + list(deviations) + list(possible))
    chorda = evidence[(evidence["structure"] == "chorda_tympani") & (evidence["voxel_size_mm"] == 0.4)].iloc[
        0
    ]
    checks = (
        Check("entries impossible as normal intervals", "9", int((~evidence["possible_if_normal"]).sum())),
        Check(
            "entries impossible as standard deviations", "7", int((~evidence["possible_if_deviation"]).sum())
        ),
        Check("entries possible as t intervals", "20", int(evidence["possible_if_t"].sum())),
        Check("chorda tympani SV 0.4 mm: deviation if t", "0.0217", chorda["deviation_if_t"]),
        Check("chorda tympani SV 0.4 mm: deviation if normal", "0.0307", chorda["deviation_if_normal"]),
        Check(
            "chorda tympani SV 0.4 mm: largest possible", "0.0221", largest_deviation(chorda["mean"], 0.05)
        ),
        Check("lower limits below zero", "8", int((evidence["mean"] < evidence["plus_minus"]).sum())),
    )
    return Finding("C3.1", checks, evidence, "An inference: the rows of the five scans are not printed.")


def facial_nerve_counts() -> Finding:
    """C3.2: the facial-nerve means as counts of 5 x 25 000 registrations."""
    table = rows()
    nerve = table[table["structure"] == "facial_nerve"]
    n = SCANS * published.parameter("n_r", section="3.3.1").value
    counts = nerve[f"{RISK}_mean"] * n
    stated = ("82", "58", "86", "77")
    checks = tuple(
        Check(f"{row.variant} {row.voxel_size_mm} mm: registrations with damage", text, count)
        for row, text, count in zip(nerve.itertuples(), stated, counts.round(9), strict=True)
    )
    whole = bool(np.allclose(counts, counts.round(), atol=1e-6))
    return Finding("C3.2", (*checks, Check("all are whole numbers", "yes", whole)))


def distances_spread_less() -> Finding:
    """C3.3: spread of the distances and final risks."""
    spread, table = pairs(SPREAD), rows()
    wide = table.pivot_table(index=["structure", "variant"], columns="voxel_size_mm", values=f"{SPREAD}_mean")
    checks = (
        Check("pairs with a smaller SV spread", "10", int((spread["sv"] < spread["ut"]).sum())),
        Check("of these with disjoint intervals", "9", int(spread["disjoint"].sum())),
        Check("spreads smaller after upsampling", "10", int((wide[0.2] < wide[0.4]).sum())),
        Check("mean risks acceptable", "20", int((table[f"{RISK}_mean"] <= table["acceptable"]).sum())),
    )
    return Finding("C3.3", checks, spread)


def fle_per_axis() -> Finding:
    """C3.4: FLE per axis."""
    value = published.parameter("fle_rms").value / np.sqrt(3)
    return Finding("C3.4", (Check("0.176 / sqrt(3) (mm)", "0.1016", value),))


def smaller_margins() -> Finding:
    """I10: where spatially varying margins are the smaller ones."""
    table = pairs(VOLUME)
    at = table.set_index(["structure", "voxel_size_mm"])["change_pct"]
    smaller = table["change_pct"] < 0
    fine = table[table["voxel_size_mm"] == 0.2]
    against = table[table["disjoint"] & ~smaller]["structure"].tolist()
    checks = (
        Check("chorda tympani, 0.4 mm (%)", "45", at["chorda_tympani", 0.4]),
        Check("external auditory canal, 0.4 mm (%)", "23", at["external_auditory_canal", 0.4]),
        Check("internal auditory canal, 0.4 mm (%)", "2", at["internal_auditory_canal", 0.4]),
        Check("facial nerve, 0.4 mm (%)", "-13", at["facial_nerve", 0.4]),
        Check("sigmoid sinus, 0.4 mm (%)", "-2", at["sigmoid_sinus", 0.4]),
        Check("0.2 mm, least reduction (%)", "-7", fine["change_pct"].max()),
        Check("0.2 mm, largest reduction (%)", "-14", fine["change_pct"].min()),
        Check("0.2 mm, pairs with disjoint intervals", "0", int(fine["disjoint"].sum())),
        Check("pairs with a smaller SV margin", "7", int(smaller.sum())),
        Check("pairs with disjoint intervals", "1", int(table["disjoint"].sum())),
        Check(
            "the disjoint pair is chorda tympani and goes against the claim",
            "yes",
            against == ["chorda_tympani"],
        ),
    )
    external = at["external_auditory_canal", 0.4]
    remark = f"External auditory canal at 0.4 mm: {external:.1f} %, though the intervals overlap."
    return Finding("I10", checks, table, remark)


def point_risks() -> Finding:
    """I11: point damage risk at the mean distance, a lower bound of the mean risk (the curve is convex)."""
    table = rows()
    table["point_risk"] = stats.chi2.sf(table[f"{DISTANCE}_mean"] ** 2, 3)
    at = table.set_index(["structure", "variant", "voxel_size_mm"])["point_risk"]
    named = {
        ("chorda_tympani", "SV"): "3e-4",
        ("external_auditory_canal", "SV"): "2e-4",
        ("internal_auditory_canal", "SV"): "3e-5",
        ("chorda_tympani", "UT"): "3e-5",
        ("external_auditory_canal", "UT"): "2e-5",
        ("sigmoid_sinus", "SV"): "5e-6",
    }
    others = [risk for (s, v, size), risk in at.items() if size == 0.2 and (s, v) not in named]
    coarse = table[table["voxel_size_mm"] == 0.4]["point_risk"]
    # the tail of a chi variable with three degrees of freedom is convex beyond sqrt(2)
    convex = table[f"{DISTANCE}_mean"].min() > np.sqrt(2)
    checks = (
        *(Check(f"{s.replace('_', ' ')} {v}, 0.2 mm", text, at[s, v, 0.2]) for (s, v), text in named.items()),
        Check("the other 0.2 mm entries are at or below 1e-6", "yes", max(others) < 1.5e-6),
        Check("0.4 mm entries at or below 1e-7 (one digit)", "10", int((coarse < 1.5e-7).sum())),
        Check("all distances lie where the curve is convex", "yes", bool(convex)),
    )
    columns = ["structure", "variant", "voxel_size_mm", f"{DISTANCE}_mean", "point_risk"]
    return Finding("I11", checks, table[columns])


def upsampled_risks() -> Finding:
    """I12: final over acceptable risk before and after upsampling."""
    table = rows()
    table["of_acceptable"] = table[f"{RISK}_mean"] / table["acceptable"]
    wide = table.pivot_table(index=["structure", "variant"], columns="voxel_size_mm", values="of_acceptable")
    two = wide.loc[["chorda_tympani", "external_auditory_canal"]]
    checks = (
        Check("chorda and external canal, 0.4 mm, least", "0.14", two[0.4].min()),
        Check("chorda and external canal, 0.4 mm, largest", "0.41", two[0.4].max()),
        Check("chorda and external canal, 0.2 mm, least", "0.74", two[0.2].min()),
        Check("chorda and external canal, 0.2 mm, largest", "0.97", two[0.2].max()),
        Check("facial nerve SV, 0.4 mm", "0.66", wide.loc[("facial_nerve", "SV"), 0.4]),
        Check("facial nerve SV, 0.2 mm", "0.69", wide.loc[("facial_nerve", "SV"), 0.2]),
        Check("facial nerve UT, 0.4 mm", "0.46", wide.loc[("facial_nerve", "UT"), 0.4]),
        Check("facial nerve UT, 0.2 mm", "0.62", wide.loc[("facial_nerve", "UT"), 0.2]),
        Check("sigmoid sinus UT, 0.4 mm", "0.51", wide.loc[("sigmoid_sinus", "UT"), 0.4]),
        Check("sigmoid sinus UT, 0.2 mm", "0.34", wide.loc[("sigmoid_sinus", "UT"), 0.2]),
    )
    evidence = (
        wide.rename(columns={0.2: "at_0_2_mm", 0.4: "at_0_4_mm"}).rename_axis(columns=None).reset_index()
    )
    internal = wide.loc["internal_auditory_canal"]
    remark = (
        f"Internal auditory canal: SV {internal.loc['SV', 0.4]:.2f} to {internal.loc['SV', 0.2]:.2f}, "
        f"UT {internal.loc['UT', 0.4]:.2f} to {internal.loc['UT', 0.2]:.2f}; "
        f"sigmoid sinus SV {wide.loc[('sigmoid_sinus', 'SV'), 0.4]:.2f} to "
        f"{wide.loc[('sigmoid_sinus', 'SV'), 0.2]:.2f}: these come closer too."
    )
    return Finding("I12", checks, evidence, remark)


def three_decimals() -> Finding:
    """I13: half-width of a risk counted in 25 000 registrations."""
    n = published.parameter("n_r", section="3.3.1").value
    stated = {0.001: "0.0004", 0.01: "0.0012", 0.05: "0.0027"}
    half = {p: float(stats.norm.ppf(0.975) * np.sqrt(p * (1 - p) / n)) for p in stated}
    checks = tuple(Check(f"95 % half-width at {p}", text, half[p]) for p, text in stated.items())
    good = [p for p in half if half[p] < 0.0005]
    return Finding("I13", (*checks, Check("three decimals only at 0.001", "yes", good == [0.001])))


def row_labels() -> Finding:
    """I14: the row labels that lack the acceptable risk."""
    table = published.table("3.2")
    missing = table[table["acceptable_probability_in_row_label"].isna()]["structure"].unique().tolist()
    checks = (
        Check("only the internal auditory canal lacks it", "yes", missing == ["internal_auditory_canal"]),
    )
    return Finding("I14", checks, remark="The other name in the last structure's label is read in the text.")
