"""Findings about Tables 2.2, 2.3 and A.1 to A.4 that the tables alone decide (E1-E4, T0)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy import stats

from study import published
from study.audit.findings import Check, Finding, printed_step, rounds_to
from study.tables import symmetric_percent_difference, t_interval

PREDICTED, MILLING = "predicted_path_length_mm", "milling_path_length_mm"
VOLUME, TIME = "modified_initial_target_cm3", "predicted_milling_time_s"
SPEED, RATIO = "average_milling_speed_mm_per_s", "path_length_over_volume_mm_per_cm3"
CONTACT = "steps_in_contact_over_path_length_ratio"
PER_STEP = "average_voxels_per_step_in_contact_voxels"
LEFT, LEFT_UNMODIFIED = "modified_final_over_initial_ratio", "unmodified_final_over_initial_ratio"
SIMULATION = "simulation_time_s"
PREDICTED_TIME = {"zigzag": "predicted_milling_time_zigzag_s", "3d": "predicted_milling_time_3d_s"}
TRUE_TIME = "true_milling_time_s"


def rows(name: str) -> pd.DataFrame:
    """Return a printed table indexed by specimen."""
    return published.table(name).set_index("specimen")


def corrected_intervals() -> pd.DataFrame:
    """Return the right 95 % intervals of Tables A.1 to A.4 (and so 2.2) beside the printed numbers.

    Columns: ``table, column, n, mean, standard_deviation, t_half_width, normal_half_width, scaled_mean``
    (mean x 1.96/6), ``mean_slack`` (how far rounding of the rows may have moved the mean),
    ``printed_mean, printed_plus_minus`` (text) and ``printed_over_t``.
    """
    found = []
    for name in ("A.1", "A.2", "A.3", "A.4"):
        values, printed = rows(name), published.summary(name, as_printed=True)
        text = published.table(name, as_printed=True)
        for column in values:
            interval = t_interval(values[column])
            deviation = values[column].std(ddof=1)
            plus_minus = printed.loc["plus_minus", column]
            # a column that is constant in print has no width to divide by
            ratio = float(plus_minus) / interval.half_width if interval.half_width else np.nan
            found.append(
                {
                    "table": name,
                    "column": column,
                    "n": interval.n,
                    "mean": interval.mean,
                    "standard_deviation": deviation,
                    "t_half_width": interval.half_width,
                    "normal_half_width": stats.norm.ppf(0.975) * deviation / np.sqrt(interval.n),
                    "scaled_mean": interval.mean * 1.96 / 6,
                    "mean_slack": np.mean([printed_step(entry) / 2 for entry in text[column]]),
                    "printed_mean": printed.loc["mean", column],
                    "printed_plus_minus": plus_minus,
                    "printed_over_t": ratio,
                }
            )
    return pd.DataFrame(found)


def intervals_are_scaled_means() -> Finding:
    """E1: the printed intervals are the mean times 1.96/6."""
    table = corrected_intervals()
    printed = table["printed_plus_minus"].astype(float)
    near = {
        kind: int((abs(printed - table[kind]) <= 0.05 * table[kind]).sum() - (table[kind] == 0).sum())
        for kind in ("t_half_width", "normal_half_width")
    }
    ratio = table["printed_over_t"].dropna()
    half_step = table["printed_plus_minus"].map(printed_step) / 2
    gap = abs(table["scaled_mean"] - printed)
    explained = gap <= (half_step + table["mean_slack"] * 1.96 / 6) * (1 + 1e-9)
    direct = _fitting(table["scaled_mean"], table["printed_plus_minus"])

    def width(name: str, column: str) -> float:
        return float(table.set_index(["table", "column"]).loc[(name, column), "t_half_width"])

    checks = (
        Check("columns with a +-", "38", len(table)),
        Check("means that follow from the rows", "38", _fitting(table["mean"], table["printed_mean"])),
        Check("+- equal to mean x 1.96/6, within rounding of the rows", "38", int(explained.sum())),
        Check("+- within 5 % of a t interval", "0", near["t_half_width"]),
        Check("+- within 5 % of a normal interval", "0", near["normal_half_width"]),
        Check("smallest printed / correct", "0.30", ratio.min()),
        Check("largest printed / correct", "22.1", ratio.max()),
        Check("median printed / correct", "2.3", ratio.median()),
        Check("printed too narrow or zero", "5", int((ratio < 1).sum() + (printed == 0).sum())),
        Check("zigzag path, correct +- (as printed)", "103", width("A.1", PREDICTED)),
        Check("3-D path, correct +- (as printed)", "78", width("A.2", PREDICTED)),
        Check("zigzag time, correct +- (s)", "281", width("A.1", TIME)),
        Check("3-D time, correct +- (s)", "176", width("A.2", TIME)),
        Check("zigzag speed, correct +- (mm/s)", "0.063", width("A.1", SPEED)),
        Check("zigzag contact share, correct +-", "0.010", width("A.1", CONTACT)),
        Check("3-D voxels per step, correct +-", "1.19", width("A.2", PER_STEP)),
        Check("zigzag share left, correct +-", "1.4e-2", width("A.1", LEFT)),
        Check("3-D share left, correct +-", "1.8e-4", width("A.2", LEFT)),
    )
    time = width("A.2", TIME)
    remark = (
        f"From the means of the rounded rows {direct} of {len(table)} columns match; the others are shares "
        f"left, with two digits a row. {time:.2f} s rounds to {time:.0f} s; the number stated was cut."
    )
    return Finding("E1", checks, table, remark)


def lengths_are_centimetres() -> Finding:
    """E2: speed x time / length is ten, and other reasons why the lengths are centimetres."""
    table = pd.concat([rows(name).assign(table=name) for name in ("A.1", "A.2")])
    low, high = _factor_bounds(table)
    table = table.assign(
        speed_times_time_over_length=table[SPEED] * table[TIME] / table[MILLING],
        length_over_time=table[MILLING] / table[TIME],
        sweep_length_mm=table[VOLUME] * 1000 / 4,  # a row of 2 mm x 2 mm must pass the whole volume
    )
    factor, speed = table["speed_times_time_over_length"], table["length_over_time"]
    slowest = published.parameter("burr_speed_min").value
    fastest = published.parameter("burr_speed_max").value
    short = (table[PREDICTED] < table["sweep_length_mm"]).groupby(table["table"]).sum()
    true = published.table("2.3")
    predicted = np.where(
        true["milled_with"] == "3d", true[PREDICTED_TIME["3d"]], true[PREDICTED_TIME["zigzag"]]
    )
    excess = 100 * (true[TRUE_TIME] / predicted - 1)
    checks = (
        Check("smallest speed x time / length", "9.86", factor.min()),
        Check("largest speed x time / length", "10.13", factor.max()),
        Check("mean speed x time / length", "10.01", factor.mean()),
        Check("rows where rounding allows 10", "72", int(((low <= 10) & (high >= 10)).sum())),
        Check("rows where rounding allows 1", "0", int(((low <= 1) & (high >= 1)).sum())),
        Check("slowest length / time (as printed)", "0.33", speed.min()),
        Check("fastest length / time (as printed)", "0.49", speed.max()),
        Check("rows slower than the least feed", "72", int((speed < slowest).sum())),
        Check("rows in the feed range after x 10", "72", int((10 * speed).between(slowest, fastest).sum())),
        Check("least excess of a real milling (%)", "4.6", excess.min()),
        Check("largest excess of a real milling (%)", "10.9", excess.max()),
        Check("zigzag lengths too short to sweep the volume", "27", int(short["A.1"])),
        Check("3-D lengths too short to sweep the volume", "29", int(short["A.2"])),
    )
    columns = ["table", VOLUME, PREDICTED, MILLING, SPEED, TIME]
    columns += ["speed_times_time_over_length", "length_over_time", "sweep_length_mm"]
    return Finding("E2", checks, table[columns].reset_index())


def milled_intervals_have_one_multiple() -> Finding:
    """E3: the +- of Table 2.3 is one multiple of the mean for both groups."""
    table, printed = published.table("2.3"), published.summary("2.3")
    times = [*PREDICTED_TIME.values(), TRUE_TIME]
    table["symmetric_difference_pct"] = symmetric_percent_difference(
        table[TRUE_TIME], table.apply(lambda row: row[PREDICTED_TIME[row["milled_with"]]], axis=1)
    )
    found = []
    for strategy, group in table.groupby("milled_with"):
        for column in [VOLUME, *times, "symmetric_difference_pct"]:
            interval = t_interval(group[column])
            source = "pct_diff_predicted_actual_pct" if column.startswith("symmetric") else column
            plus_minus = printed.loc[(strategy, "plus_minus"), source]
            half = 0.5 if column in times else 0.05
            found.append(
                {
                    "milled_with": strategy,
                    "column": column,
                    "n": interval.n,
                    "mean": interval.mean,
                    "t_half_width": interval.half_width,
                    "printed_plus_minus": plus_minus,
                    "multiple_low": (plus_minus - half) / interval.mean,
                    "multiple_high": (plus_minus + half) / interval.mean,
                    "correct_over_printed": interval.half_width / plus_minus,
                }
            )
    evidence = pd.DataFrame(found)
    of_times = evidence[evidence["column"].isin(times)]
    low, high = of_times["multiple_low"].max(), of_times["multiple_high"].min()
    at = evidence.set_index(["milled_with", "column"])
    narrow = evidence[evidence["column"].isin([VOLUME, TRUE_TIME])]["correct_over_printed"]
    width, mean = at["t_half_width"], at["mean"]
    checks = (
        Check("smallest multiple the six time columns allow", "0.07686", low),
        Check("largest multiple the six time columns allow", "0.07702", high),
        Check("least N of 1.96/sqrt(N)", "648", float(np.ceil((1.96 / high) ** 2))),
        Check("largest N of 1.96/sqrt(N)", "650", float(np.floor((1.96 / low) ** 2))),
        Check("1/13 lies inside", "yes", bool(low <= 1 / 13 <= high)),
        Check(
            "1.96/sqrt of 7, 8, 15 or 36 lies inside",
            "no",
            any(low <= 1.96 / np.sqrt(n) <= high for n in (7, 8, 15, 36)),
        ),
        Check("zigzag true time, correct +- (s)", "1032", width["zigzag", TRUE_TIME]),
        Check("3-D true time, correct +- (s)", "329", width["3d", TRUE_TIME]),
        Check("zigzag volume, correct +- (cm^3)", "1.8", width["zigzag", VOLUME]),
        Check("3-D volume, correct +- (cm^3)", "0.8", width["3d", VOLUME]),
        Check("zigzag difference (%)", "5.3", mean["zigzag", "symmetric_difference_pct"]),
        Check("zigzag difference, correct +- (%)", "0.7", width["zigzag", "symmetric_difference_pct"]),
        Check("3-D difference (%)", "8.6", mean["3d", "symmetric_difference_pct"]),
        Check("3-D difference, correct +- (%)", "0.9", width["3d", "symmetric_difference_pct"]),
        Check("volumes and true times: least correct / printed", "3.6", narrow.min()),
        Check("volumes and true times: largest correct / printed", "5.9", narrow.max()),
    )
    return Finding("E3", checks, evidence)


def last_cadaver_rows_differ() -> Finding:
    """E4: CH19 of A.3 and A.4 is CH17 of A.1 and A.2."""
    four, five = rows("A.1"), rows("A.3")
    smaller, equal = five[VOLUME] <= four[VOLUME], five[VOLUME] == four[VOLUME]
    exception = list(five.index[~smaller])
    shared = [column for column in five if column != SIMULATION]
    # every bone of A.1 against CH19 of A.3: how far apart in the worst column
    apart = (abs(four[shared] / five.loc["CH19", shared] - 1)).max(axis=1)
    nearest = {"A.3": str(apart.idxmin())}
    apart_3d = (abs(rows("A.2")[shared] / rows("A.4").loc["CH19", shared] - 1))[
        [PREDICTED, VOLUME, LEFT_UNMODIFIED]
    ]
    nearest["A.4"] = str(apart_3d.max(axis=1).idxmin())
    last = ["CH17", "CH18", "CH19"]
    evidence = pd.concat({f"{name}": rows(name).loc[last, shared] for name in ("A.1", "A.3", "A.2", "A.4")})
    checks = (
        Check("rows with a 5-DOF volume not above the 4-DOF one", "35", int(smaller.sum())),
        Check("rows with equal volumes", "18", int(equal.sum())),
        Check("the exception is CH19", "yes", exception == ["CH19"]),
        Check("volume of CH19 with 4 DOF (cm^3)", "1.51", four.loc["CH19", VOLUME]),
        Check("volume of CH19 with 5 DOF (cm^3)", "4.38", five.loc["CH19", VOLUME]),
        Check("nearest row of A.1 to CH19 of A.3 is CH17", "yes", nearest["A.3"] == "CH17"),
        Check("nearest row of A.2 to CH19 of A.4 is CH17", "yes", nearest["A.4"] == "CH17"),
        Check(
            "rows CH17, CH18 with 5 DOF are a permutation of CH18, CH19 with 4 DOF",
            "no",
            set(five.loc[last[:2], VOLUME]) == set(four.loc[last[1:], VOLUME]),
        ),
    )
    return Finding("E4", checks, evidence.rename_axis(["table", "specimen"]).reset_index())


def tables_fit_together() -> Finding:
    """T0: numbers of rows, their order, the predicted times that stand in two tables."""
    names = [f"CH{k:02d}" for k in range(1, 20)] + [f"TB{k:02d}" for k in range(1, 18)]
    milled, zigzag, three_d = rows("2.3"), rows("A.1"), rows("A.2")
    repeated = (milled[PREDICTED_TIME["zigzag"]] == zigzag.loc[milled.index, TIME]).sum()
    repeated += (milled[PREDICTED_TIME["3d"]] == three_d.loc[milled.index, TIME]).sum()
    counts = {name: len(published.table(name)) for name in published.tables()}
    ordered = sum(list(rows(f"A.{k}").index) == names for k in range(1, 5))
    missing = published.parameters()["value"].isna().sum()
    checks = (
        Check("appendix A tables with the 36 names in order", "4", ordered),
        Check("rows of 2.3", "15", counts["2.3"]),
        Check("rows of 3.2", "20", counts["3.2"]),
        Check("rows of B.1 to B.9", "72", len(published.appendix_b())),
        Check("predicted times of 2.3 that stand in A.1 or A.2", "30", int(repeated)),
        Check("settings and claims on record", "152", len(published.parameters())),
        Check("settings on record without a value (R_s, T_r)", "2", int(missing)),
    )
    remark = "The comparison with the text, character by character, needs the text and is not repeated here."
    return Finding("T0", checks, pd.DataFrame({"table": counts.keys(), "rows": counts.values()}), remark)


def _factor_bounds(table: pd.DataFrame) -> tuple[pd.Series, pd.Series]:
    """Return how small and how large speed x time / length may be before rounding."""
    low = (table[SPEED] - 0.05) * (table[TIME] - 0.5) / (table[MILLING] + 0.5)
    high = (table[SPEED] + 0.05) * (table[TIME] + 0.5) / (table[MILLING] - 0.5)
    return low, high


def _fitting(values: pd.Series, printed: pd.Series) -> int:
    return sum(rounds_to(value, text) for value, text in zip(values, printed, strict=True))
