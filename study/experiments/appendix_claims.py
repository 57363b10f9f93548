"""What section 2.5.1 of Siebold says about the two planners, decided by any pair of appendix tables.

The same functions judge the printed tables (A.1, A.2) and our own, because the columns are the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np
import pandas as pd

from study.errors import InputError
from study.experiments.milling_times import NAMES, FittedLine, fitted_line
from study.tables import Claim, PairedComparison, paired_comparison, with_interval, with_unit

Where = Literal["printed", "measured"]


def rounding_percent(rows: pd.DataFrame) -> float:
    """Per cent by which corner rounding shortens the path, of the mean lengths."""
    return 100 * float(1 - rows["milling_path_length_mm"].mean() / rows["predicted_path_length_mm"].mean())


def shorter_percent(zigzag: pd.DataFrame, three_d: pd.DataFrame, column: str) -> float:
    """Per cent by which the 3-D planner's mean of a column is below the zigzag's."""
    return 100 * float(1 - three_d[column].mean() / zigzag[column].mean())


def bone_counted_cm3(rows: pd.DataFrame, voxel_mm: float = 0.4) -> pd.Series:
    """Bone that a row's contact columns add up to, cm^3: steps x share in contact x voxels x voxel volume.

    A step is taken as one voxel long; with the lengths in mm that is what the columns mean if they
    count the same thing for both planners (finding I1).
    """
    steps = rows["predicted_path_length_mm"] / voxel_mm
    voxels = steps * rows["steps_in_contact_over_path_length_ratio"]
    return voxels * rows["average_voxels_per_step_in_contact_voxels"] * voxel_mm**3 / 1000


def comparison_claims(zigzag: pd.DataFrame, three_d: pd.DataFrame, where: Where) -> list[Claim]:
    """The claims of 2.5.1 that compare the planners on the same bones.

    A claim about a mean holds when the paired 95 % t interval of the difference lies on its side of
    zero; a claim about every bone holds when no bone is against it.

    Parameters
    ----------
    zigzag, three_d : pandas.DataFrame
        Rows of tables A.1 and A.2, indexed by specimen, the same specimens in the same order.
    where : {"printed", "measured"}
        Whose rows these are.

    Returns
    -------
    list of Claim

    Raises
    ------
    InputError
        If the specimens differ.
    """
    if not zigzag.index.equals(three_d.index):
        raise InputError(
            "zigzag, three_d: expected the same specimens in the same order, "
            f"got {list(zigzag.index)} and {list(three_d.index)}"
        )
    claims = []

    def compare(column: str) -> PairedComparison:
        return paired_comparison(three_d[column], zigzag[column])

    def means(column: str, unit: str = "") -> str:
        return (
            f"3-D {with_unit(three_d[column].mean(), unit)}, zigzag {with_unit(zigzag[column].mean(), unit)}"
        )

    def add(text: str, holds: bool, evidence: str) -> None:
        claims.append(Claim(text, holds, evidence, where))

    path = compare("predicted_path_length_mm")
    add(
        "The 3-D planner's path is shorter (text: 9.1 %)",
        path.difference.high < 0,
        f"{shorter_percent(zigzag, three_d, 'predicted_path_length_mm'):.1f} % by the means; difference "
        f"{with_interval(path.difference, 'mm')}; shorter in {path.wins} of {len(zigzag)}",
    )
    time = compare("predicted_milling_time_s")
    add(
        "Milling the 3-D plan takes less time (text: 30.7 %)",
        time.difference.high < 0,
        f"{shorter_percent(zigzag, three_d, 'predicted_milling_time_s'):.1f} % by the means; difference "
        f"{with_interval(time.difference, 's')}; faster in {time.wins} of {len(zigzag)}",
    )
    saved = paired_comparison(
        three_d["milling_path_length_mm"] / three_d["predicted_path_length_mm"],
        zigzag["milling_path_length_mm"] / zigzag["predicted_path_length_mm"],
    )
    add(
        "Rounding corners shortens the 3-D path more than the zigzag's (text: 8.5 % and 0.4 %)",
        saved.difference.high < 0,
        f"3-D {rounding_percent(three_d):.1f} %, zigzag {rounding_percent(zigzag):.1f} %; "
        f"more in {saved.wins} of {len(zigzag)}",
    )
    contact = compare("steps_in_contact_over_path_length_ratio")
    add(
        "Fewer steps of the 3-D path touch bone (text: 8 % against 66 %)",
        contact.difference.high < 0,
        means("steps_in_contact_over_path_length_ratio"),
    )
    voxels = compare("average_voxels_per_step_in_contact_voxels")
    add(
        "A step in contact removes more in the 3-D plan (text: 32.9 against 8.0 voxels)",
        voxels.difference.low > 0,
        means("average_voxels_per_step_in_contact_voxels", "voxels"),
    )
    speed = compare("average_milling_speed_mm_per_s")
    add(
        "The burr is faster on average in the 3-D plan (text: 4.65 against 3.7 mm/s; table: 4.6)",
        speed.difference.low > 0,
        f"{means('average_milling_speed_mm_per_s', 'mm/s')}; "
        f"difference {with_interval(speed.difference, 'mm/s')}",
    )
    for column, name in (
        ("modified_final_over_initial_ratio", "modified"),
        ("unmodified_final_over_initial_ratio", "unmodified"),
    ):
        left = compare(column)
        add(
            f"The 3-D planner leaves less of the {name} target in every bone",
            left.wins == len(zigzag),
            f"less in {left.wins}, equal in {left.ties}, more in {left.losses} of {len(zigzag)}; "
            f"{means(column)}",
        )
    planning = compare("simulation_time_s")
    add(
        "Planning in 3-D takes longer (text: 653 s against 133 s, 4.9 times)",
        planning.difference.low > 0,
        f"{three_d['simulation_time_s'].mean() / zigzag['simulation_time_s'].mean():.2f} times; "
        f"{means('simulation_time_s', 's')}",
    )
    if len(zigzag) >= 3:
        claims.append(slope_claim(zigzag, three_d, where))
    bone = bone_counted_cm3(three_d).sum() / bone_counted_cm3(zigzag).sum()
    add(
        "Contact columns of both planners add up to the same bone within a tenth (finding I1)",
        bool(abs(bone - 1) < 0.1),
        f"3-D over zigzag {bone:.2f}",
    )
    return claims


def slope_claim(zigzag: pd.DataFrame, three_d: pd.DataFrame, where: Where) -> Claim:
    """Figure 2.20: the 3-D planner's time grows more slowly with the volume.

    Parameters
    ----------
    zigzag, three_d : pandas.DataFrame
        As for `comparison_claims`, three specimens or more.
    where : {"printed", "measured"}

    Returns
    -------
    Claim
        Decided by the slope of the paired difference zigzag - 3-D over the volume, which has to be
        above zero with its 95 % interval; the volumes are the zigzag's.
    """
    volumes = zigzag["modified_initial_target_cm3"]
    gain = fitted_line(
        volumes, zigzag["predicted_milling_time_s"] - three_d["predicted_milling_time_s"]
    ).slope
    slopes = [
        fitted_line(rows["modified_initial_target_cm3"], rows["predicted_milling_time_s"]).slope
        for rows in (zigzag, three_d)
    ]
    return Claim(
        "The time gained by the 3-D planner grows with the volume (figure 2.20)",
        gain.low > 0,
        f"gain {with_interval(gain, 's/cm³')}; zigzag {with_interval(slopes[0], 's/cm³')}, "
        f"3-D {with_interval(slopes[1], 's/cm³')}",
        where,
    )


def experiment_claims(
    milled: Mapping[str, FittedLine],
    simulated: Mapping[str, FittedLine],
    same_bones: Mapping[str, FittedLine],
) -> list[Claim]:
    """Section 2.5.2: the milled bones' times rise faster with the volume than the simulated ones.

    Parameters
    ----------
    milled : mapping of strategy to FittedLine
        Of the measured times of table 2.3.
    simulated, same_bones : mapping of strategy to FittedLine
        Of the printed predictions: of all 36 bones, and of those that were milled.

    Returns
    -------
    list of Claim
        Two a strategy. Against all bones the slopes are compared as the text compares them, number by
        number; against the same bones the claim holds if the predicted slope lies below the interval
        of the measured one.
    """
    claims = []
    for strategy, line in milled.items():
        for others, bones in ((simulated, "all 36 bones"), (same_bones, "the bones that were milled")):
            other = others[strategy].slope
            percent = 200 * (line.slope.mean - other.mean) / (line.slope.mean + other.mean)
            above = line.slope.mean > other.mean if others is simulated else line.slope.low > other.mean
            claims.append(
                Claim(
                    f"Milled with the {NAMES[strategy]} plan, times rise faster than predicted for {bones}",
                    bool(above),
                    f"{with_interval(line.slope, 's/cm³')} against {with_interval(other, 's/cm³')}, "
                    f"{percent:.1f} % (symmetric)",
                    "printed",
                )
            )
    return claims


def strategy_claims(rows: pd.DataFrame, printed: pd.DataFrame) -> list[Claim]:
    """What can be said of one planner's rows alone.

    Parameters
    ----------
    rows : pandas.DataFrame
        Our rows (`run_appendix`).
    printed : pandas.DataFrame
        The printed table of the same planner in true units.

    Returns
    -------
    list of Claim
    """
    n = len(rows)
    verified = int(rows["verified"].sum())
    replayed = "No plan and no rounded path cuts" if "milling_path_length_mm" in rows else "No plan cuts"
    left = rows["modified_final_over_initial_ratio"]
    claims = [
        Claim(
            f"{replayed} protected bone or drives the shaft into bone, by replay",
            verified == n,
            f"{verified} of {n}",
            "measured",
        ),
        Claim(
            "The vast majority of the target is milled: no more is left than the printed mean",
            bool(left.mean() <= printed["modified_final_over_initial_ratio"].mean()),
            f"{with_unit(100 * left.mean())} % left on average, printed "
            f"{with_unit(100 * printed['modified_final_over_initial_ratio'].mean())} %",
            "measured",
        ),
    ]
    if "average_milling_speed_mm_per_s" in rows:
        speed = rows["average_milling_speed_mm_per_s"]
        claims.append(
            Claim(
                "The average speed lies between the limits of 0.5 and 5 mm/s",
                bool(speed.between(0.5, 5.0).all()),
                f"{speed.min():.2f} to {speed.max():.2f} mm/s",
                "measured",
            )
        )
    if "milling_path_length_mm" in rows and "milling_path_length_mm" in printed:
        claims.append(
            Claim(
                f"Rounding corners shortens the path (printed: {rounding_percent(printed):.1f} %)",
                bool((rows["milling_path_length_mm"] < rows["predicted_path_length_mm"]).all()),
                f"{rounding_percent(rows):.1f} %",
                "measured",
            )
        )
    return claims


def paired_with_printed(rows: pd.DataFrame, printed: pd.DataFrame) -> pd.DataFrame:
    """Our rows minus the printed ones of the same names, column by column.

    The bones behind the names differ (ours are synthetic), so this says how far our set lies from
    theirs, not how well a bone was reproduced.

    Parameters
    ----------
    rows, printed : pandas.DataFrame
        Indexed by specimen.

    Returns
    -------
    pandas.DataFrame
        A row per column both have: ``n``, ``measured``, ``printed``, ``difference``, ``plus_minus``
        and ``p_value``. Empty for fewer than two common names.
    """
    names = [name for name in rows.index if name in printed.index]
    table = []
    if len(names) >= 2:
        for column in printed.columns:
            if column in rows and np.issubdtype(printed[column].dtype, np.number):
                a, b = rows.loc[names, column].astype(float), printed.loc[names, column].astype(float)
                both = a.notna() & b.notna()
                if both.sum() < 2:
                    continue
                pair = paired_comparison(a[both], b[both])
                means = {"measured": a[both].mean(), "printed": b[both].mean()}
                difference = {"difference": pair.difference.mean, "plus_minus": pair.difference.half_width}
                table.append(
                    {"quantity": column, "n": int(both.sum())}
                    | means
                    | difference
                    | {"p_value": pair.p_value}
                )
    columns = ["quantity", "n", "measured", "printed", "difference", "plus_minus", "p_value"]
    return pd.DataFrame(table, columns=columns).set_index("quantity")
