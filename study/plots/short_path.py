"""Figures 2.13 and 2.14: the simple objective planner on one small box, and as a flow chart."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, Polygon, Rectangle

from study.plots.palette import STYLES
from study.plots.style import legend_below, new_axes, patches, show_labels, styled


def manhattan_labels(blocked: np.ndarray, start: tuple[int, ...], goal: tuple[int, ...]) -> np.ndarray:
    """Distance to go of every voxel of the box between two corners, by faces; -1 where it is blocked.

    Parameters
    ----------
    blocked : bool array of any dimension
    start, goal : tuple of int

    Returns
    -------
    int array of `blocked`'s shape, -1 also outside the box.
    """
    grid = np.indices(blocked.shape)
    labels = sum(np.abs(g - at) for g, at in zip(grid, goal, strict=True))
    inside = np.ones(blocked.shape, bool)
    for g, a, b in zip(grid, start, goal, strict=True):
        inside &= (g >= min(a, b)) & (g <= max(a, b))
    return np.where(inside & ~blocked, labels, -1)


def descending_path(labels: np.ndarray, start: tuple[int, ...], rng=0) -> list[tuple[int, ...]] | None:
    """Steps through faces to ever lower labels down to 0, ties at random, backing out of dead ends.

    Parameters
    ----------
    labels : int array
        From `manhattan_labels`.
    start : tuple of int
    rng : seed or numpy.random.Generator

    Returns
    -------
    list of voxels from start to goal, or None if every way ends.
    """
    rng = np.random.default_rng(rng)
    dead = labels < 0
    trail = [tuple(start)]
    while trail and labels[trail[-1]] > 0:
        here = trail[-1]
        steps = []
        for axis in range(labels.ndim):
            for sign in (-1, 1):
                to = tuple(i + sign * (n == axis) for n, i in enumerate(here))
                inside = all(0 <= i < n for i, n in zip(to, labels.shape, strict=True))
                if inside and not dead[to] and labels[to] == labels[here] - 1:
                    steps.append(to)
        if steps:
            trail.append(steps[int(rng.integers(len(steps)))])
        else:
            dead[trail.pop()] = True
    return trail or None


@styled()
def short_path_plane(seed: int = 0) -> Figure:
    """Figure 2.13 (a): labels and path from a supervoxel's centre to a target beside it, in a plane."""
    shape, reach = (9, 9), 2
    start, goal = (4, 4), (1, 7)
    kinds = np.full(shape, 4, np.uint8)
    kinds[:, 7:], kinds[:2, :] = 2, 2
    for at in ((2, 4), (2, 5), (4, 6)):
        kinds[at] = 1
    kinds[goal] = 3
    labels = manhattan_labels(kinds == 1, start, goal)
    path = np.array(descending_path(labels, start, seed))
    figure, axes = new_axes(1, 1, (6, 6.4))
    ax = axes[0, 0]
    names = {1: "protected", 2: "target", 3: "target_boundary", 4: "removed"}
    step = 0.4
    show_labels(
        ax, kinds, names, (step, step), grid=True, title="Manhattan distance to go in the box between both"
    )
    for at in np.argwhere(labels >= 0):
        ax.text(at[1] * step, at[0] * step, str(labels[tuple(at)]), ha="center", va="center", fontsize=11)
    side = (2 * reach + 1) * step
    corner = (start[1] * step - side / 2, start[0] * step - side / 2)
    ax.add_patch(Rectangle(corner, side, side, fc="none", ec="black", lw=2, label="supervoxel"))
    ax.plot(path[:, 1] * step, path[:, 0] * step, color=STYLES["path"].colour, lw=3, alpha=0.6, label="path")
    ax.plot(*(np.array(start)[::-1] * step), "o", color="black", ms=16, mfc="none", label="burr's centre")
    handles, _ = ax.get_legend_handles_labels()
    legend_below(figure, [*patches("removed", "protected", "target", "target_boundary"), *handles], 3)
    return figure


@styled()
def flow_chart() -> Figure:
    """Figure 2.14: the simple objective planner of 2.2.6."""
    figure, axes = new_axes(1, 1, (8.6, 10.2))
    ax = axes[0, 0]
    ax.set(xlim=(-4.6, 5.4), ylim=(-13.1, 0.9), aspect="equal")
    ax.set_axis_off()

    def box(y, text, kind="box", x=0.0, width=3.9, height=1.05):
        if kind == "ask":
            ring = [(x, y + 0.92), (x + 2.5, y), (x, y - 0.92), (x - 2.5, y)]
            ax.add_patch(Polygon(ring, facecolor="#fdf1dc", edgecolor="#333333"))
        else:
            colour = {"box": "#e4eef7", "end": "#dff0e0", "fail": "#f7dede"}[kind]
            ax.add_patch(
                FancyBboxPatch(
                    (x - width / 2, y - height / 2),
                    width,
                    height,
                    boxstyle="round,pad=0.02,rounding_size=0.15",
                    facecolor=colour,
                    edgecolor="#333333",
                )
            )
        ax.text(x, y, text, ha="center", va="center", fontsize=9)

    def arrow(points, text="", at=None):
        points = np.array(points, float)
        ax.plot(*points[:-1].T, color="#333333", lw=1.2)
        head = {"arrowstyle": "-|>", "color": "#333333", "lw": 1.2, "shrinkA": 0, "shrinkB": 0}
        ax.annotate("", points[-1], points[-2], arrowprops=head)
        if text:
            ax.text(*(at or points[0] + [0.12, -0.12]), text, fontsize=9, va="top")

    box(0, "box of voxels with the burr's centre\nand the goal in opposite corners")
    box(-1.8, "label each voxel with its\nManhattan distance to go")
    box(-4.0, "each label from\nhere to 0 present?", "ask")
    box(-6.2, "at the goal?", "ask")
    box(-8.4, "neighbour with the next\nlower label that is allowed\nand free for the shaft?", "ask")
    box(-10.6, "step there; equal\nlabels: at random")
    box(-8.4, "mark it dead,\nstep back", x=4.0, width=2.2)
    box(-10.6, "at the start again?", x=4.0, width=2.4, height=0.8)
    box(-12.4, "no path: next candidate", "fail", x=4.0, width=2.6, height=0.8)
    box(-6.2, "drill the path", "end", x=4.0, width=2.2, height=0.8)
    arrow([(0, -0.54), (0, -1.26)])
    arrow([(0, -2.34), (0, -3.06)])
    arrow([(0, -4.92), (0, -5.26)], "yes", (0.12, -4.86))
    arrow([(2.5, -6.2), (2.87, -6.2)], "yes", (2.45, -5.8))
    arrow([(0, -7.12), (0, -7.46)], "no", (0.12, -7.08))
    arrow([(0, -9.32), (0, -10.06)], "yes", (0.12, -9.3))
    arrow([(2.5, -8.4), (2.87, -8.4)], "no", (2.5, -8.0))
    arrow([(4.0, -8.94), (4.0, -10.18)])
    arrow([(4.0, -11.0), (4.0, -11.98)], "yes", (4.12, -11.1))
    back = [(2.78, -10.6), (2.4, -10.6), (2.4, -9.75), (-3.6, -9.75), (-3.6, -6.6), (-1.41, -6.6)]
    arrow(back, "no", (2.42, -10.3))
    arrow([(-1.97, -10.6), (-4.1, -10.6), (-4.1, -6.2), (-2.52, -6.2)])
    arrow([(-2.5, -4.0), (-4.45, -4.0), (-4.45, -12.4), (2.68, -12.4)], "no", (-2.95, -3.6))
    return figure
