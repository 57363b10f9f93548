"""What section 2.5.1 of Siebold says about 5 degrees of freedom, decided by printed rows and by ours."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

import pandas as pd

from study.errors import InputError
from study.experiments.appendix_claims import Where
from study.experiments.freedom import differences, of_planner
from study.experiments.milling_times import NAMES
from study.published import OTHER_BONES
from study.tables import Claim, PairedComparison, paired_comparison, unit_of, with_interval, with_unit

LENGTH = "predicted_path_length_mm"
LEFT = "modified_final_over_initial_ratio"
VOLUME = "modified_initial_target_cm3"
TIME = "simulation_time_s"
#: Between the mean path lengths of 4 and 5 degrees of freedom: the per cent that 2.5.1 prints, and the
#: next whole number above it, up to which "fairly close" is taken to hold.
CLOSE_PERCENT = {"zigzag": (0.5, 1.0), "3d": (2.3, 3.0)}


def same_bones(
    four: pd.DataFrame, five: pd.DataFrame, where: Where = "printed"
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Rows of the same bones with 4 and with 5 degrees of freedom.

    Parameters
    ----------
    four, five : pandas.DataFrame
        Of one strategy, indexed by specimen.
    where : {"printed", "measured"}
        Printed rows CH17 to CH19 are left out: their names are not the same bones (finding E4).

    Returns
    -------
    (pandas.DataFrame, pandas.DataFrame)
        The same specimens in the same order.

    Raises
    ------
    InputError
        If the specimens differ.
    """
    if set(four.index) != set(five.index):
        raise InputError(
            f"four, five: expected the same specimens, got {list(four.index)} and {list(five.index)}"
        )
    names = [name for name in four.index if where == "measured" or name not in OTHER_BONES]
    return four.loc[names], five.loc[names]


def degree_claims(
    four: Mapping[str, pd.DataFrame], five: Mapping[str, pd.DataFrame], where: Where
) -> list[Claim]:
    """The claims of 2.5.1 that compare 5 degrees of freedom with 4, and 3-D with zigzag for 5.

    Claims about the means of the tables take all rows, as the text does. Claims about bones take the
    rows whose bones are the same (`same_bones`); about a mean difference they hold when its 95 % t
    interval lies on its side of zero, about every bone when no bone is against them.

    Parameters
    ----------
    four, five : mapping of strategy to pandas.DataFrame
        Tables A.1 and A.2, A.3 and A.4 (or ours), indexed by specimen.
    where : {"printed", "measured"}
        Whose rows these are.

    Returns
    -------
    list of Claim

    Raises
    ------
    InputError
        If the specimens of 4 and 5 degrees of freedom differ.
    """
    claims = []

    def add(text: str, holds: bool, evidence: str) -> None:
        claims.append(Claim(text, bool(holds), evidence, where))

    def counted(pair: PairedComparison, n: int) -> str:
        return f"less in {pair.wins}, equal in {pair.ties}, more in {pair.losses} of {n}"

    for strategy, name in NAMES.items():
        means = [rows[strategy][LENGTH].mean() for rows in (four, five)]
        percent = 100 * (means[1] / means[0] - 1)
        stated, most = CLOSE_PERCENT[strategy]
        add(
            f"The mean {name} paths of 4 and 5 DOF differ by less than {most:g} % (text: {stated} %)",
            abs(percent) < most,
            f"{percent:+.1f} % from 4 to 5 DOF",
        )
    for strategy, name in NAMES.items():
        a, b = same_bones(four[strategy], five[strategy], where)
        same = a[VOLUME] == b[VOLUME]
        if same.sum() >= 2:
            pair = paired_comparison(b[LENGTH][same], a[LENGTH][same])
            add(
                f"Over targets of the same size, the 5-DOF {name} path is shorter on average (finding I5)",
                pair.difference.high < 0,
                f"difference {with_interval(pair.difference, 'mm')} on {int(same.sum())} bones; "
                f"{100 * (b[LENGTH][same].mean() / a[LENGTH][same].mean() - 1):+.1f} %",
            )
    for strategy, name in NAMES.items():
        a, b = same_bones(four[strategy], five[strategy], where)
        pair = paired_comparison(b[VOLUME], a[VOLUME])
        add(
            f"The 5-DOF {name} planner starts from no smaller accessible target on any bone",
            pair.wins == 0,
            f"{counted(pair, len(a))}; 5 DOF {with_unit(b[VOLUME].mean(), 'cm³')}, "
            f"4 DOF {with_unit(a[VOLUME].mean(), 'cm³')}",
        )
    for strategy, text in (("zigzag", "table: 2.4e-2 against 1.3e-2"), ("3d", "text: 1.7e-2 against 1.8e-4")):
        a, b = same_bones(four[strategy], five[strategy], where)
        pair = paired_comparison(b[LEFT], a[LEFT])
        left = (
            f"{counted(pair, len(a))}; 5 DOF {with_unit(b[LEFT].mean())}, 4 DOF {with_unit(a[LEFT].mean())}"
        )
        add(
            f"The 5-DOF {NAMES[strategy]} planner leaves more of the modified target on average ({text})",
            pair.difference.low > 0,
            left,
        )
        add(
            f"The 5-DOF {NAMES[strategy]} planner leaves no more of it than the 4-DOF planner on any bone",
            pair.losses == 0,
            left,
        )
    for strategy, text in (("zigzag", "table: 8125 s against 133 s"), ("3d", "text: 60592 s against 653 s")):
        a, b = same_bones(four[strategy], five[strategy], where)
        pair = paired_comparison(b[TIME], a[TIME])
        add(
            f"Planning the {NAMES[strategy]} path takes longer with 5 DOF ({text})",
            pair.difference.low > 0,
            f"{b[TIME].mean() / a[TIME].mean():.1f} times: {with_unit(b[TIME].mean(), 's')} against "
            f"{with_unit(a[TIME].mean(), 's')}",
        )
    a, b = five["zigzag"], five["3d"]
    pair = paired_comparison(b[LENGTH], a[LENGTH])
    add(
        "With 5 DOF, too, the 3-D path is shorter than the zigzag's (table: 641 against 718)",
        pair.difference.high < 0,
        f"{100 * (1 - b[LENGTH].mean() / a[LENGTH].mean()):.1f} % by the means; difference "
        f"{with_interval(pair.difference, 'mm')}; shorter in {pair.wins} of {len(a)}",
    )
    pair = paired_comparison(b[LEFT], a[LEFT])
    add(
        "With 5 DOF, too, the 3-D planner leaves less of the modified target than the zigzag in every bone",
        pair.wins == len(a),
        counted(pair, len(a)),
    )
    return claims


