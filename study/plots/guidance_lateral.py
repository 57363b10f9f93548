"""Figures 9 and 10 of Baron, and Table 1 among the bands of many virtual blocks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse
from scipy import stats

from study.experiments.guidance_bands import Condition
from study.guidance import LateralResult
from study.plots.style import legend_below, new_axes, new_figure, styled
from study.tables import heading

#: Of conditions in their order; they differ in lightness too.
CONDITION_COLOURS = ("#0055a4", "#f2a024", "#2e9e3f")
_ELLIPSES = (("#555555", ":"), ("#0055a4", "-"), ("#c8322d", "--"))
#: Breadth of a histogram over the side of its scatter plot.
_STRIP = 0.28
_DOT, _MEAN, _PRINT = "#4a4f57", "#d1372c", "#111111"


@styled()
def lateral_scatter(result: LateralResult, factors: Mapping[str, float], title: str) -> Figure:
    """Deviations of 24 holes at both sides: dots, mean, 99.9 % ellipses, histograms with normal curves.

    Parameters
    ----------
    result : LateralResult
    factors : mapping of str to float
        Half axes of the ellipses in standard deviations, by what they are called.
    title : str
    """
    sides = (result.top, result.bottom)
    most = max(factors.values())
    reach = max(np.abs(d.mean(axis=0)).max() + most * d.std(axis=0, ddof=1).max() for d in sides) * 1.08
    figure = new_figure((10.4, 6.0))
    grid = figure.add_gridspec(2, 4, width_ratios=(1, _STRIP, 1, _STRIP), height_ratios=(_STRIP, 1))
    for column, (name, d) in enumerate(zip(("top", "bottom"), sides, strict=True)):
        axes = figure.add_subplot(grid[1, 2 * column])
        above = figure.add_subplot(grid[0, 2 * column], sharex=axes)
        beside = figure.add_subplot(grid[1, 2 * column + 1], sharey=axes)
        _scatter(axes, d, factors, reach)
        _histogram(above, d[:, 0], reach, "vertical")
        _histogram(beside, d[:, 1], reach, "horizontal")
        above.set_box_aspect(_STRIP)
        above.set_anchor("S")
        beside.set_box_aspect(1 / _STRIP)
        beside.set_anchor("W")
        above.set_title(f"{title}, {name} side")
    handles = [
        Line2D([], [], marker="o", ls="", ms=4, color=_DOT, label="hole"),
        Line2D([], [], marker="+", ls="", ms=11, mew=2, color=_MEAN, label="mean"),
        *(
            Line2D([], [], color=colour, ls=line, label=f"99.9 %, {name} ({factor:.3f} s)")
            for (name, factor), (colour, line) in zip(factors.items(), _ELLIPSES, strict=False)
        ),
    ]
    legend_below(figure, handles, 5)
    return figure


def _scatter(axes: Axes, d: np.ndarray, factors: Mapping[str, float], reach: float) -> None:
    mean, covariance = d.mean(axis=0), np.cov(d.T)
    variances, directions = np.linalg.eigh(covariance)
    angle = np.degrees(np.arctan2(directions[1, 1], directions[0, 1]))
    for factor, (colour, line) in zip(factors.values(), _ELLIPSES, strict=False):
        minor, major = 2.0 * factor * np.sqrt(variances)
        axes.add_patch(Ellipse(mean, major, minor, angle=angle, fc="none", ec=colour, ls=line, lw=1.2))
    axes.axhline(0, color="#00000030", lw=0.8)
    axes.axvline(0, color="#00000030", lw=0.8)
    axes.plot(*d.T, "o", ms=3.5, color=_DOT)
    axes.plot(*mean, "+", ms=13, mew=2.2, color=_MEAN)
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), xlabel="Δx (mm)", ylabel="Δy (mm)")
    axes.set_box_aspect(1)


def _histogram(axes: Axes, values: np.ndarray, reach: float, orientation: str) -> None:
    bins = np.linspace(-reach, reach, 41)
    axes.hist(values, bins=bins, orientation=orientation, color="#c9ccd1", edgecolor="#8b929c", lw=0.4)
    at = np.linspace(-reach, reach, 401)
    curve = stats.norm.pdf(at, values.mean(), values.std(ddof=1)) * len(values) * (bins[1] - bins[0])
    axes.plot(*((at, curve) if orientation == "vertical" else (curve, at)), color=_PRINT, lw=1.1)
    hidden = axes.xaxis if orientation == "vertical" else axes.yaxis
    hidden.set_tick_params(labelbottom=False, labelleft=False)
    other = axes.yaxis if orientation == "vertical" else axes.xaxis
    other.set_visible(False)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


@styled()
def bands_chart(
    table: pd.DataFrame, conditions: Mapping[str, Sequence[Condition]], across: str = "mm"
) -> Figure:
    """Printed numbers, those of one virtual experiment, and the bands of many.

    Parameters
    ----------
    table : pandas.DataFrame
        With ``system``, ``quantity``, ``printed_mm``, ``one_block_mm``, ``<condition>_low_mm`` and so on, and
        ``side`` where a quantity is measured on two.
    conditions : mapping of str to sequence of Condition
        By system.
    across : str
        Label of the axis.
    """
    systems = list(dict.fromkeys(table["system"]))
    rows = max((table["system"] == name).sum() for name in systems)
    figure, axes = new_axes(1, len(systems), (5.6 * len(systems) + 0.4, 0.42 * rows + 1.9), sharey=False)
    most = max(len(conditions[name]) for name in systems)
    for ax, name in zip(axes[0], systems, strict=True):
        part = table[table["system"] == name].reset_index(drop=True)
        y = np.arange(len(part))
        offsets = np.linspace(-0.24, 0.24, most) if most > 1 else [0.0]
        for one, offset, colour in zip(conditions[name], offsets, CONDITION_COLOURS, strict=False):
            low, high = part[f"{one.name}_low_mm"], part[f"{one.name}_high_mm"]
            ax.hlines(y + offset, low, high, color=colour, lw=4.2, alpha=0.9)
        ax.plot(part["one_block_mm"], y, "o", ms=5, mfc="white", mec=_DOT, zorder=3)
        ax.plot(part["printed_mm"], y, "D", ms=5, color=_PRINT, zorder=4)
        words = [heading(q).removesuffix(" (mm)") for q in part["quantity"]]
        if "side" in part:
            words = [f"{side}: {word}" for side, word in zip(part["side"], words, strict=True)]
        ax.set_yticks(y, words)
        ax.axvline(0, color="#00000040", lw=0.8)
        ax.hlines(y[:-1] + 0.5, *ax.get_xlim(), color="#00000012", lw=0.8)
        ax.set(ylim=(len(part) - 0.5, -0.5), xlabel=across, title=name.title())
        ax.margins(x=0.02)
    for ax in axes[0][1:]:
        if (table["system"] == systems[0]).sum() == len(ax.get_yticks()):
            ax.set_yticklabels([])
    titles = {one.name: one.title for name in systems for one in conditions[name]}
    handles = [
        Line2D([], [], marker="D", ls="", ms=5, color=_PRINT, label="printed"),
        Line2D([], [], marker="o", ls="", ms=5, mfc="white", mec=_DOT, label="one virtual block, as stated"),
        *(
            Line2D([], [], color=colour, lw=4.2, label=title)
            for title, colour in zip(titles.values(), CONDITION_COLOURS, strict=False)
        ),
    ]
    legend_below(figure, handles, 3)
    return figure
