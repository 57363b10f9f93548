"""Figures 2.7 and 2.15: the slab collapsed into one slice, and the window of accessible angles in it."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon, Wedge

from study.collision import Drill, window
from study.planners import Plan
from study.planners.moments import Moment
from study.plots.modified import BURR, circle
from study.plots.palette import STYLES
from study.plots.style import legend_below, new_axes, patches, show_labels, styled

FREE, BLOCKED = "#00703c", "#b3005e"
#: A voxel of the collapsed slice by the narrowest slab in which it is solid.
SHADES = ("#ffffff", "#6e5b3a", "#b39b6b", "#e2d6b8")
SOLID = {0: "air", 1: "protected", 2: "target"}


def _collapsed(moment: Moment) -> tuple[np.ndarray, tuple[int, int, int]]:
    """0 free, 1-3 the narrowest slab (shaft, chuck, barrel) that is solid: depths by laterals; the voxel."""
    layer, depth, lateral = (round(i) for i in moment.frame.from_indices(moment.index[None])[0])
    out = np.zeros(moment.shaft.slab.shape[2:], np.uint8)
    for cylinder in (2, 1, 0):
        out[moment.shaft.slab[cylinder, layer] > 0] = cylinder + 1
    p = moment.frame.padding
    return out[p:-p, p:-p], (layer, depth, lateral)


def _show_collapsed(axes: Axes, moment: Moment, title: str) -> tuple[float, float]:
    """Draw the collapsed slice; (right, down) mm of the burr's centre in it."""
    collapsed, (_, depth, lateral) = _collapsed(moment)
    steps = moment.frame.steps[1:]
    show_labels(axes, collapsed, {}, steps, title=title)
    image = np.array([[int(s[n : n + 2], 16) / 255 for n in (1, 3, 5)] for s in SHADES])[collapsed]
    axes.images[0].set_data(image)
    p = moment.frame.padding
    x, y = (lateral - p) * steps[1], (depth - p) * steps[0]
    left, right, bottom = axes.get_xlim()[0], axes.get_xlim()[1], axes.get_ylim()[0]
    axes.set(xlim=(max(left, x - 24), min(right, x + 24)), ylim=(min(bottom, y + 12), y - 26))
    return x, y


def _shade_legend(drill: Drill) -> list[Patch]:
    names = ("shaft", "chuck", "barrel")
    return [
        Patch(
            facecolor=SHADES[n + 1], edgecolor="#555555", lw=0.5,
            label=f"unmilled within the {name}'s slab (Ø {drill.shaft_diameters[n]:g} mm)",
        )
        for n, name in enumerate(names)
    ]  # fmt: skip


def draw_drill(axes: Axes, drill: Drill, at: tuple[float, float], tilt: float, colour: str, **style) -> None:
    """The burr and the sides of the three cylinders at a tilt, in a picture with the outside on top.

    Parameters
    ----------
    axes : Axes
        Rows downwards: into the bone.
    drill : Drill
    at : (2,) mm
        Right and down, of the burr's centre.
    tilt : float
        Radians, positive to the right.
    colour : str
    """
    along = np.array([np.sin(tilt), -np.cos(tilt)])
    across = np.array([along[1], -along[0]])
    at = np.asarray(at)
    style = {"closed": True, "facecolor": colour, "alpha": 0.25, "lw": 0} | style
    for radius, start, end in drill.cylinders:
        ring = [
            at + along * t + across * m
            for t, m in ((start, -radius), (end, -radius), (end, radius), (start, radius))
        ]
        axes.add_patch(Polygon(ring, **style))
        axes.add_patch(Polygon(ring, closed=True, facecolor="none", edgecolor=colour, lw=1.3))
    circle(axes, *at, drill.burr_radius, edgecolor=colour)


def _blocked_tilt(moment: Moment) -> float | None:
    """A tilt outside the window that meets unmilled bone, radians; None where all are free."""
    where = [round(i) for i in moment.frame.from_indices(moment.index[None])[0]]
    low, high = moment.window
    limit = moment.shaft.max_tilt
    steps = np.deg2rad(np.arange(6, 90, 3))
    for tilt in [t for step in steps for t in (high + step, low - step)]:
        if abs(tilt) <= limit and window(moment.shaft, where, (tilt, tilt)) is None:
            return float(tilt)
    return None


