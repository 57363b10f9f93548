"""Which causes matter, which steps lead to an accuracy, and what happens around a stop."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy import stats

from study.experiments.guidance_lateral import cause_title
from study.experiments.guidance_stops import AT_S
from study.guidance import DrilledHole
from study.plots.style import legend_below, new_axes, styled

_LOW, _HIGH, _LIMIT = "#56b4e9", "#0055a4", "#c8322d"


@styled()
def tornado(table: pd.DataFrame, most: int = 16) -> Figure:
    """Change of the 99.9 % radius when one cause goes to either end of its range.

    Parameters
    ----------
    table : pandas.DataFrame
        See `study.experiments.guidance_design.sensitivity`.
    most : int
        Causes that are drawn, largest swing first.
    """
    names = list(dict.fromkeys(table["cause"]))[:most]
    figure, axes = new_axes(1, 1, (8.6, 0.34 * len(names) + 1.4))
    ax = axes[0, 0]
    words = []
    for y, name in enumerate(names):
        part = table[table["cause"] == name].set_index("end")
        for end, colour, shift in (("low", _LOW, -0.19), ("high", _HIGH, 0.19)):
            row = part.loc[end]
            ax.barh(
                y + shift, row["change_mm"], 0.36, color=colour, xerr=row["plus_minus_mm"],
                error_kw={"elinewidth": 0.9, "ecolor": "#23262b"},
            )  # fmt: skip
        unit = part.loc["low", "unit"]
        low, high = part.loc["low", "value"], part.loc["high", "value"]
        words.append(f"{cause_title(name, unit)}: {low:g} to {high:g} {'' if unit == '1' else unit}".rstrip())
    ax.set_yticks(range(len(names)), words)
    ax.axvline(0, color="#23262b", lw=0.8)
    ax.set(ylim=(len(names) - 0.5, -0.5), xlabel="change of the 99.9 % radius (mm), 95 % interval")
    handles = [ax.barh(0, 0, color=c, label=f"at the {e} end") for e, c in (("low", _LOW), ("high", _HIGH))]
    legend_below(figure, handles, 2)
    return figure


@styled()
def design_steps(table: pd.DataFrame, limit_mm: float) -> Figure:
    """The 99.9 % radius as stated, and the share of holes beyond the limit as drawn, step by step."""
    y = np.arange(len(table))
    figure, axes = new_axes(1, 2, (11.0, 0.5 * len(y) + 1.5), sharey=True)
    left, right = axes[0]
    left.errorbar(table["radius_mm"], y, xerr=table["plus_minus_mm"], fmt="o", color=_HIGH, capsize=3)
    left.axvline(limit_mm, color=_LIMIT, lw=1.2, ls="--")
    words = [name if k == 0 else f"+ {name}" for k, name in enumerate(table["step"])]
    left.set_yticks(y, words)
    left.set(ylim=(len(y) - 0.5, -0.5), xlabel="99.9 % radius (mm), 95 % interval", title="causes as stated")
    left.set_xlim(left=0)
    k, n = table["drawn_beyond"].to_numpy(), table["drawn_holes"].to_numpy()
    low = np.where(k > 0, stats.beta.ppf(0.025, np.maximum(k, 1), n - k + 1), 0.0)
    high = np.where(k < n, stats.beta.ppf(0.975, k + 1, np.maximum(n - k, 1)), 1.0)
    right.errorbar(
        100 * k / n, y, xerr=100 * np.array([k / n - low, high - k / n]), fmt="o", color=_HIGH, capsize=3
    )
    right.axvline(0.1, color=_LIMIT, lw=1.2, ls="--")
    right.set(
        xlabel=f"holes beyond {limit_mm:g} mm (%), 95 % interval", title="causes drawn from their ranges"
    )
    return figure


@styled()
def stops_chart(holes: Mapping[str, DrilledHole]) -> Figure:
    """True distance of the tip from its line over time, around each fault; red where the robot stands."""
    columns = 4
    rows = -(-len(holes) // columns)
    figure, axes = new_axes(rows, columns, (11.6, 2.5 * rows + 0.2), sharex=True, sharey=True)
    for ax, (name, hole) in zip(axes.flat, holes.items(), strict=False):
        t = 1000.0 * (hole.time_s - AT_S)
        around = t > -500
        ax.plot(t[around], hole.across[around], color=_HIGH, lw=1.2)
        halted = around & (hole.status > 1)
        ax.plot(t[halted], hole.across[halted], color=_LIMIT, lw=1.8)
        ax.axvline(0, color="#23262b", lw=0.8, ls=":")
        ax.set_ylim(0.0, 1.08 * max(h.across[h.time_s > AT_S - 0.5].max() for h in holes.values()))
        reason = hole.end.name.replace("_", " ").lower() if halted.any() else "goes on"
        ax.set_title(f"{name}\n{reason}", fontsize=8.5)
    for ax in axes[-1]:
        ax.set_xlabel("time since the fault (ms)")
    for ax in axes[:, 0]:
        ax.set_ylabel("off the line (mm)")
    for ax in axes.flat[len(holes) :]:
        ax.set_visible(False)
    return figure
