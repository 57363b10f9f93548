"""Meshes by tools by methods: how deep, how often stopped, and what is left of sliding along a plate."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from study.plots.style import legend_below, new_axes

TITLES = {"exact": "exact", "published": "Algorithm 1", "none": "no fixture (control)"}
COLOURS = {"none": "#8c8c8c", "published": "#d55e00", "exact": "#0072b2"}
#: Depths are coloured from here on, mm; what counts as having entered.
FROM_MM, TO_MM = 1e-3, 3.0


def depth_figure(rows: pd.DataFrame) -> Figure:
    """The deepest that each tool was in each mesh, a panel for each method.

    Parameters
    ----------
    rows : DataFrame
        Of `study.experiments.fixture_validation.Validation`.
    """
    names, tools = list(dict.fromkeys(rows["mesh"])), list(dict.fromkeys(rows["tool"]))
    methods = list(dict.fromkeys(rows["method"]))
    size = (3.0 + 3.1 * len(methods), 0.42 * len(names) + 1.7)
    figure, axes = new_axes(1, len(methods), size, sharey=True)
    image = None
    for ax, method in zip(axes[0], methods, strict=True):
        part = rows[rows["method"] == method]
        depth, passed = (
            part.pivot_table(column, "mesh", "tool").reindex(index=names, columns=tools)
            for column in ("worst_mm", "passed")
        )
        shown = np.ma.masked_less(depth.to_numpy(), FROM_MM)
        image = ax.imshow(shown, norm=LogNorm(FROM_MM, TO_MM), cmap="YlOrRd", aspect="auto")
        for i, mesh in enumerate(names):
            for k, tool in enumerate(tools):
                value, through = depth.loc[mesh, tool], passed.loc[mesh, tool]
                if np.isnan(value):
                    text, colour = "–", "0.6"
                elif value < FROM_MM:
                    text, colour = ("through" if through else "0"), ("#b2182b" if through else "0.35")
                else:
                    text, colour = f"{value:.2g}", "white" if value > 0.3 else "0.1"
                ax.text(k, i, text, ha="center", va="center", fontsize=8, color=colour)
        ax.set_xticks(range(len(tools)), tools, rotation=40, ha="right")
        ax.set_title(TITLES[method])
        ax.set_xticks(np.arange(len(tools) + 1) - 0.5, minor=True)
        ax.set_yticks(np.arange(len(names) + 1) - 0.5, minor=True)
        ax.grid(which="minor", color="0.85", lw=0.6)
        ax.tick_params(which="minor", length=0)
    axes[0, 0].set_yticks(range(len(names)), names)
    figure.colorbar(image, ax=axes[0], label="deepest (mm)", extend="max", pad=0.01, aspect=30)
    return figure


def stops_figure(rows: pd.DataFrame) -> Figure:
    """Steps that stopped and steps that were constrained, by mesh and method, over all tools.

    Parameters
    ----------
    rows : DataFrame
        Of `study.experiments.fixture_validation.Validation`.
    """
    names = list(dict.fromkeys(rows["mesh"]))
    methods = [method for method in dict.fromkeys(rows["method"]) if method != "none"]
    figure, axes = new_axes(1, 2, (9.5, 0.42 * len(names) + 1.5), sharey=True)
    columns = (
        ("stopped_pct", "steps that stopped (%)"),
        ("constrained_pct", "steps that were constrained (%)"),
    )
    for ax, (column, label) in zip(axes[0], columns, strict=True):
        for k, method in enumerate(methods):
            part = rows[(rows["method"] == method) & ~rows["tool"].str.contains("shaft")]
            mean = part.groupby("mesh")[column].mean().reindex(names)
            y = np.arange(len(names)) + 0.36 * (k - (len(methods) - 1) / 2)
            ax.barh(y, mean, height=0.32, color=COLOURS[method])
            ax.plot(mean, y, "|", color=COLOURS[method], ms=7, mew=1.8)
        ax.set(xlabel=label, xlim=(0, None))
        ax.grid(axis="x", color="0.92")
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
    axes[0, 0].set_yticks(range(len(names)), names)
    axes[0, 0].invert_yaxis()
    legend_below(figure, [Patch(color=COLOURS[method], label=TITLES[method]) for method in methods], 2)
    return figure


def plate_figure(rows: pd.DataFrame, least: float = 0.98) -> Figure:
    """Length made along a plate over what was asked for, by how hard the tip is pressed.

    Parameters
    ----------
    rows : DataFrame
        Of `study.experiments.fixture_plate.plate_progress`.
    least : float
        What is asked of a fixture.
    """
    kinds, counts = list(dict.fromkeys(rows["plate"])), sorted(set(rows["vertices"]))
    figure, axes = new_axes(1, len(kinds), (4.9 * len(kinds), 3.7), sharey=True)
    shapes = dict(zip(counts, "osD^v", strict=False))
    for ax, kind in zip(axes[0], kinds, strict=True):
        ax.axhline(least, color="0.5", lw=1, ls="--")
        for (method, count), part in rows[rows["plate"] == kind].groupby(["method", "vertices"]):
            if method == "none":
                continue
            ax.plot(part["press_mm"], part["progress_ratio"], color=COLOURS[method], lw=1.3)
            entered = part["worst_mm"] > FROM_MM
            for which, fill in ((entered, "white"), (~entered, COLOURS[method])):
                ax.plot(
                    part["press_mm"][which],
                    part["progress_ratio"][which],
                    shapes[count],
                    color=COLOURS[method],
                    mfc=fill,
                    ms=5.5,
                )
        ax.set(xlabel="pressed by (mm a cycle)", title=kind)
        ax.grid(color="0.93")
        ax.spines[["top", "right"]].set_visible(False)
    axes[0, 0].set_ylabel("length made / asked for")
    handles = [
        Line2D([], [], color=COLOURS[method], label=TITLES[method]) for method in ("exact", "published")
    ]
    handles += [
        Line2D([], [], color="0.3", marker=shapes[count], ls="", label=f"{count} x {count} vertices")
        for count in counts
    ]
    handles.append(Line2D([], [], color="0.3", marker="o", mfc="white", ls="", label="it entered"))
    handles.append(Line2D([], [], color="0.5", ls="--", label=f"{least:g}"))
    legend_below(figure, handles, 4)
    return figure
