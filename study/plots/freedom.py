"""4 against 5 degrees of freedom: bone by bone, over the width of a hole, in a section, by direction."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from study.experiments.milling_times import COLOURS, NAMES
from study.planners import Plan
from study.plots.sections import section
from study.plots.style import legend_below, new_axes, patches, show_labels, styled
from study.robots.turns import angles_between
from study.tables import heading

LINES = {"4 DOF": (0, (4, 2)), "5 DOF": "-", "5 DOF, printed window": ":"}
MARKERS = {"4 DOF": "o", "5 DOF": "^", "5 DOF, printed window": "s"}


def _plain(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)


def _panels(rows: pd.DataFrame, columns: Mapping[str, str], x_label: str, draw) -> Figure:
    """A panel a column, in each the rows of every strategy and planner; y from 0."""
    figure, axes = new_axes(1, len(columns), (4.1 * len(columns), 4.4))
    groups = list(rows.groupby(["strategy", "planner"], sort=False))
    groups.sort(key=lambda group: list(NAMES).index(group[0][0]))
    for ax, (column, title) in zip(axes[0], columns.items(), strict=True):
        for (strategy, planner), found in groups:
            draw(ax, found, column, strategy, planner, f"{NAMES[strategy]}, {planner}")
        ax.set(title=title, xlabel=x_label, ylabel=heading(column))
        ax.set_ylim(0, 1.08 * max(float(rows[column].max()), 1e-9))
        ax.margins(x=0.08)
        _plain(ax)
    legend_below(figure, axes[0, 0].get_legend_handles_labels()[0], 2)
    return figure


@styled()
def degree_ratios(
    ours: Mapping[tuple[str, int], pd.DataFrame], printed: Mapping[tuple[str, int], pd.DataFrame]
) -> Figure:
    """The path with 5 degrees of freedom over that with 4, bone by bone, printed and ours.

    Parameters
    ----------
    ours, printed : mapping of (strategy, dof) to pandas.DataFrame
        Appendix tables indexed by specimen; 4 and 5 of a strategy hold the same bones.
    """
    figure, axes = new_axes(1, 2, (10, 4), sharey=True)
    for ax, strategy in zip(axes[0], NAMES, strict=True):
        for rows, colour, label in ((printed, "0.6", "printed"), (ours, COLOURS[strategy], "ours")):
            four, five = rows[strategy, 4], rows[strategy, 5]
            ratio = five["predicted_path_length_mm"] / four["predicted_path_length_mm"]
            ax.scatter(
                four["modified_initial_target_cm3"], ratio, s=20, color=colour, label=label, linewidths=0
            )
        ax.axhline(1, color="0.3", lw=0.8)
        ax.set(title=f"{NAMES[strategy]} planner", xlabel="modified initial target, 4 DOF (cm³)")
        ax.set_xlim(left=0)
        ax.legend()
        _plain(ax)
    axes[0, 0].set_ylabel("path length, 5 DOF / 4 DOF")
    return figure


@styled()
def bone_by_bone(rows: pd.DataFrame, columns: Mapping[str, str]) -> Figure:
    """Columns of `study.experiments.freedom.run_freedom` over the target's volume, a marker for each planner.

    Parameters
    ----------
    rows : pandas.DataFrame
    columns : mapping of str to str
        Column and title of each panel.
    """

    def draw(ax, found, column, strategy, planner, label):
        ax.scatter(
            found["modified_target_cm3"], found[column], s=24, lw=1.1, facecolors="none",
            edgecolors=COLOURS[strategy], marker=MARKERS[planner], label=label,
        )  # fmt: skip

    return _panels(rows, columns, "modified target (cm³)", draw)


@styled()
def over_holes(rows: pd.DataFrame, columns: Mapping[str, str]) -> Figure:
    """Columns of `study.experiments.freedom.run_freedom` over the diameter of the hole; means over the bones.

    Parameters
    ----------
    rows : pandas.DataFrame
        With several holes.
    columns : mapping of str to str
        Column and title of each panel.
    """

    def draw(ax, found, column, strategy, planner, label):
        mean = found.groupby("hole_mm")[column].mean()
        ax.plot(
            mean.index, mean, color=COLOURS[strategy], ls=LINES[planner], marker=MARKERS[planner],
            ms=5, mfc="none", label=label,
        )  # fmt: skip

    return _panels(rows, columns, "diameter of the hole (mm)", draw)


@styled()
def bone_left(plans: Mapping[str, Plan]) -> Figure:
    """One section of the same bone after each plan: what was milled and what was left.

    Parameters
    ----------
    plans : mapping of str to Plan
        By title, two or more; of the same volume, the first of 4 degrees of freedom. The plane holds
        the approach and the axis about which the first tilts, towards which its shaft cannot lean; of
        those planes it is the one on which the last removes most of what the first leaves.
    """
    first, *_, last = plans.values()
    volume = first.volume
    along = int(np.argmax(np.abs(volume.directions.T @ first.approach)))
    normal = 3 - along - first.rotation_axis
    left = first.remaining.mask("target")
    telling = (left & ~last.remaining.mask("target"), left, volume.mask("target"))
    shown = next(mask for mask in telling if mask.any())
    counts = np.count_nonzero(shown, axis=tuple({0, 1, 2} - {normal}))
    plane = section(volume, first.approach, normal=normal, index=int(np.argmax(counts)), margin_mm=8.0)
    figure, axes = new_axes(1, len(plans), (5.2 * len(plans), 5.4), sharey=True)
    for ax, (title, plan) in zip(axes[0], plans.items(), strict=True):
        target = volume.mask("target")
        labels = np.where(volume.mask("air"), 0, np.where(target, 3, 1))
        labels[plan.remaining.mask("target")] = 2
        show_labels(
            ax, plane.of(labels), {0: "air", 1: "protected", 2: "target", 3: "removed"}, plane.spacing,
            title=f"{title}: {plan.remaining.volume_mm3('target'):.0f} mm³ left in all",
        )  # fmt: skip
    handles = patches("air", "protected", "removed", "target")
    handles[-1].set_label("targeted bone left")
    legend_below(figure, handles)
    return figure


@styled()
def shaft_directions(plans: Mapping[str, Plan]) -> Figure:
    """Where the shaft points at every point of each plan, as seen along the approach.

    Parameters
    ----------
    plans : mapping of str to Plan
        By title; of the same volume. The distance from the middle is the angle to the approach.
    """
    figure, axes = new_axes(1, len(plans), (4.6 * len(plans), 5.0), sharey=True)
    for ax, (title, plan) in zip(axes[0], plans.items(), strict=True):
        directions = plan.volume.directions
        along = int(np.argmax(np.abs(directions.T @ plan.approach)))
        aside = plan.axes @ directions[:, [axis for axis in range(3) if axis != along]]
        tilt = np.rad2deg(angles_between(plan.axes, np.broadcast_to(-plan.approach, plan.axes.shape)))
        length = np.linalg.norm(aside, axis=1)
        there = aside / np.where(length > 0, length, 1)[:, None] * tilt[:, None]
        cutting = plan.removed > 0
        ax.plot(*there.T, color="0.75", lw=0.5, zorder=1)
        ax.scatter(*there[~cutting].T, s=7, color="0.55", lw=0, zorder=2)
        ax.scatter(*there[cutting].T, s=9, color=COLOURS["3d"], lw=0, zorder=3)
        limit = plan.settings.max_tilt_deg
        ax.add_patch(Circle((0, 0), limit, facecolor="none", edgecolor="0.3", lw=0.8, ls="--"))
        ax.set(title=title, xlabel="tilt across the approach (°)", aspect="equal")
        ax.set(xlim=(-limit - 3, limit + 3), ylim=(-limit - 3, limit + 3))
        _plain(ax)
    axes[0, 0].set_ylabel("tilt across the approach (°)")
    dots = {"marker": "o", "ls": "", "ms": 5}
    legend_below(
        figure,
        [
            Line2D([], [], color=COLOURS["3d"], label="cutting", **dots),
            Line2D([], [], color="0.55", label="moving", **dots),
            Line2D([], [], color="0.3", lw=0.8, ls="--", label="largest tilt allowed"),
        ],
    )
    return figure
