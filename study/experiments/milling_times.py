"""Milling time against target volume: the fitted lines of Siebold's figures 2.20 and 2.21."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from scipy import stats

from study.errors import InputError
from study.tables import Interval, heading

#: Colour and name of each strategy wherever both are drawn.
COLOURS = {"zigzag": "#c05a1c", "3d": "#1c6fb0"}
NAMES = {"zigzag": "zigzag", "3d": "3-D"}


@dataclass(frozen=True)
class FittedLine:
    """A least-squares line through milling times over volumes.

    Attributes
    ----------
    slope : Interval
        s/cm^3, with its t interval of n - 2 degrees of freedom.
    intercept_s : float
        Seconds at no volume.
    scatter_s : float
        Residual standard deviation, s.
    """

    slope: Interval
    intercept_s: float
    scatter_s: float

    def __call__(self, volumes_cm3: ArrayLike) -> np.ndarray:
        """Seconds on the line at (k,) volumes in cm^3."""
        return self.intercept_s + self.slope.mean * np.asarray(volumes_cm3, dtype=float)


def fitted_line(volumes_cm3: ArrayLike, times_s: ArrayLike, confidence: float = 0.95) -> FittedLine:
    """Fit milling times by a line over target volumes.

    Parameters
    ----------
    volumes_cm3, times_s : (n,) array_like
        At least three pairs.
    confidence : float
        Of the slope's interval.

    Returns
    -------
    FittedLine

    Raises
    ------
    InputError
        If the lengths differ, there are fewer than three pairs, or all volumes are the same.
    """
    x, y = np.asarray(volumes_cm3, dtype=float), np.asarray(times_s, dtype=float)
    if x.ndim != 1 or x.shape != y.shape or x.size < 3 or not np.isfinite([x, y]).all():
        raise InputError(
            f"a line needs three finite pairs or more, got volumes {x.shape} and times {y.shape}"
        )
    if np.ptp(x) == 0:
        raise InputError(f"a line needs different volumes, got {x[0]:g} cm^3 {x.size} times")
    fit = stats.linregress(x, y)
    half_width = float(stats.t.ppf((1 + confidence) / 2, x.size - 2) * fit.stderr)
    residuals = y - fit.intercept - fit.slope * x
    scatter = float(np.sqrt((residuals**2).sum() / (x.size - 2)))
    return FittedLine(
        Interval(float(fit.slope), half_width, x.size, confidence), float(fit.intercept), scatter
    )


def draw_milling_times(
    axes: Axes, series: Mapping[str, tuple[ArrayLike, ArrayLike]]
) -> dict[str, FittedLine]:
    """Draw milling time over volume, one strategy a colour, with fitted lines.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Drawn into.
    series : mapping of strategy to (volumes, times)
        Keys ``"zigzag"`` or ``"3d"``; cm^3 and s.

    Returns
    -------
    dict of str to FittedLine
        The line of each strategy.
    """
    lines = {}
    for strategy, (volumes, times) in series.items():
        lines[strategy] = line = fitted_line(volumes, times)
        ends = np.array([np.min(volumes), np.max(volumes)])
        label = f"{NAMES[strategy]}: {line.slope.mean:.0f} ± {line.slope.half_width:.0f} s/cm³"
        axes.plot(ends, line(ends), color=COLOURS[strategy], linewidth=1.5, label=label)
        axes.scatter(volumes, times, s=18, color=COLOURS[strategy], linewidths=0, alpha=0.8)
    axes.set_xlabel("modified initial target (cm³)")
    axes.set_ylabel("milling time (s)")
    axes.legend(frameon=False, loc="upper left")
    axes.spines[["top", "right"]].set_visible(False)
    return lines


def times_over_volume(rows: Mapping[str, pd.DataFrame]) -> dict[str, tuple[pd.Series, pd.Series]]:
    """Volumes and predicted times of appendix rows, by strategy, for `draw_milling_times`."""
    columns = ("modified_initial_target_cm3", "predicted_milling_time_s")
    return {strategy: tuple(table[column] for column in columns) for strategy, table in rows.items()}


def true_times_over_volume(
    experiments: pd.DataFrame, volumes: pd.Series
) -> dict[str, tuple[pd.Series, pd.Series]]:
    """Volumes and measured times of the milled bones, by the strategy each was milled with.

    Parameters
    ----------
    experiments : pandas.DataFrame
        Table 2.3, indexed by specimen.
    volumes : pandas.Series
        cm^3 by specimen: table 2.3 rounds them to one decimal, tables A.1 and A.2 do not.
    """
    return {
        str(strategy): (volumes[rows.index], rows["true_milling_time_s"])
        for strategy, rows in experiments.groupby("milled_with", sort=False)
    }


def slopes_table(lines: Mapping[str, Mapping[str, FittedLine]]) -> pd.DataFrame:
    """The slopes of several sets of lines: ``times, strategy, n, slope_s_per_cm3, plus_minus``."""
    return pd.DataFrame(
        [
            {
                "times": times,
                "strategy": strategy,
                "n": line.slope.n,
                "slope_s_per_cm3": line.slope.mean,
                "plus_minus": line.slope.half_width,
            }
            for times, of_strategy in lines.items()
            for strategy, line in of_strategy.items()
        ]
    )


def draw_rows(rows: pd.DataFrame, printed: pd.DataFrame, strategy: str) -> Figure:
    """Path length and, where there is one, milling time over volume: our rows and the printed ones.

    Parameters
    ----------
    rows, printed : pandas.DataFrame
        Of one appendix table, in true units.
    strategy : {"zigzag", "3d"}

    Returns
    -------
    matplotlib.figure.Figure
    """
    columns = ["predicted_path_length_mm", "predicted_milling_time_s"]
    columns = [column for column in columns if column in rows and printed[column].notna().any()]
    figure, axes = plt.subplots(
        1, len(columns), figsize=(5.5 * len(columns), 4.2), squeeze=False, constrained_layout=True
    )
    for ax, column in zip(axes[0], columns, strict=True):
        for table, colour, label in (
            (printed, "0.6", "printed, in true units"),
            (rows, COLOURS[strategy], "ours"),
        ):
            ax.scatter(
                table["modified_initial_target_cm3"],
                table[column],
                s=20,
                color=colour,
                label=label,
                linewidths=0,
            )
        ax.set_xlabel("modified initial target (cm³)")
        ax.set_ylabel(heading(column))
        ax.set_xlim(left=0)
        ax.set_ylim(bottom=0)
        ax.spines[["top", "right"]].set_visible(False)
    axes[0, 0].legend(frameon=False, loc="upper left")
    degrees = f", {rows['dof'].iloc[0]} degrees of freedom" if "dof" in rows else ""
    figure.suptitle(f"{NAMES[strategy]} planner{degrees}")
    return figure


def draw_comparison(rows: Mapping[str, pd.DataFrame], printed: Mapping[str, pd.DataFrame]) -> Figure:
    """The 3-D planner over the zigzag, specimen by specimen: path length, milling time, mean speed.

    Parameters
    ----------
    rows, printed : mapping of strategy to pandas.DataFrame
        Appendix tables of both strategies; each pair with the same specimens.

    Returns
    -------
    matplotlib.figure.Figure
        Ratios 3-D / zigzag; below 1 the 3-D planner has less.
    """
    columns = ["predicted_path_length_mm", "predicted_milling_time_s", "average_milling_speed_mm_per_s"]
    figure, axes = plt.subplots(1, 3, figsize=(12, 4), constrained_layout=True)
    for ax, column in zip(axes, columns, strict=True):
        for tables, colour, label in ((printed, "0.6", "printed"), (rows, COLOURS["3d"], "ours")):
            ratio = tables["3d"][column] / tables["zigzag"][column]
            volume = tables["zigzag"]["modified_initial_target_cm3"]
            ax.scatter(volume, ratio, s=20, color=colour, label=label, linewidths=0)
        ax.axhline(1, color="0.3", linewidth=0.8)
        ax.set_title(heading(column).rpartition(" (")[0])
        ax.set_xlabel("modified initial target (cm³)")
        ax.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("3-D / zigzag")
    axes[0].legend(frameon=False)
    return figure
