"""The features of a virtual fixture in figures, and a run of a guided tool over time."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from study.experiments.fixture_features import Way
from study.fixtures import MeshFixture
from study.fixtures.retraction import Retraction
from study.plots.palette import style_of
from study.plots.style import legend_below, new_axes, styled

_LINES = ("#1b6ca8", "#e8590c", "#1b9e77", "#7a4bb0", "#b5179e")


@styled()
def tips_figure(ways: Mapping[float, Way], wanted: np.ndarray, walls: MeshFixture) -> Figure:
    """Feature 1: where the centres of tips go when the hand passes below a groove, in its section.

    Parameters
    ----------
    ways : mapping of float to Way
        Radius in mm -> what the tip did.
    wanted : (n, 3) array
        mm, the hand.
    walls : MeshFixture
        The groove, along y.
    """
    figure, grid = new_axes(1, 1, (8.2, 5.6))
    axes = grid[0, 0]
    section = np.unique(np.round(walls.mesh.vertices[:, [0, 2]], 9), axis=0)
    section = section[np.argsort(section[:, 0])]
    axes.add_patch(Polygon([*section, [section[-1, 0], -4], [section[0, 0], -4]], color="#e8dcc0", zorder=0))
    axes.plot(*section.T, color="#6e6658", lw=1.4)
    axes.plot(wanted[:, 0], wanted[:, 2], "--", color="#2b2f36", lw=1.3, label="the hand")
    for colour, (radius, way) in zip(_LINES, ways.items(), strict=False):
        axes.plot(
            way.poses[:, 0], way.poses[:, 2], color=colour, lw=1.8, label=f"a {radius:g} mm tip's centre"
        )
        lowest = way.poses[np.argmin(way.poses[:, 2])]
        axes.add_patch(Circle(lowest[[0, 2]], max(radius, 0.07), fill=radius == 0, color=colour, lw=1.2))
    axes.set(xlabel="across the groove, mm", ylabel="height above its floor, mm", aspect="equal")
    axes.set(xlim=(-8, 8), ylim=(-2, 10))
    legend_below(figure, axes.get_legend_handles_labels()[0], columns=3)
    return figure


@styled()
def slack_figure(table: pd.DataFrame, over_time: Mapping[str, np.ndarray]) -> Figure:
    """Feature 2: depth against how hard the hand presses, and against time.

    Parameters
    ----------
    table : pandas.DataFrame
        Of `study.experiments.fixture_features.slack_depths`.
    over_time : mapping of str to (n,) array
        Its second answer.
    """
    figure, (grid,) = new_axes(1, 2, (11.0, 4.4))
    against, time = grid
    for colour, (title, rows) in zip(_LINES, table.groupby("structure", sort=False), strict=False):
        against.plot(rows["push_mm"], rows["depth_mm"], "o", color=colour, ms=5)
        against.plot(rows["push_mm"], rows["expected_mm"], "-", color=colour, lw=1.4, label=title)
        time.plot(over_time[title], color=colour, lw=1.8)
    against.set(
        xlabel="the hand asks for, mm a cycle, straight into the plate",
        ylabel="depth that is held, mm",
        title="(a) lines: min(asked / weight, slack)",
    )
    hardest = table["push_mm"].max()
    time.set(
        xlabel="cycle",
        ylabel="depth, mm",
        title=f"(b) pressed for long, {hardest:g} mm a cycle",
        xscale="symlog",
    )
    legend_below(figure, against.get_legend_handles_labels()[0], columns=4)
    return figure


@styled()
def retraction_figure(plan: Retraction) -> Figure:
    """Feature 4: how far from its start a tool is on its way in and out, and how fast."""
    figure, (grid,) = new_axes(1, 2, (11.0, 3.9))
    inn = plan.insertion
    for times, poses, colour, name in (
        (inn.times - inn.times[0], inn.poses, _LINES[0], "insertion, by hand"),
        (plan.times - plan.times[0], plan.poses, _LINES[1], "retraction"),
    ):
        away = np.linalg.norm(poses[:, :3] - inn.poses[0, :3], axis=1)
        speed = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1) / np.diff(times)
        grid[0].plot(times, away, color=colour, lw=1.8, label=name)
        grid[1].plot(times[1:], speed, color=colour, lw=1.2)
    grid[0].set(xlabel="time, s", ylabel="distance from the start, mm", title="(a) position")
    grid[1].set(xlabel="time, s", ylabel="speed of the tip, mm/s", title="(b) speed")
    legend_below(figure, grid[0].get_legend_handles_labels()[0], columns=2)
    return figure


@styled()
def clearance_over_time(
    times: np.ndarray,
    gaps: Mapping[str, pd.DataFrame],
    clearances: Mapping[str, float],
    show: float = 6.0,
) -> Figure:
    """Distance of a tip to each structure over time, one panel a run.

    Parameters
    ----------
    times : (n,) array
        s.
    gaps : mapping of str to pandas.DataFrame
        Title -> a column of mm for each structure.
    clearances : mapping of str to float
        What was to be kept of each.
    show : float
        mm, the upper edge.
    """
    figure, grid = new_axes(len(gaps), 1, (10.5, 2.7 * len(gaps) + 0.6), sharex=True, sharey=True)
    lowest = min(float(table.min().min()) for table in gaps.values())
    for axes, (title, table) in zip(grid[:, 0], gaps.items(), strict=True):
        axes.axhspan(lowest - 0.4, 0.0, color="#f3c6c2", lw=0)
        for name in table:
            style = style_of(name)
            colour = {"facial_nerve": "#b59b00"}.get(name, style.colour)
            axes.plot(times, table[name], color=colour, lw=1.5, label=style.title)
        for kept in sorted({clearances[name] for name in table}):
            axes.axhline(kept, color="#444444", lw=0.8, ls=":")
        axes.set(ylim=(lowest - 0.4, show), ylabel="burr to structure, mm", title=title)
    grid[-1, 0].set_xlabel("time, s")
    legend_below(figure, grid[0, 0].get_legend_handles_labels()[0], columns=5)
    return figure


@styled()
def arm_figure(operation: pd.DataFrame, stretched: pd.DataFrame) -> Figure:
    """Joints of an arm in an operation; and what happens as it is stretched towards a singular posture."""
    figure, (grid,) = new_axes(1, 2, (11.0, 4.2))
    joints, damping = grid
    for i in range(6):
        angle = operation[f"joint_{i + 1}_deg"]
        joints.plot(operation["time_s"], angle - angle.iloc[0], lw=1.5, label=f"joint {i + 1}")
    joints.set(xlabel="time, s", ylabel="turned from the ready posture, °", title="(a) over the bone")
    joints.legend(ncols=3, fontsize=8)
    first = stretched["singular_value"].iloc[0]
    for colour, (label, values) in zip(
        (_LINES[0], _LINES[1], "#8d8d8d"),
        {
            "least singular value, of the first": stretched["singular_value"] / first,
            "damping": stretched["damping"],
            "fastest joint, of its limit": stretched["fastest_pct"] / 100,
        }.items(),
        strict=True,
    ):
        damping.plot(stretched["time_s"], values, color=colour, label=label)
    damping.set(
        xlabel="time, s", ylabel="ratio, no unit", ylim=(0, 1.05), title="(b) pulled away from its foot"
    )
    damping.legend(fontsize=8)
    return figure
