"""Claims of chapter 2 that its tables bear out (C2.1-C2.10)."""

from __future__ import annotations

import pandas as pd
from scipy import stats

from study import published
from study.audit.chapter2 import (
    CONTACT,
    LEFT,
    LEFT_UNMODIFIED,
    MILLING,
    PER_STEP,
    PREDICTED,
    PREDICTED_TIME,
    RATIO,
    SIMULATION,
    SPEED,
    TIME,
    TRUE_TIME,
    VOLUME,
    rows,
)
from study.audit.findings import Check, Finding, rounds_to
from study.tables import paired_comparison, symmetric_percent_difference

_APPENDIX = ("A.1", "A.2", "A.3", "A.4")


def summary_table_repeats_appendix() -> Finding:
    """C2.1: Table 2.2 against the summary rows of A.1 to A.4, as printed text."""
    printed = published.table("2.2", as_printed=True)
    compared, equal = 0, 0
    for name, strategy, dof in zip(_APPENDIX, ("zigzag", "3d") * 2, "4455", strict=True):
        block = printed[(printed["planner"] == strategy) & (printed["dof"] == dof)].set_index("statistic")
        appendix = published.summary(name, as_printed=True)
        same = block[appendix.columns].loc[appendix.index] == appendix
        compared, equal = compared + same.size, equal + int(same.to_numpy().sum())
    checks = (Check("entries compared", "76", compared), Check("entries equal", "76", equal))
    return Finding("C2.1", checks)


def ratio_is_length_over_volume() -> Finding:
    """C2.2: the printed ratio lies where rounding of length and volume allows."""
    fitting, means = 0, 0
    for name in _APPENDIX:
        table, text = rows(name), published.table(name, as_printed=True)
        half = [0.5 if "." not in x else 0.05 for x in text[RATIO]]
        low = (table[PREDICTED] - 0.5) / (table[VOLUME] + 0.005) - half
        high = (table[PREDICTED] + 0.5) / (table[VOLUME] - 0.005) + half
        fitting += int(table[RATIO].between(low, high).sum())
        means += rounds_to(table[RATIO].mean(), published.summary(name, as_printed=True).loc["mean", RATIO])
    checks = (
        Check("rows with ratio = length / volume", "144", fitting),
        Check("tables whose mean is the mean of ratios", "4", means),
    )
    return Finding("C2.2", checks)


def strategies_share_targets() -> Finding:
    """C2.3: equal volumes within each pair of tables."""
    pairs = (("A.1", "A.2"), ("A.3", "A.4"))
    equal = [int((rows(a)[VOLUME] == rows(b)[VOLUME]).sum()) for a, b in pairs]
    checks = (
        Check("equal volumes in A.1 and A.2", "36", equal[0]),
        Check("equal volumes in A.3 and A.4", "36", equal[1]),
    )
    return Finding("C2.3", checks)


def speed_uses_milling_path() -> Finding:
    """C2.4: of the two lengths only the milling path gives the printed speed."""
    fits = {}
    for length in (MILLING, PREDICTED):
        table = pd.concat([rows("A.1"), rows("A.2")])
        low = 10 * (table[length] - 0.5) / (table[TIME] + 0.5) - 0.05
        high = 10 * (table[length] + 0.5) / (table[TIME] - 0.5) + 0.05
        fits[length] = int(table[SPEED].between(low, high).sum())
    checks = (
        Check("rows where the milling path gives the speed", "72", fits[MILLING]),
        Check("the predicted path gives it in all rows", "no", fits[PREDICTED] == 72),
    )
    remark = f"The predicted path would fit {fits[PREDICTED]} of 72 rows."
    return Finding("C2.4", checks, remark=remark)


