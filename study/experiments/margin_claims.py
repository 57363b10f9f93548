"""What sections 3.3.2 and 3.4 of Siebold say about Table 3.2, decided by the printed means and by ours.

The same functions judge both, on means over the bones; what only we know (risks at every volume, risks on
fresh registrations) is judged for ours alone.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from study.errors import InputError
from study.experiments.appendix_claims import Where
from study.experiments.margin_table import QUANTITIES
from study.margins import ACCEPTABLE_RISKS, RiskEstimate
from study.margins.point_risk import point_damage_risk
from study.published import table as published_table
from study.tables import Claim, t_interval

VOLUME, RISK, DISTANCE, SPREAD = QUANTITIES
WHICH = ["structure", "variant", "voxel_size_mm"]
#: "On the order of 1e-7": what rounds to it in one digit.
POINT_RISK = 1.5e-7
#: "To three decimal places".
THREE_DECIMALS = 0.0005
#: Share of the acceptable risk up to which one voxel is taken to make no difference.
ONE_VOXEL = 0.1


def printed_means() -> pd.DataFrame:
    """The printed means, indexed by `WHICH`; ``mean_point_risk`` is a lower bound from the mean distance.

    The chi-squared tail is convex beyond a distance of sqrt(2), so the mean of risks is at least the risk at
    the mean distance (finding I11).
    """
    table = published_table("3.2").set_index(WHICH)
    means = pd.DataFrame({name: table[f"{name}_mean"] for name in QUANTITIES})
    means["mean_point_risk"] = point_damage_risk(means[DISTANCE])
    return means


def measured_means(rows: pd.DataFrame) -> pd.DataFrame:
    """Means over the bones of `study.experiments.margin_table.MarginTable.rows`, indexed by `WHICH`."""
    return rows.groupby(WHICH)[[*QUANTITIES, "mean_point_risk"]].mean()


def _name(structure: str) -> str:
    return structure.replace("_", " ")


def _order(index: pd.Index) -> list:
    return sorted(
        index, key=lambda key: list(ACCEPTABLE_RISKS).index(key if isinstance(key, str) else key[0])
    )


def _wide(means: pd.DataFrame, column: str, by: str) -> pd.DataFrame:
    wide = pd.DataFrame({key: means[column].xs(key, level=by) for key in means.index.unique(by)}).dropna()
    return wide.loc[_order(wide.index)]


def _listed(values: pd.Series, pattern: str) -> str:
    parts = []
    for key, value in values.items():
        text = _name(key) if isinstance(key, str) else " ".join([_name(key[0]), *(f"{k}" for k in key[1:])])
        parts.append(f"{text} {value:{pattern}}")
    return ", ".join(parts)


def table_claims(means: pd.DataFrame, where: Where, registrations: int = 25_000) -> list[Claim]:
    """The claims of the chapter that means alone decide.

    Parameters
    ----------
    means : DataFrame
        Of `printed_means` or `measured_means`.
    where : {"printed", "measured"}
        Whose they are.
    registrations : int
        On which the final risks were counted.

    Returns
    -------
    list of Claim
        A claim about every structure holds when no structure is against it. Claims for which the rows are
        missing (one voxel size, one shape) are left out.

    Raises
    ------
    InputError
        If there is no mean.
    """
    if means.empty:
        raise InputError("means: expected at least one structure, got none")
    claims: list[Claim] = []

    def add(text: str, holds: bool, evidence: str) -> None:
        claims.append(Claim(text, bool(holds), evidence, where))

    sizes = sorted(means.index.unique("voxel_size_mm"), reverse=True)
    variants = set(means.index.unique("variant"))
    if {"SV", "UT"} <= variants:
        for size in sizes:
            wide = _wide(means.xs(size, level="voxel_size_mm"), VOLUME, "variant")
            change = 100 * (wide["SV"] / wide["UT"] - 1)
            add(
                f"Spatially varying margins are smaller than uniformly thick ones, {size:g} mm",
                (change < 0).all(),
                f"in {(change < 0).sum()} of {len(change)} structures: {_listed(change, '+.1f')} %",
            )
        wide = _wide(means, SPREAD, "variant")
        smaller = wide["SV"] < wide["UT"]
        add(
            "The final shell's distances scatter less for spatially varying margins",
            smaller.all(),
            f"in {smaller.sum()} of {len(wide)}; SD on average {wide['SV'].mean():.2f} "
            f"against {wide['UT'].mean():.2f}",
        )
    if len(sizes) > 1:
        claims += _upsampling_claims(means, where, sizes[0], sizes[-1])
    point = means["mean_point_risk"]
    low = point.xs(sizes[0], level="voxel_size_mm").max(), point.xs(sizes[-1], level="voxel_size_mm").max()
    bound = "at least, from the mean distance; " if where == "printed" else ""
    add(
        "The final shell's mean point damage risk is on the order of 1e-7 or smaller",
        (point <= POINT_RISK).all(),
        f"in {(point <= POINT_RISK).sum()} of {len(point)}; {bound}largest {low[0]:.0e} at {sizes[0]:g} mm"
        + (f", {low[1]:.0e} at {sizes[-1]:g} mm" if len(sizes) > 1 else ""),
    )
    acceptable = means.index.get_level_values("structure").map(ACCEPTABLE_RISKS).to_numpy()
    over = point / means[RISK].where(means[RISK] > 0)
    add(
        "It is orders of magnitude below the overall damage risk",
        (over.dropna() < 0.1).all(),
        f"{over.min():.0e} to {over.max():.0e} of it",
    )
    below = means[RISK] <= acceptable
    add("Every mean final risk is acceptable", below.all(), f"{below.sum()} of {len(below)}")
    half = {risk: _half_width(risk, registrations) for risk in sorted(set(acceptable))}
    add(
        f"{registrations} registrations give the risks to three decimal places",
        max(half.values()) < THREE_DECIMALS,
        "95 % half-widths " + ", ".join(f"{h:.4f} at {risk:g}" for risk, h in half.items()),
    )
    return claims


def _half_width(risk: float, registrations: int) -> float:
    low, high = RiskEstimate(round(risk * registrations), registrations).interval
    return (high - low) / 2


def _upsampling_claims(means: pd.DataFrame, where: Where, coarse: float, fine: float) -> list[Claim]:
    claims = []
    for column, text in (
        (SPREAD, "The distances scatter less after upsampling"),
        (VOLUME, "Margins are smaller after upsampling"),
    ):
        wide = _wide(means, column, "voxel_size_mm")
        ratio = wide[fine] / wide[coarse]
        evidence = f"in {(ratio < 1).sum()} of {len(ratio)}; {ratio.min():.2f} to {ratio.max():.2f} times"
        claims.append(Claim(text, bool((ratio < 1).all()), evidence, where))
    wide = _wide(means, RISK, "voxel_size_mm")
    acceptable = wide.index.get_level_values("structure").map(ACCEPTABLE_RISKS).to_numpy()
    share = wide.div(acceptable, axis=0)
    closer = (share[fine] - 1).abs() < (share[coarse] - 1).abs()
    changes = ", ".join(
        f"{_name(key[0])} {key[1]} {row[coarse]:.2f} to {row[fine]:.2f}" for key, row in share.iterrows()
    )
    text = "Final risks are closer to the acceptable ones after upsampling"
    evidence = f"in {closer.sum()} of {len(closer)}; risk over acceptable: {changes}"
    return [*claims, Claim(text, bool(closer.all()), evidence, where)]


def own_claims(rows: pd.DataFrame) -> list[Claim]:
    """Claims that only rows of our own can decide.

    Parameters
    ----------
    rows : DataFrame
        Of `study.experiments.margin_table.run_margin_table`.

    Returns
    -------
    list of Claim
        Volumes at equal risk, what the last voxel decides, margins of a single layer of voxels, risks on
        registrations not used before. Left out where the rows do not hold the numbers (published
        method, no validation).
    """
    claims = []
    for size in sorted(rows["voxel_size_mm"].unique(), reverse=True):
        at = rows[rows["voxel_size_mm"] == size]
        ratios = np.log(
            at.loc[at["variant"] == "SV"].set_index("structure")["sv_over_ut_at_equal_risk"].dropna()
        )
        if len(ratios):
            claims.append(_equal_risk(ratios, size))
        known = at.dropna(subset="risk_one_voxel_less")
        if len(known):
            claims.append(_last_voxel(known, size))
        claims.append(_first_layer(at, size))
    known = rows.dropna(subset="validated_low")
    if len(known):
        wholly = known["validated_low"] > known["acceptable_risk"]
        above = known["validated_risk"] > known["acceptable_risk"]
        claims.append(
            Claim(
                "On fresh registrations no risk is above the acceptable one by more than chance",
                not wholly.any(),
                f"above in {above.sum()} of {len(known)}, with its whole 95 % interval in {wholly.sum()}",
                "measured",
            )
        )
    return claims


def _equal_risk(ratios: pd.Series, size: float) -> Claim:
    means = ratios.groupby(level=0).mean()
    parts = []
    for structure in _order(means.index):
        values = ratios.xs(structure) if np.ndim(ratios.loc[structure]) else np.array([ratios.loc[structure]])
        change = 100 * (np.exp(means[structure]) - 1)
        ends = ""
        if len(values) > 1:
            interval = t_interval(np.asarray(values))
            ends = f" ({100 * (np.exp(interval.low) - 1):+.0f} to {100 * (np.exp(interval.high) - 1):+.0f})"
        parts.append(f"{_name(structure)} {change:+.1f}{ends}")
    return Claim(
        f"At the same risk spatially varying margins are smaller, {size:g} mm",
        bool((means < 0).all()),
        f"in {(means < 0).sum()} of {len(means)} structures: {', '.join(parts)} %",
        "measured",
    )


def _last_voxel(rows: pd.DataFrame, size: float) -> Claim:
    step = (rows["risk_one_voxel_less"] - rows[RISK]) / rows["acceptable_risk"]
    worst = rows.loc[step.idxmax()]
    return Claim(
        f"One voxel more or less changes the risk by less than a tenth of the acceptable, {size:g} mm",
        bool((step < ONE_VOXEL).all()),
        f"in {(step < ONE_VOXEL).sum()} of {len(step)} margins; most in {worst['specimen']}, "
        f"{_name(worst['structure'])} {worst['variant']}: "
        f"{worst['risk_one_voxel_less']:.3f} to {worst[RISK]:.4f}",
        "measured",
    )


def _first_layer(rows: pd.DataFrame, size: float) -> Claim:
    only = np.isclose(rows[VOLUME], rows["first_layer_mm3"], rtol=1e-9)
    which = rows[only].groupby(["structure", "variant"]).size()
    listed = ", ".join(f"{_name(s)} {v} in {which[s, v]}" for s, v in _order(which.index))
    return Claim(
        f"Margins are more than the layer of voxels that touches the structure, {size:g} mm",
        not only.any(),
        f"no more in {only.sum()} of {len(only)}" + (f": {listed}" if listed else ""),
        "measured",
    )
