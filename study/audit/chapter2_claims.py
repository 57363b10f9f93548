"""Sentences of chapter 2 that its own tables do not bear out (I1-I9, I25)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy import stats

from study import published
from study.audit.chapter2 import (
    CONTACT,
    LEFT,
    MILLING,
    PER_STEP,
    PREDICTED,
    PREDICTED_TIME,
    SIMULATION,
    SPEED,
    TIME,
    TRUE_TIME,
    VOLUME,
    rows,
)
from study.audit.findings import Check, Finding, rounds_to
from study.tables import symmetric_percent_difference, t_interval


def contact_columns_disagree() -> Finding:
    """I1: length x contact share x voxels per step should be the bone removed, for both strategies."""
    zigzag, three_d = rows("A.1"), rows("A.2")
    product = {
        "zigzag": zigzag[PREDICTED] * zigzag[CONTACT] * zigzag[PER_STEP],
        "3d": three_d[PREDICTED] * three_d[CONTACT] * three_d[PER_STEP],
    }
    quotient = product["zigzag"] / product["3d"]
    generous = product["zigzag"] / (three_d[PREDICTED] * (three_d[CONTACT] + 0.005) * three_d[PER_STEP])
    step, voxel = published.parameter("voxel_size").value, published.parameter("voxel_size").value ** 3
    removed = {k: t[VOLUME] * 1000 * (1 - t[LEFT]) for k, t in (("zigzag", zigzag), ("3d", three_d))}
    # steps of one voxel along ten times the printed length, against the mm^3 that the strategy removes
    share = {k: p * 10 / step * voxel / removed[k] for k, p in product.items()}
    evidence = pd.DataFrame(
        {
            "zigzag_over_3d": quotient,
            "zigzag_counted_over_removed": share["zigzag"],
            "3d_counted_over_removed": share["3d"],
        }
    )
    checks = (
        Check("zigzag / 3-D product, mean", "2.16", quotient.mean()),
        Check("zigzag / 3-D product, least", "1.43", quotient.min()),
        Check("zigzag / 3-D product, largest", "2.71", quotient.max()),
        Check("least with the contact share rounded up", "1.35", generous.min()),
        Check("3-D: counted / removed bone", "0.94", share["3d"].mean()),
        Check("zigzag: counted / removed bone", "2.05", share["zigzag"].mean()),
        Check("3-D: counted / removed bone if lengths were mm", "0.09", share["3d"].mean() / 10),
        Check("zigzag: counted / removed bone if lengths were mm", "0.21", share["zigzag"].mean() / 10),
    )
    return Finding("I1", checks, evidence.reset_index())


def faster_zigzag_leaves_bone() -> Finding:
    """I2: TB14 is faster with zigzag because a quarter of the target stays."""
    zigzag, three_d = rows("A.1"), rows("A.2")
    per_removed = {k: t[TIME] / (t[VOLUME] * (1 - t[LEFT])) for k, t in (("zigzag", zigzag), ("3d", three_d))}
    left = zigzag[LEFT]
    evidence = pd.DataFrame(
        {
            "zigzag_time_s": zigzag[TIME],
            "3d_time_s": three_d[TIME],
            "zigzag_share_left": left,
            "3d_share_left": three_d[LEFT],
            "zigzag_s_per_removed_cm3": per_removed["zigzag"],
            "3d_s_per_removed_cm3": per_removed["3d"],
        }
    )
    checks = (
        Check("zigzag faster by (s)", "66", three_d.loc["TB14", TIME] - zigzag.loc["TB14", TIME]),
        Check("share left, zigzag", "0.25", left["TB14"]),
        Check("share left, 3-D", "6.5e-5", three_d.loc["TB14", LEFT]),
        Check("zigzag per cm^3 removed (s)", "795", per_removed["zigzag"]["TB14"]),
        Check("3-D per cm^3 removed (s)", "663", per_removed["3d"]["TB14"]),
        Check("share of the mean zigzag residual that is TB14", "0.54", left["TB14"] / left.sum()),
        Check("mean zigzag residual without TB14", "6.1e-3", left.drop("TB14").mean()),
    )
    return Finding("I2", checks, evidence.reset_index())


def simulation_time_is_milling_time() -> Finding:
    """I3: the 230 s of TB10 are a difference of predicted milling times."""
    zigzag, three_d = rows("A.1").loc["TB10"], rows("A.2").loc["TB10"]
    checks = (
        Check("milling time, zigzag less 3-D (s)", "230", zigzag[TIME] - three_d[TIME]),
        Check("simulation time, 3-D (s)", "203", three_d[SIMULATION]),
        Check("simulation time, zigzag (s)", "51", zigzag[SIMULATION]),
    )
    evidence = pd.DataFrame({"zigzag": zigzag, "3d": three_d}).rename_axis("column").reset_index()
    return Finding("I3", checks, evidence)


def slopes() -> pd.DataFrame:
    """Return seconds per cm^3 of straight lines through real and predicted milling times.

    Columns: ``milled_with, over, n, slope_s_per_cm3, half_width_95`` and
    ``experiment_over_it_pct``, the symmetric percent difference with its sign (positive where the
    experiment is steeper). Volumes are those of A.1, which have a digit more than Table 2.3.
    """
    milled, found = rows("2.3"), []
    for strategy, name in (("zigzag", "A.1"), ("3d", "A.2")):
        simulated = rows(name)
        of_strategy = milled[milled["milled_with"] == strategy]
        bones = simulated.index.str.startswith("TB")
        samples = {
            "experiment": (simulated.loc[of_strategy.index, VOLUME], of_strategy[TRUE_TIME]),
            "experiment, volumes of 2.3": (of_strategy[VOLUME], of_strategy[TRUE_TIME]),
            "all 36 scans": (simulated[VOLUME], simulated[TIME]),
            "17 temporal bones": (simulated.loc[bones, VOLUME], simulated.loc[bones, TIME]),
            "15 milled bones": (simulated.loc[milled.index, VOLUME], simulated.loc[milled.index, TIME]),
            "same bones": (
                simulated.loc[of_strategy.index, VOLUME],
                of_strategy[PREDICTED_TIME[strategy]],
            ),
        }
        lines = {over: stats.linregress(x, y) for over, (x, y) in samples.items()}
        experiment = lines["experiment"].slope
        for over, line in lines.items():
            n = len(samples[over][0])
            difference = float(symmetric_percent_difference(experiment, line.slope))
            found.append(
                {
                    "milled_with": strategy,
                    "over": over,
                    "n": n,
                    "slope_s_per_cm3": line.slope,
                    "half_width_95": stats.t.ppf(0.975, n - 2) * line.stderr,
                    "experiment_over_it_pct": np.copysign(difference, experiment - line.slope),
                }
            )
    return pd.DataFrame(found)


def slopes_compare_other_bones() -> Finding:
    """I4: most of the difference between real and predicted slopes is the choice of bones."""
    table = slopes()
    at = table.set_index(["milled_with", "over"])
    slope, differs, half = at["slope_s_per_cm3"], at["experiment_over_it_pct"], at["half_width_95"]
    covered = all(
        abs(slope[k, "experiment"] - slope[k, "same bones"]) <= half[k, "experiment"]
        for k in ("zigzag", "3d")
    )
    checks = (
        Check("zigzag, experiment (s/cm^3)", "577.5", slope["zigzag", "experiment"]),
        Check("3-D, experiment (s/cm^3)", "405.4", slope["3d", "experiment"]),
        Check(
            "zigzag, experiment, rounded volumes (s/cm^3)",
            "579.7",
            slope["zigzag", "experiment, volumes of 2.3"],
        ),
        Check(
            "3-D, experiment, rounded volumes (s/cm^3)", "401.4", slope["3d", "experiment, volumes of 2.3"]
        ),
        Check("zigzag, all scans (s/cm^3)", "531.0", slope["zigzag", "all 36 scans"]),
        Check("3-D, all scans (s/cm^3)", "336.1", slope["3d", "all 36 scans"]),
        Check("zigzag, against all scans (%)", "8.4", differs["zigzag", "all 36 scans"]),
        Check("3-D, against all scans (%)", "18.7", differs["3d", "all 36 scans"]),
        Check("zigzag, same bones predicted (s/cm^3)", "552.6", slope["zigzag", "same bones"]),
        Check("3-D, same bones predicted (s/cm^3)", "381.8", slope["3d", "same bones"]),
        Check("zigzag, against the same bones (%)", "4.4", differs["zigzag", "same bones"]),
        Check("3-D, against the same bones (%)", "6.0", differs["3d", "same bones"]),
        Check("zigzag, +- of the experiment (s/cm^3)", "56", half["zigzag", "experiment"]),
        Check("3-D, +- of the experiment (s/cm^3)", "57", half["3d", "experiment"]),
        Check("both intervals cover the prediction", "yes", bool(covered)),
        Check("zigzag, against 17 temporal bones (%)", "-3.4", differs["zigzag", "17 temporal bones"]),
        Check("zigzag, against 15 milled bones (%)", "-2.1", differs["zigzag", "15 milled bones"]),
    )
    return Finding("I4", checks, table)


def paths_of_other_targets() -> Finding:
    """I5: 5-DOF paths are shorter because their targets are smaller."""
    checks, evidence = [], []
    stated = {"zigzag": ("0.55", "1.4"), "3-D": ("2.29", "1.5")}
    for strategy, four_name, five_name in (("zigzag", "A.1", "A.3"), ("3-D", "A.2", "A.4")):
        four, five = rows(four_name), rows(five_name)
        equal = four[VOLUME] == five[VOLUME]
        printed = [published.summary(name).loc["mean", PREDICTED] for name in (four_name, five_name)]
        shorter = 100 * (1 - printed[1] / printed[0])
        longer = 100 * (five.loc[equal, PREDICTED].mean() / four.loc[equal, PREDICTED].mean() - 1)
        checks.append(
            Check(f"{strategy}, 5-DOF shorter in the printed means (%)", stated[strategy][0], shorter)
        )
        checks.append(Check(f"{strategy}, 5-DOF longer on equal targets (%)", stated[strategy][1], longer))
        evidence.append(
            {
                "strategy": strategy,
                "printed_means_shorter_pct": shorter,
                "row_means_shorter_pct": 100 * (1 - five[PREDICTED].mean() / four[PREDICTED].mean()),
                "equal_targets": int(equal.sum()),
                "equal_targets_longer_pct": longer,
            }
        )
    checks += [
        Check("mean target, 4 DOF (cm^3)", "3.150", rows("A.1")[VOLUME].mean()),
        Check("mean target, 5 DOF (cm^3)", "3.103", rows("A.3")[VOLUME].mean()),
    ]
    text = published.parameter("claim_path_diff_4_vs_5_dof").value[0]
    remark = (
        f"The {text} % of the text is {evidence[0]['printed_means_shorter_pct']:.2f} % cut short; "
        f"from the rows it is {evidence[0]['row_means_shorter_pct']:.2f} %."
    )
    return Finding("I5", tuple(checks), pd.DataFrame(evidence), remark)


def more_freedom_leaves_more() -> Finding:
    """I6: with 5 DOF more of the target stays behind."""
    four, five = rows("A.2"), rows("A.4")
    equal = four[VOLUME] == five[VOLUME]
    more, less = five[LEFT] > four[LEFT], five[LEFT] < four[LEFT]
    evidence = pd.DataFrame(
        {
            "volume_4_dof": four[VOLUME],
            "volume_5_dof": five[VOLUME],
            "left_4_dof": four[LEFT],
            "left_5_dof": five[LEFT],
        }
    )
    claim = published.parameter("claim_3d_unmilled_ratio_4_5_dof")
    final_over_initial = all(
        rounds_to(rows(name)[LEFT].mean(), f"{value:.1e}")
        for name, value in zip(("A.2", "A.4"), claim.value, strict=True)
    )
    checks = (
        Check("bones with more left at 5 DOF", "21", int(more.sum())),
        Check("bones with less left at 5 DOF", "3", int(less.sum())),
        Check("equal targets with more left", "12", int((more & equal).sum())),
        Check("equal targets with less left", "0", int((less & equal).sum())),
        Check("bones with a smaller 5-DOF target", "17", int((five[VOLUME] < four[VOLUME]).sum())),
        Check("mean 5-DOF target (cm^3)", "3.10", five[VOLUME].mean()),
        Check("the quoted shares are final over initial, not a volume", "yes", final_over_initial),
    )
    return Finding("I6", checks, evidence.reset_index())


def averages_hide_bones() -> Finding:
    """I7: the shorter path is a ratio of means."""
    zigzag, three_d = rows("A.1"), rows("A.2")
    shorter = 100 * (1 - three_d[PREDICTED] / zigzag[PREDICTED])
    faster = 100 * (1 - three_d[TIME] / zigzag[TIME])
    longer = list(shorter.index[shorter < 0])
    evidence = pd.DataFrame({"path_shorter_pct": shorter, "time_shorter_pct": faster})
    named = ["CH11", "CH19", "TB02", "TB03", "TB04", "TB05", "TB10", "TB14"]
    of_means = 100 * (1 - three_d[PREDICTED].mean() / zigzag[PREDICTED].mean())
    interval = t_interval(faster)
    checks = (
        Check("path, ratio of means (%)", "9.1", of_means),
        Check("path, mean per bone (%)", "5.1", shorter.mean()),
        Check("bones with a longer 3-D path", "8", len(longer)),
        Check("they are CH11 CH19 TB02-05 TB10 TB14", "yes", longer == named),
        Check("time, mean per bone (%)", "28.8", interval.mean),
        Check("time, +- of it (%)", "3.0", interval.half_width),
        Check("time, least (%)", "-11", faster.min()),
        Check("time, most (%)", "42", faster.max()),
        Check("slower only for TB14", "yes", list(faster.index[faster < 0]) == ["TB14"]),
    )
    return Finding("I7", checks, evidence.reset_index())


def percent_difference_is_symmetric() -> Finding:
    """I8: which percent difference Table 2.3 prints."""
    table = published.table("2.3")
    predicted = table.apply(lambda row: row[PREDICTED_TIME[row["milled_with"]]], axis=1)
    true, printed = table[TRUE_TIME], published.table("2.3", as_printed=True)["pct_diff_predicted_actual_pct"]
    ways = {
        "symmetric_pct": pd.Series(symmetric_percent_difference(true, predicted)),
        "of_prediction_pct": 100 * (true / predicted - 1),
        "of_actual_pct": 100 * (1 - predicted / true),
    }
    fits = {k: sum(rounds_to(x, text) for x, text in zip(v, printed, strict=True)) for k, v in ways.items()}
    evidence = table[["specimen", "milled_with", "pct_diff_predicted_actual_pct"]].assign(**ways)
    per_group = evidence.groupby("milled_with")["of_prediction_pct"].mean()
    checks = (
        Check("rows that the symmetric difference fits", "15", fits["symmetric_pct"]),
        Check("rows that the share of the prediction fits", "11", fits["of_prediction_pct"]),
        Check("rows that the share of the actual time fits", "10", fits["of_actual_pct"]),
        Check("zigzag, excess over the prediction (%)", "5.5", per_group["zigzag"]),
        Check("3-D, excess over the prediction (%)", "9.0", per_group["3d"]),
    )
    return Finding("I8", checks, evidence)


def boundary_connectivity_differs() -> Finding:
    """I9: two connectivities for one term; a matter of the text, not of a table."""
    values = [
        published.parameter(name).value
        for name in ("target_boundary_connectivity", "immediately_adjacent_connectivity")
    ]
    checks = (
        Check("section 2.2.5", "6", values[0]),
        Check("Table 2.1", "26", values[1]),
        Check("they are the same", "no", values[0] == values[1]),
    )
    return Finding("I9", checks, remark="Read in the text; no table bears on it.")


def speed_is_not_derivable() -> Finding:
    """I25: no average of the printed numbers is 4.65 mm/s."""
    three_d = rows("A.2")
    printed = published.summary("A.2").loc["mean", SPEED]
    of_rows, of_sums = three_d[SPEED].mean(), 10 * three_d[MILLING].sum() / three_d[TIME].sum()
    claim = f"{published.parameter('claim_mean_speed_3d').value:.2f}"
    checks = (
        Check("text (mm/s)", "4.65", float(claim)),
        Check("Table 2.2 (mm/s)", "4.6", printed),
        Check("mean of the rows (mm/s)", "4.556", of_rows),
        Check("all lengths over all times (mm/s)", "4.47", of_sums),
        Check("one of them is 4.65", "no", any(rounds_to(x, claim) for x in (printed, of_rows, of_sums))),
        Check("zigzag, mean of the rows (mm/s)", "3.725", rows("A.1")[SPEED].mean()),
    )
    return Finding("I25", checks)
