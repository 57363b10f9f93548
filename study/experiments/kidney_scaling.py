"""How a margin, or a registration's scatter, goes with the errors of the start: fitted exponents.

The chapter concludes from Tables B.1 to B.9 that position matters more than rotation (4.4). A power law with
a level of each tumour's own says by how much, with intervals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats

from study.errors import InputError
from study.tables import Interval

#: Standard deviations of the start, as columns of the tables are called.
ERRORS = ("pos_std_mm", "rot_std_deg")


@dataclass(frozen=True, eq=False)
class PowerLaw:
    """``quantity ~ level(group) * product of error ** exponent``, fitted in logarithms.

    Attributes
    ----------
    exponents : mapping of str to Interval
        Of each error with more than one value; the half-width is that of the t interval, NaN when no
        degree of freedom is left for it.
    levels : mapping of group to float
        The quantity where every error is 1, in its own unit.
    difference : Interval or None
        First exponent minus second, where there are two.
    left_out : tuple
        Groups with a value that is not positive, which has no logarithm. All their rows are left out: to
        drop the zeros alone would drop the small errors and flatten the law.
    rows : int
        Rows fitted.
    """

    exponents: Mapping[str, Interval]
    levels: Mapping[object, float]
    difference: Interval | None
    left_out: tuple
    rows: int


def fit_power_law(
    rows: pd.DataFrame,
    quantity: str,
    errors: Sequence[str] = ERRORS,
    group: str = "tumour",
    confidence: float = 0.95,
) -> PowerLaw:
    """Least squares of log quantity on the logs of the errors and a level of each group.

    Parameters
    ----------
    rows : DataFrame
        With the columns named by the other parameters.
    quantity : str
    errors : sequence of str
        Positive columns; one that has a single value is not fitted.
    group : str
    confidence : float
        Of the t intervals.

    Returns
    -------
    PowerLaw

    Raises
    ------
    InputError
        If an error is not positive, none of them varies, or in no group all values are positive.
    """
    if not (rows[list(errors)] > 0).all(axis=None):
        raise InputError(f"{', '.join(errors)}: expected positive errors, the law is one of their logarithms")
    positive = (rows[quantity] > 0).groupby(rows[group]).transform("all")
    left_out = tuple(rows.loc[~positive, group].unique().tolist())
    rows = rows[positive]
    varied = [name for name in errors if len(set(rows[name])) > 1]
    if rows.empty or not varied:
        raise InputError(
            f"{quantity}: expected at least one {group} without a zero and with errors of two sizes; "
            f"left out for zeros: {list(left_out) or 'none'}, errors that vary: {varied or 'none'}"
        )
    groups = rows[group].unique().tolist()
    own = (rows[group].to_numpy()[:, None] == np.array(groups, dtype=object)).astype(float)
    design = np.column_stack([*(np.log(rows[name]) for name in varied), own])
    target = np.log(rows[quantity].to_numpy(float))
    solution, _, rank, _ = np.linalg.lstsq(design, target, rcond=None)
    if rank < design.shape[1]:
        raise InputError(f"{quantity}: {', '.join(varied)} vary together, so their exponents cannot be told")
    freedom = len(target) - rank
    covariance = np.linalg.inv(design.T @ design)
    if freedom:
        covariance *= np.sum((target - design @ solution) ** 2) / freedom
    scale = stats.t.ppf((1 + confidence) / 2, freedom) if freedom else np.nan

    def interval(weights: np.ndarray) -> Interval:
        half = scale * np.sqrt(weights @ covariance @ weights)
        return Interval(float(weights @ solution), float(half), len(target), confidence)

    unit = np.eye(len(solution))
    return PowerLaw(
        {name: interval(unit[k]) for k, name in enumerate(varied)},
        dict(zip(groups, np.exp(solution[len(varied) :]), strict=True)),
        interval(unit[0] - unit[1]) if len(varied) > 1 else None,
        left_out,
        len(target),
    )


def never_falls(
    rows: pd.DataFrame, quantity: str, error: str, errors: Sequence[str] = ERRORS, group: str = "tumour"
) -> tuple[int, int]:
    """Series in which a quantity never falls when one error grows, everything else fixed; and all series."""
    others = [group, *(name for name in errors if name != error)]
    series = [part.sort_values(error)[quantity] for _, part in rows.groupby(others) if len(part) > 1]
    return sum(one.is_monotonic_increasing for one in series), len(series)


def exponents_table(
    rows: pd.DataFrame,
    quantities: Sequence[str] = ("margin_volume_mm3",),
    by: Sequence[str] = ("variant",),
    errors: Sequence[str] = ERRORS,
    group: str = "tumour",
) -> pd.DataFrame:
    """Exponents of several quantities, a row for each of the errors.

    Parameters
    ----------
    rows : DataFrame
    quantities : sequence of str
    by : sequence of str
        Columns that say which rows belong to one fit.
    errors, group
        As for `fit_power_law`.

    Returns
    -------
    DataFrame
        `by`, ``quantity, error, exponent, half_width_95``; ``monotone, of`` from `never_falls`; ``tumours``
        fitted; ``note``, why there is no exponent or what was left out.
    """
    found = []
    for key, part in rows.groupby(list(by), sort=False):
        for quantity in quantities:
            try:
                law, note = fit_power_law(part, quantity, errors, group), ""
                if law.left_out:
                    note = f"left out, with zeros: {group} {', '.join(map(str, law.left_out))}"
            except InputError:
                law = None
                zeros = int((part[quantity] == 0).sum())
                note = f"{zeros} of {len(part)} are zero" if zeros else "the errors do not vary"
            for error in errors:
                exponent = law.exponents.get(error) if law else None
                monotone, of = never_falls(part, quantity, error, errors, group)
                entry = dict(zip(by, key, strict=True)) | {"quantity": quantity, "error": error}
                entry["exponent"] = exponent.mean if exponent else np.nan
                entry["half_width_95"] = exponent.half_width if exponent else np.nan
                entry |= {"monotone": monotone, "of": of, "tumours": len(law.levels) if law else 0}
                found.append(entry | {"note": note or ("" if exponent else "one value only")})
    return pd.DataFrame(found)