def quoted_numbers_follow() -> Finding:
    """C2.5: percentages and means quoted in section 2.5.1."""
    zigzag, three_d = rows("A.1"), rows("A.2")
    changed = int((zigzag[MILLING] != zigzag[PREDICTED]).sum())

    def less(a: pd.Series, b: pd.Series) -> float:
        return 100 * (1 - a.mean() / b.mean())

    checks = (
        Check("3-D path shorter (%)", "9.1", less(three_d[PREDICTED], zigzag[PREDICTED])),
        Check("3-D milling time shorter (%)", "30.7", less(three_d[TIME], zigzag[TIME])),
        Check("3-D corners cut (%)", "8.5", less(three_d[MILLING], three_d[PREDICTED])),
        Check("zigzag corners cut (%)", "0.4", less(zigzag[MILLING], zigzag[PREDICTED])),
        Check("zigzag paths that change at all", "6", changed),
        Check("zigzag steps in contact (%)", "66", 100 * zigzag[CONTACT].mean()),
        Check("3-D steps in contact (%)", "8", 100 * three_d[CONTACT].mean()),
        Check("zigzag voxels per contact step", "8.0", zigzag[PER_STEP].mean()),
        Check("3-D voxels per contact step", "32.9", three_d[PER_STEP].mean()),
        Check("3-D simulation time (s)", "653", three_d[SIMULATION].mean()),
        Check("zigzag simulation time (s)", "133", zigzag[SIMULATION].mean()),
        Check("3-D 5-DOF simulation time (s)", "60592", rows("A.4")[SIMULATION].mean()),
    )
    return Finding("C2.5", checks)


def smallest_targets() -> Finding:
    """C2.6: the two bones that the text calls smallest."""
    smallest = rows("A.1")[VOLUME].nsmallest(2)
    checks = (Check("the two smallest are TB14 and TB10", "yes", list(smallest.index) == ["TB14", "TB10"]),)
    return Finding("C2.6", checks, smallest.reset_index())


def three_d_leaves_less() -> Finding:
    """C2.7: bone left behind, bone by bone."""
    checks, tied = [], 0
    for dof, zigzag, three_d in ((4, "A.1", "A.2"), (5, "A.3", "A.4")):
        for column, what in ((LEFT, "modified"), (LEFT_UNMODIFIED, "unmodified")):
            less, more = rows(three_d)[column], rows(zigzag)[column]
            tied += int((less == more).sum())
            checks.append(
                Check(f"bones with less left, {what} volume, {dof} DOF", "36", int((less < more).sum()))
            )
            checks.append(
                Check(f"bones with more left, {what} volume, {dof} DOF", "0", int((less > more).sum()))
            )
    remark = f"{tied} pairs are equal in the two printed digits, all of the unmodified volume."
    return Finding("C2.7", tuple(checks), remark=remark)


def paired_tests() -> Finding:
    """C2.8: the claims of shorter path and time with the right test."""
    zigzag, three_d = rows("A.1"), rows("A.2")
    path = paired_comparison(three_d[PREDICTED], zigzag[PREDICTED])
    time = paired_comparison(three_d[TIME], zigzag[TIME])
    checks = (
        Check("path, p of the paired t test", "3e-5", path.p_value),
        Check("time, p of the paired t test", "2e-12", time.p_value),
        Check("bones with a shorter 3-D time", "35", time.wins),
    )
    evidence = pd.DataFrame(
        {
            "quantity": ["path (printed unit)", "time (s)"],
            "mean_difference": [path.difference.mean, time.difference.mean],
            "half_width_95": [path.difference.half_width, time.difference.half_width],
        }
    )
    remark = f"The p of the times is {time.p_value:.2e}; {checks[1].stated} was stated earlier."
    return Finding("C2.8", checks, evidence, remark)


def prediction_errors_differ() -> Finding:
    """C2.9: Welch's test between the two groups of Table 2.3."""
    table = published.table("2.3")
    predicted = table.apply(lambda row: row[PREDICTED_TIME[row["milled_with"]]], axis=1)
    difference = pd.Series(symmetric_percent_difference(table[TRUE_TIME], predicted))
    groups = [difference[table["milled_with"] == k] for k in ("zigzag", "3d")]
    p_value = float(stats.ttest_ind(*groups, equal_var=False).pvalue)
    return Finding("C2.9", (Check("p of Welch's test", "1e-5", p_value),))


def small_arithmetic() -> Finding:
    """C2.10: products that the text gives."""
    per_axis = published.parameter("dof5_shafts_per_axis").value
    reach = published.parameter("supervoxel_reach").value * published.parameter("voxel_size").value
    checks = (
        Check("18 x 18 shafts", "324", per_axis**2),
        Check("reach of a supervoxel (mm)", "1.0", reach),
    )
    return Finding("C2.10", checks)