def reach_claims(rows: pd.DataFrame) -> list[Claim]:
    """That 5 degrees of freedom leave no more than 4 on any bone, by three measures; and the replays.

    Parameters
    ----------
    rows : pandas.DataFrame
        Of `study.experiments.freedom.run_freedom`, with planners ``"4 DOF"`` and ``"5 DOF"``.

    Returns
    -------
    list of Claim
        Three a strategy, and that all plans passed their replays.
    """
    claims = []
    for strategy in rows["strategy"].unique():
        four, five = (of_planner(rows, strategy, planner) for planner in ("4 DOF", "5 DOF"))
        for column, what in (
            ("unreached_pct", "no more of the whole modified target unreached"),
            (LEFT, "no more of the accessible modified target, the printed measure,"),
            ("bone_left_mm3", "no more targeted bone standing"),
        ):
            more = five[column] - four[column].loc[five.index]
            unit = unit_of(column)
            claims.append(
                Claim(
                    f"{NAMES[strategy]}: 5 DOF leave {what} than 4 on any bone",
                    not (more > 0).any(),
                    f"less on {int((more < 0).sum())}, equal on {int((more == 0).sum())}, more on "
                    f"{int((more > 0).sum())} of {len(five)}, by {with_unit(max(more.max(), 0), unit)} at "
                    f"most; means {with_unit(five[column].mean(), unit)} against "
                    f"{with_unit(four[column].mean(), unit)}",
                    "measured",
                )
            )
    verified = int(rows["verified"].sum())
    claims.append(
        Claim(
            "No plan and no rounded path cuts protected bone or drives the shaft into bone, by replay",
            verified == len(rows),
            f"{verified} of {len(rows)}",
            "measured",
        )
    )
    return claims


def window_claims(rows: pd.DataFrame) -> list[Claim]:
    """Section 2.5.1's guess: looking at few directions near the present one is what leaves bone.

    Parameters
    ----------
    rows : pandas.DataFrame
        Of `study.experiments.freedom.run_freedom`, with all three planners
        (`study.experiments.freedom.PLANNERS`) on two bones or more.

    Returns
    -------
    list of Claim
        That the printed window leaves more than 4 degrees of freedom, as printed, and than the whole
        cone, by the printed measure and of the whole target. The mean decides, over these bones.
    """
    window = "5 DOF, printed window"
    measures = {LEFT: "of the accessible target (as printed)", "unreached_pct": "of the whole target"}
    claims = []
    for strategy in rows.loc[rows["planner"] == window, "strategy"].unique():
        found = rows[rows["strategy"] == strategy]
        for against, column in product(("4 DOF", "5 DOF"), measures):
            row = differences(found, window, against).loc[(strategy, column)]
            unit = unit_of(column)
            what = "4 DOF" if against == "4 DOF" else "the whole cone"
            claims.append(
                Claim(
                    f"{NAMES[strategy]}: the printed window leaves more {measures[column]} than {what}",
                    bool(row["difference"] > 0),
                    f"{with_unit(row[window], unit)} against {with_unit(row[against], unit)}; more on "
                    f"{int(row['more'])}, equal on {int(row['equal'])}, less on {int(row['less'])} of "
                    f"{int(row['n'])}",
                    "measured",
                )
            )
    return claims
