"""What a notebook shows: intervals, comparisons, printed beside measured, claims that hold or do not."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from scipy import stats

from study.errors import InputError
from study.files import written_whole

_UNITS = {  # ending of a column's name: unit; longest first
    "_mm_per_cm3": "mm/cm³",
    "_mm_per_s": "mm/s",
    "_s_per_cm3": "s/cm³",
    "_voxels": "voxels",
    "_ratio": "",
    "_cm3": "cm³",
    "_mm3": "mm³",
    "_mm2": "mm²",
    "_pct": "%",
    "_deg": "°",
    "_min": "min",
    "_mm": "mm",
    "_s": "s",
}


@dataclass(frozen=True)
class Interval:
    """Mean of a sample with its Student-t confidence interval.

    Attributes
    ----------
    mean, half_width : float
        In the unit of the values; the interval is ``mean - half_width`` to ``mean + half_width``.
    n : int
        Number of values.
    confidence : float
        Such as 0.95.
    """

    mean: float
    half_width: float
    n: int
    confidence: float = 0.95

    @property
    def low(self) -> float:
        """Lower end."""
        return self.mean - self.half_width

    @property
    def high(self) -> float:
        """Upper end."""
        return self.mean + self.half_width

    def __contains__(self, value: float) -> bool:
        return bool(self.low <= value <= self.high)


@dataclass(frozen=True)
class PairedComparison:
    """Differences ``a - b`` of values that belong together in pairs.

    Attributes
    ----------
    difference : Interval
        Mean of ``a - b`` with its t interval.
    p_value : float
        Two-sided p of the paired t test; 1 if all differences are zero, 0 if all are the same and not zero.
    wins, ties, losses : int
        Pairs with ``a < b``, ``a == b`` and ``a > b``.
    """

    difference: Interval
    p_value: float
    wins: int
    ties: int
    losses: int


@dataclass(frozen=True)
class Claim:
    """A statement and whether it holds.

    Attributes
    ----------
    text : str
        The statement.
    holds : bool
        Computed by the caller, never typed in.
    evidence : str
        The number it rests on.
    where : {"printed", "measured"}
        Whether printed numbers or our own decide.
    """

    text: str
    holds: bool
    evidence: str
    where: Literal["printed", "measured"]

    def __post_init__(self) -> None:
        if not isinstance(self.holds, (bool, np.bool_)):
            raise InputError(f"holds of claim {self.text!r} has to be True or False, got {self.holds!r}")
        if self.where not in ("printed", "measured"):
            raise InputError(
                f"where of claim {self.text!r} has to be 'printed' or 'measured', got {self.where!r}"
            )
        object.__setattr__(self, "holds", bool(self.holds))


def t_interval(values: ArrayLike, confidence: float = 0.95) -> Interval:
    """Return the mean of a sample with its Student-t confidence interval.

    Parameters
    ----------
    values : (n,) array_like
        At least two finite numbers.
    confidence : float
        Between 0 and 1.

    Returns
    -------
    Interval
        ``half_width = t(n - 1) s / sqrt(n)`` with the sample standard deviation s.

    Raises
    ------
    InputError
        If there are fewer than two values, one is not finite, or `confidence` is out of range.
    """
    values = _sample(values, "values", least=2)
    if not 0 < confidence < 1:
        raise InputError(f"confidence has to lie between 0 and 1, got {confidence}")
    t = stats.t.ppf((1 + confidence) / 2, values.size - 1)
    deviation = values.std(ddof=1) if np.ptp(values) else 0.0  # equal values: no rounding residue
    half_width = float(t * deviation / np.sqrt(values.size))
    return Interval(float(values.mean()), half_width, int(values.size), confidence)


def paired_comparison(a: ArrayLike, b: ArrayLike, confidence: float = 0.95) -> PairedComparison:
    """Compare two columns whose rows belong together.

    Parameters
    ----------
    a, b : (n,) array_like
        Values of the same n >= 2 cases in the same order; smaller wins. Two Series need the same index.
    confidence : float
        Of the interval of the mean difference.

    Returns
    -------
    PairedComparison
        Of ``a - b``.

    Raises
    ------
    InputError
        If the lengths or the indexes differ, or a value is not finite.
    """
    if isinstance(a, pd.Series) and isinstance(b, pd.Series) and not a.index.equals(b.index):
        raise InputError("the two columns are indexed differently, so their rows are no pairs")
    a, b = _sample(a, "a", least=2), _sample(b, "b", least=2)
    if a.size != b.size:
        raise InputError(f"pairs need columns of one length, got {a.size} and {b.size}")
    difference = t_interval(a - b, confidence)
    if difference.half_width == 0:  # a constant difference leaves the t statistic undefined
        p_value = 1.0 if difference.mean == 0 else 0.0
    else:
        p_value = float(stats.ttest_rel(a, b).pvalue)
    wins, ties, losses = (int(np.sum(x)) for x in (a < b, a == b, a > b))
    return PairedComparison(difference, p_value, wins, ties, losses)


def symmetric_percent_difference(a: ArrayLike, b: ArrayLike) -> np.ndarray:
    """Return ``200 |a - b| / (a + b)``, the percent difference that Table 2.3 prints (finding I8).

    Parameters
    ----------
    a, b : array_like
        Positive numbers of the same unit, broadcast against each other.

    Raises
    ------
    InputError
        If a number is not positive.
    """
    a, b = np.asarray(a, float), np.asarray(b, float)
    if not (np.all(a > 0) and np.all(b > 0)):
        raise InputError("a symmetric percent difference needs positive numbers")
    return 200 * np.abs(a - b) / (a + b)


def printed_beside_measured(
    printed: Mapping[str, float] | pd.Series,
    measured: Mapping[str, float] | pd.Series | pd.DataFrame,
    corrected: Mapping[str, float] | pd.Series | None = None,
    confidence: float = 0.95,
) -> pd.DataFrame:
    """Lay printed, corrected and measured numbers side by side.

    Parameters
    ----------
    printed : mapping of str to float
        A printed number for each quantity (a column's name, its unit at the end).
    measured : mapping or pandas.DataFrame
        Our number for each quantity; of a data frame (one row per case) the mean and its t interval.
    corrected : mapping, optional
        Printed numbers in true units; without it the printed ones stand.
    confidence : float
        Of the interval of measured means.

    Returns
    -------
    pandas.DataFrame
        A row per quantity of `printed`, in that order: ``unit``, ``printed``, ``corrected``,
        ``measured``, ``measured_plus_minus`` (only for a data frame) and ``measured_over_corrected``.
        What was not measured or not printed is NaN.

    Raises
    ------
    InputError
        If nothing printed was measured.
    """
    printed = _numbers(printed)
    corrected = printed if corrected is None else _numbers(corrected)
    half_widths = None
    if isinstance(measured, pd.DataFrame):
        columns = {name: measured[name].dropna() for name in printed.index if name in measured}
        intervals = {name: t_interval(v, confidence) for name, v in columns.items() if len(v) > 1}
        half_widths = pd.Series(
            {name: interval.half_width for name, interval in intervals.items()}, dtype=float
        )
        measured = {name: values.mean() for name, values in columns.items()}
    measured = _numbers(measured)
    if not printed.index.intersection(measured.index).size:
        raise InputError(
            f"nothing printed was measured: printed are {', '.join(printed.index)}, "
            f"measured {', '.join(map(str, measured.index)) or 'nothing'}"
        )
    rows = pd.DataFrame({"unit": [unit_of(name) for name in printed.index]}, index=printed.index)
    rows["printed"] = printed
    rows["corrected"] = corrected.reindex(printed.index).fillna(printed)
    rows["measured"] = measured.reindex(printed.index)
    if half_widths is not None:
        rows["measured_plus_minus"] = half_widths.reindex(printed.index)
    # no ratio to a printed zero
    rows["measured_over_corrected"] = rows["measured"] / rows["corrected"].where(rows["corrected"] != 0)
    return rows.rename_axis("quantity")


def claims_table(claims: Iterable[Claim]) -> pd.DataFrame:
    """Return claims as a table to show or save: ``claim, holds, evidence, where``.

    ``holds`` reads "yes" or "no".
    """
    rows = [(c.text, "yes" if c.holds else "no", c.evidence, c.where) for c in claims]
    return pd.DataFrame(rows, columns=["claim", "holds", "evidence", "where"])


def unit_of(name: str) -> str:
    """Return the unit that ends a column's name (``"milling_path_length_mm"``: ``"mm"``), or ``""``."""
    return next((unit for ending, unit in _UNITS.items() if name.endswith(ending)), "")


def heading(name: str) -> str:
    """Return a column's name in words (``"milling_path_length_mm"``: ``"milling path length (mm)"``)."""
    ending = next((ending for ending in _UNITS if name.endswith(ending)), "")
    words = name.removesuffix(ending).replace("_", " ") + (" ratio" if ending == "_ratio" else "")
    return f"{words} ({_UNITS[ending]})" if ending and _UNITS[ending] else words


def with_unit(value: float, unit: str = "", digits: int = 3) -> str:
    """Return a number to `digits` significant digits (never fewer than it has before the point) and unit."""
    text = f"{value:.0f}" if 10**digits <= abs(value) < 1e7 else f"{value:.{digits}g}"
    return f"{text} {unit}".rstrip()


def with_interval(interval: Interval, unit: str = "", digits: int = 2) -> str:
    """Return ``mean ± half-width unit``, the half-width with `digits` significant digits."""
    if not interval.half_width > 0:
        return f"{with_unit(interval.mean)} ± 0 {unit}".rstrip()
    decimals = max(0, digits - 1 - int(np.floor(np.log10(interval.half_width))))
    return f"{interval.mean:.{decimals}f} ± {interval.half_width:.{decimals}f} {unit}".rstrip()


def save_table(
    rows: pd.DataFrame, path: str | os.PathLike[str], index: bool = False, digits: int = 8
) -> None:
    """Write a table as CSV, whole or not at all.

    Parameters
    ----------
    rows : pandas.DataFrame
        What to write.
    path : path-like
        Where; a missing folder is made. The same table gives the same bytes.
    index : bool
        Write the index too.
    digits : int
        Significant digits of floating-point numbers.
    """
    with written_whole(path) as temporary:
        rows.to_csv(temporary, index=index, float_format=f"%.{digits}g", lineterminator="\n")


def save_figure(figure: Figure, path: str | os.PathLike[str], dpi: int = 150) -> None:
    """Write a matplotlib figure, whole or not at all; the same figure gives the same bytes.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        What to write.
    path : path-like
        Where, ending in ``.png``; a missing folder is made.
    dpi : int
        Dots per inch.
    """
    with written_whole(path) as temporary:
        figure.savefig(temporary, dpi=dpi, bbox_inches="tight", pad_inches=0.08, metadata={"Software": None})


def _sample(values: ArrayLike, name: str, least: int) -> np.ndarray:
    values = np.asarray(values, dtype=float)
    if values.ndim != 1 or values.size < least:
        raise InputError(f"{name}: expected at least {least} numbers in one row, got shape {values.shape}")
    if not np.all(np.isfinite(values)):
        raise InputError(
            f"{name}: {int(np.sum(~np.isfinite(values)))} of {values.size} values are not finite"
        )
    return values


def _numbers(values: Mapping[str, float] | pd.Series) -> pd.Series:
    return pd.to_numeric(pd.Series(values), errors="coerce").astype(float)