@styled()
def slab_collapse(moment: Moment, plan: Plan, slices: int = 4) -> Figure:
    """Figure 2.7: slices of the slab around the burr, the collapsed slice, shaft orientations checked in it.

    Parameters
    ----------
    moment : Moment
    plan : Plan
        Whose drill is checked.
    slices : int
        Of the slab of the widest cylinder, evenly spaced.
    """
    frame = moment.frame
    solid = frame.canonical(moment.unmodified.labels)
    _, (layer, depth, lateral) = _collapsed(moment)
    p, half = frame.padding, int(moment.shaft.half[2])
    layers = np.unique(
        np.linspace(max(p, layer - half), min(solid.shape[0] - p - 1, layer + half), slices).round()
    )
    figure, _ = new_axes(1, 1, (12, 8.2))
    figure.clear()
    top, bottom = figure.subfigures(2, 1, height_ratios=(0.75, 1.25))
    upper = top.subplots(1, len(layers), sharey=True)
    steps = frame.steps[1:]
    for ax, m in zip(np.atleast_1d(upper), layers.astype(int), strict=True):
        show_labels(ax, solid[m, p:-p, p:-p], SOLID, steps, title=f"{(m - layer) * frame.steps[0]:+.1f} mm")
        ax.plot((lateral - p) * steps[1], (depth - p) * steps[0], "+", color="black", ms=8)
    top.suptitle(
        "(a) slices of the slab, by their distance from the burr's", x=0.01, ha="left", fontsize=10.5
    )
    middle, right = bottom.subplots(1, 2, sharey=True)
    at = _show_collapsed(middle, moment, "(b) all slices of each cylinder's slab, collapsed")
    middle.plot(*at, "+", color="black", ms=8)
    _show_collapsed(right, moment, "(c) orientations checked in the collapsed slice")
    draw_drill(right, plan.drill, at, moment.tilt, FREE)
    blocked = _blocked_tilt(moment)
    handles = [Line2D([], [], color=FREE, lw=2, label=f"free: {np.rad2deg(moment.tilt):.0f}°")]
    if blocked is not None:
        draw_drill(right, plan.drill, at, blocked, BLOCKED)
        handles.append(Line2D([], [], color=BLOCKED, lw=2, label=f"not free: {np.rad2deg(blocked):.0f}°"))
    legend_below(figure, [*patches("air", "protected", "target"), *_shade_legend(plan.drill), *handles], 4)
    return figure


@styled()
def accessible_window(moment: Moment, drill: Drill) -> Figure:
    """Figure 2.15: the range of accessible angles, alpha to beta, of the burr's voxel in the collapsed slice.

    Parameters
    ----------
    moment : Moment
    drill : Drill
    """
    figure, axes = new_axes(1, 1, (8.2, 7.4))
    ax = axes[0, 0]
    at = _show_collapsed(ax, moment, "")
    alpha, beta = moment.window
    draw_drill(ax, drill, at, alpha, STYLES["path"].colour, alpha=0.1)
    draw_drill(ax, drill, at, beta, BLOCKED, alpha=0.1)
    reach = 14.0
    # matplotlib counts degrees from the right; on an axis that grows downwards, clockwise
    ax.add_patch(
        Wedge(at, reach, -90 + np.rad2deg(alpha), -90 + np.rad2deg(beta), fc=FREE, alpha=0.3, ec=FREE, lw=1.5)
    )
    ax.plot([at[0], at[0]], [at[1], at[1] - reach - 3], color="black", lw=0.9, ls="--")
    for name, angle, colour, side in (
        ("α", alpha, STYLES["path"].colour, "right"),
        ("β", beta, BLOCKED, "left"),
    ):
        tip = np.asarray(at) + (reach + 1.5) * np.array([np.sin(angle), -np.cos(angle)])
        ax.text(*tip, f"{name} = {np.rad2deg(angle):.1f}°", color=colour, ha=side, va="bottom", fontsize=12)
    handles = [
        Patch(facecolor=FREE, alpha=0.3, label=f"accessible: {np.rad2deg(beta - alpha):.1f}° wide"),
        Line2D([], [], color="black", lw=0.9, ls="--", label="approach axis, 0°"),
        BURR,
    ]
    legend_below(figure, [*_shade_legend(drill), *handles], 2)
    return figure
